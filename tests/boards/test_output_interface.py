"""A board whose firmware speaks its own language, on a real serial line: heard, or said to be silent or strange."""

from __future__ import annotations

import os
import select
import threading
import time
import tty
from collections.abc import Callable, Iterator
from contextlib import suppress
from pathlib import Path

import numpy as np
import pytest

from hiltest.boards import RealBoard, open_board
from hiltest.errors import ConfigError, DeviceSilentError, LinkLostError, VersionMismatchError
from hiltest.interfaces.fsflk import FsflkInterface
from hiltest.interfaces.packets import AnglesPacket, MainPacket, encode
from hiltest.interfaces.quantities import Observation, Quantity
from hiltest.link.transcript import Direction, Transcript
from hiltest.procedures.reported_headings import frame_of
from hiltest.procedures.settling import wait_until_settled
from hiltest.rig import Rig
from hiltest.rig.bench_files import rig_file
from hiltest.rig.rig_file import load_rig

RIG = """
schema = 1
name = "desk"
[board]
kind = "real"
[device]
kind = "fsflk"
start_s = 0.1
window_s = 0.2
settle_s = 1.0
[device.fsflk]
algorithm = "Q9"
[field]
strength_ut = 48.5
dip_deg = 62.0
[turntable]
kind = "operator"
uncertainty_deg = 1.0
[sensors]
magnetometer_noise_ut = 0.7
[procedure]
headings_deg = [0, 90, 180, 270]
tilts_deg = [[0, 0]]
"""


class FarEnd:
    """A serial line at whose other end something is said again and again."""

    def __init__(self, say: Callable[[int], bytes]) -> None:
        self.master, slave = os.openpty()
        tty.setraw(slave)
        self.port = os.ttyname(slave)
        self.heard = bytearray()
        self._slave, self._say, self._ends = slave, say, threading.Event()
        os.set_blocking(self.master, False)
        self._thread = threading.Thread(target=self._run)
        self._thread.start()

    def _run(self) -> None:
        number = 0
        while not self._ends.wait(0.02):
            number += 1
            with suppress(OSError):
                os.write(self.master, self._say(number))
            with suppress(OSError):
                self.heard += os.read(self.master, 100)

    def end(self) -> None:
        self._ends.set()
        self._thread.join()
        for item in (self.master, self._slave):
            with suppress(OSError):
                os.close(item)


@pytest.fixture
def far_end() -> Iterator[Callable[[Callable[[int], bytes]], FarEnd]]:
    ends: list[FarEnd] = []

    def begin(say: Callable[[int], bytes]) -> FarEnd:
        ends.append(FarEnd(say))
        return ends[-1]

    yield begin
    for end in ends:
        end.end()


@pytest.fixture
def rig(tmp_path: Path) -> Rig:
    file = tmp_path / "desk.toml"
    file.write_text(RIG, encoding="utf-8")
    return load_rig(file)


def angles(heading_deg: float) -> bytes:
    gravity = encode(MainPacket(1, 0, (0, 0, 8192), (228, 0, 428), (0, 0, 0), (30_000, 0, 0, 0), 8, 5))
    return gravity + encode(AnglesPacket(1, 25_000, 0, 0, round(10 * heading_deg) % 3600))


def test_it_is_heard_and_told_its_algorithm(far_end: Callable[..., FarEnd], rig: Rig) -> None:
    other, transcript = far_end(lambda number: angles(123.4)), Transcript()
    with open_board(rig, port=other.port, transcript=transcript) as board:
        settled = wait_until_settled(board, frame_of(rig))
        assert settled.is_settled
        assert settled.heading_deg == pytest.approx(123.4)
        assert settled.took_s >= 0.4, "two windows of 0.2 s"
        assert board.output.latest[Quantity.MAGNETOMETER_CALIBRATED].tolist() == [22.8, 0.0, 42.8]
        assert board.truth is None
    assert bytes(other.heard) == b"Q9  "
    assert {entry.direction for entry in transcript.entries} == {Direction.TO_BOARD, Direction.TO_HOST}


def test_a_heading_that_goes_on_moving_is_not_settled(far_end: Callable[..., FarEnd], rig: Rig) -> None:
    other = far_end(lambda number: angles(number % 3600 / 10))  # 5 degrees a second
    with open_board(rig, port=other.port) as board:
        settled = wait_until_settled(board, frame_of(rig))
    assert not settled.is_settled
    assert settled.took_s >= 1.0, "five windows of 0.2 s"


ASKED = """[device]
kind = "text"
start_s = 0.1
window_s = 0.2
settle_s = 1.0
[device.text]
patterns = ["^heading (?P<heading>.*)"]
[device.text.commands]
ask = "heading?\\n"
"""


class Prompt:
    """A prompt at the other end of a line, which echoes each line and answers it; but not the first one.

    Attributes
    ----------
    requests : list of float
        Wall times at which a line has arrived [s].
    """

    def __init__(self) -> None:
        self.master, slave = os.openpty()
        tty.setraw(slave)
        self.port, self._slave, self._ends = os.ttyname(slave), slave, False
        self.requests: list[float] = []
        self._thread = threading.Thread(target=self._run)
        self._thread.start()

    def _run(self) -> None:
        received = b""
        while not self._ends:
            if not select.select([self.master], [], [], 0.02)[0]:
                continue
            received += os.read(self.master, 100)
            *lines, received = received.split(b"\n")
            for line in lines:
                self.requests.append(time.monotonic())
                os.write(self.master, b"> " + line + b"\n" + (b"heading 12.5\n" if len(self.requests) > 1 else b""))

    def end(self) -> None:
        self._ends = True
        self._thread.join()
        os.close(self.master)
        os.close(self._slave)


def test_firmware_that_answers_only_requests_is_asked_again_when_it_has_answered_or_a_window_later(
    tmp_path: Path,
) -> None:
    begin, end = RIG.index("[device]"), RIG.index("[field]")
    file, prompt = tmp_path / "desk.toml", Prompt()
    file.write_text(f"{RIG[:begin]}{ASKED}{RIG[end:]}", encoding="utf-8")
    try:
        with open_board(load_rig(file), port=prompt.port) as board:
            began, asked = board.now_s(), len(prompt.requests)
            assert asked == 2
            assert prompt.requests[1] - prompt.requests[0] > 0.15, "the first one is not answered in its window"
            settled = wait_until_settled(board, frame_of(board.output.rig))
            assert settled.heading_deg == 12.5
            requests, duration_s = len(prompt.requests) - asked, board.now_s() - began
            assert requests == pytest.approx(duration_s / 0.1, abs=2), "one for each reading"
            quiet = len(prompt.requests)
            board.sleep(0.3)
            assert len(prompt.requests) == quiet
    finally:
        prompt.end()


class ExactLine:
    """A line on which a read takes its timeout and an error of the clock, and brings a heading that goes on moving."""

    timeout, name = 0.0, "exact"

    def __init__(self, error_s: float) -> None:
        self._time_s, self._error_s = 0.0, error_s

    def now(self) -> float:
        return self._time_s

    def write(self, _data: bytes) -> None:
        pass

    def read(self, _size: int) -> bytes:
        self._time_s += self.timeout + self._error_s
        return angles(20.0 * self._time_s)


@pytest.mark.parametrize("error_s", [0.0, 2e-9])
def test_nanoseconds_of_the_clock_do_not_decide_how_long_a_heading_is_waited_for(
    rig: Rig, error_s: float, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("hiltest.boards.real.open_port", lambda *_, **__: ExactLine(error_s))
    board = RealBoard("exact", rig)
    settled = wait_until_settled(board, frame_of(rig))
    assert (settled.is_settled, round(settled.took_s, 3)) == (False, 1.0)


def test_a_heading_that_the_line_has_changed_does_not_count(far_end: Callable[..., FarEnd], rig: Rig) -> None:
    other = far_end(lambda number: angles(123.4 if number % 5 else 20.0))
    with open_board(rig, port=other.port) as board:
        settled = wait_until_settled(board, frame_of(rig))
    assert settled.heading_deg == pytest.approx(123.4)
    assert settled.unconfirmed >= 2, "one in five of two windows of ten"


def test_a_heading_with_a_right_check_sum_needs_no_neighbour(far_end: Callable[..., FarEnd], tmp_path: Path) -> None:
    text = RIG.replace('kind = "fsflk"', 'kind = "text"').replace("[device.fsflk]", "[device.text]")
    pattern = "'HCHDM,(?P<heading>[^,]*),'"
    (tmp_path / "nmea.toml").write_text(text.replace('algorithm = "Q9"', f"patterns = [{pattern}]"), encoding="utf-8")
    rig = load_rig(tmp_path / "nmea.toml")
    # The last one is as the line has changed it: its check sum is that of the first two.
    other = far_end(
        lambda number: (b"$HCHDM,101.1,M*28\r\n", b"$HCHDM,111.1,M*29\r\n", b"$HCHDM,181.1,M*28\r\n")[number % 3]
    )
    with open_board(rig, port=other.port) as board:
        settled = wait_until_settled(board, frame_of(rig))
        assert settled.unconfirmed == 0
        assert settled.heading_deg == pytest.approx(106.1, abs=2.0), "as many of one as of the other, or one more"
        assert board.output.errors.total() > 2
        assert set(board.output.errors) == {"a line has a wrong check sum"}


def test_a_silent_board_is_said_to_be_silent(
    far_end: Callable[..., FarEnd], rig: Rig, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("hiltest.boards.output_interface._SILENT_S", 0.5)
    other = far_end(lambda number: b"")
    with pytest.raises(
        DeviceSilentError, match=r"the firmware sent nothing in 0\.6 s \(wall time\)\. Check that it prints"
    ):
        open_board(rig, port=other.port)


def test_words_that_are_not_understood_are_shown(
    far_end: Callable[..., FarEnd], rig: Rig, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("hiltest.boards.output_interface._SILENT_S", 0.5)
    other = far_end(lambda number: b"heading=12.3\r\n")
    with pytest.raises(
        VersionMismatchError, match=r"none could be interpreted .* its output begins with '.*eading=12\.3"
    ):
        open_board(rig, port=other.port)


def test_an_exception_of_an_interface_of_ones_own_is_named_with_its_kind_and_the_bytes(
    far_end: Callable[..., FarEnd], rig: Rig, monkeypatch: pytest.MonkeyPatch
) -> None:
    def feed(_decoder: FsflkInterface, data: bytes, _time_s: float) -> list[Observation]:
        return [Observation(0.0, {Quantity.HEADING: np.array([float(data)])})]

    monkeypatch.setattr(FsflkInterface, "feed", feed)
    other = far_end(lambda number: b"north")
    with pytest.raises(ConfigError, match=r"device\.kind fsflk: FsflkInterface\.feed .* ValueError .*b'north"):
        open_board(rig, port=other.port)


def test_a_line_that_breaks_is_lost(far_end: Callable[..., FarEnd], rig: Rig) -> None:
    other = far_end(lambda number: angles(10.0))
    board = open_board(rig, port=other.port)
    other.end()
    with pytest.raises(LinkLostError, match="Check cable and power"):
        board.output.observe(2.0)
    board.close()


def test_a_kind_that_there_is_not_is_refused_with_file_and_line(tmp_path: Path) -> None:
    file = tmp_path / "desk.toml"
    file.write_text(RIG.replace('"fsflk"', '"fsflkk"', 1), encoding="utf-8")
    with pytest.raises(ConfigError, match=r"desk\.toml:7: device\.kind: no kind 'fsflkk'; did you mean 'fsflk'\?"):
        open_board(load_rig(file), port="/dev/null")


def test_firmware_that_nobody_names_is_asked_for() -> None:
    rig = load_rig(rig_file(Path(__file__).parent, "nxp-fusion-agm01"))
    with pytest.raises(ConfigError, match=r"names no firmware under test: name it with --firmware ELF"):
        open_board(rig, port=None)


def test_a_rig_without_a_heading_is_refused_before_a_port_is_opened(tmp_path: Path) -> None:
    file = tmp_path / "desk.toml"
    text = "[device.text]\npatterns = ['ROL=(?P<roll>.*)']\n"
    file.write_text(RIG.replace('"fsflk"', '"text"').replace("[device.fsflk]", text, 1).replace('algorithm = "Q9"', ""))
    with pytest.raises(ConfigError, match=r"desk\.toml:7: device\.kind: text offers no heading"):
        open_board(load_rig(file), port="/dev/null")


@pytest.mark.parametrize(
    ("line", "words"),
    [
        ('sources = { heding = "fsflk" }', r"device\.sources\.heding: did you mean 'heading'\?"),
        ('sources = { magnetometer = "fsflk" }', "fsflk does not offer it; it offers .*heading"),
        ('sources = { heading = "text" }', "names text, which kind does not have"),
        ("settle_s = 0.1", "settle_s.* must be at least two windows"),
        ('kind = ["hiltest", "fsflk"]', '"hiltest" excludes other kinds'),
    ],
)
def test_a_device_table_that_contradicts_itself_is_refused(tmp_path: Path, line: str, words: str) -> None:
    file, key = tmp_path / "desk.toml", line.partition(" ")[0]
    stored = "\n".join(line for line in RIG.splitlines() if not (line.startswith(key) and key in ("settle_s",)))
    stored = stored.replace('[device]\nkind = "fsflk"', "[device]" if key == "kind" else '[device]\nkind = "fsflk"')
    file.write_text(stored.replace("[device]", f"[device]\n{line}"), encoding="utf-8")
    with pytest.raises(ConfigError, match=words):
        open_board(load_rig(file), port="/dev/null")
