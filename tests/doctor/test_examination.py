"""All checks in their order, against real firmware behind a pseudo-terminal and lines that have something wrong."""

from __future__ import annotations

import os
import termios
import threading
import tty
from collections.abc import Callable, Iterable, Iterator
from contextlib import contextmanager
from dataclasses import replace
from datetime import date
from pathlib import Path
from typing import Any

import pytest
from tests.usb_tree import K64F, SECOND_K64F, UsbTree

from hiltest.doctor.board_checks import BOARD_CHECKS
from hiltest.doctor.check import Check, Health, exit_code
from hiltest.doctor.examination import examine
from hiltest.doctor.host_checks import HOST_CHECKS
from hiltest.errors import SeveralBoardsError
from hiltest.link.framing import Frame, FrameDecoder, encode_frame
from hiltest.link.messages import PROTOCOL_VERSION, Sync
from hiltest.link.request import REPLY_BIT
from hiltest.rig import Rig
from hiltest.rig.board_faults import BoardReset, SensorFault
from hiltest.rig.faults import Faults
from hiltest.run_record.exit_codes import ExitCode

TODAY = date(2026, 6, 1)
ByName = Callable[[Iterable[Check]], dict[str, Check]]
StartPtyBoard = Callable[[Rig], Any]
ALL = (*HOST_CHECKS, "turntable", "poses", "answer", *BOARD_CHECKS, "measured field", "declared field")


@pytest.mark.slow
def test_a_board_that_is_plugged_in_is_found_and_looked_at_to_the_end(
    pty_board: StartPtyBoard, rig: Rig, real_rig: Rig, tree: UsbTree, by_name: ByName
) -> None:
    tree.plug_in(behind=Path(pty_board(rig).path), disk="sdb", mounted="/media/me/DAPLINK")
    checks = by_name(examine(real_rig, root=tree.root, today=TODAY))
    assert (*checks,) == ALL
    assert exit_code([*checks.values()]) is ExitCode.OK
    assert K64F in checks["board"].finding
    # No rules in the tree. A board on a busy machine may lag behind the wall clock.
    unwell = {name for name, check in checks.items() if check.health is not Health.OK} - {"clock"}
    assert unwell == {"udev rules", "turntable", "measured field", "declared field"}


def test_without_a_board_what_needs_none_is_looked_at(real_rig: Rig, tree: UsbTree, by_name: ByName) -> None:
    placed = replace(real_rig, field=replace(real_rig.field, latitude_deg=46.0, longitude_deg=8.9))
    checks = by_name(examine(placed, root=tree.root, today=TODAY))
    assert (*checks,) == ALL
    assert checks["board"].health is Health.FAILED
    assert checks["declared field"].health is not Health.NOT_LOOKED_AT
    assert {checks[name].health for name in ("permission", "answer", *BOARD_CHECKS)} == {Health.NOT_LOOKED_AT}
    assert exit_code([*checks.values()]) is ExitCode.CONNECTION_LOST


def test_a_board_without_its_shield_is_looked_at_as_far_as_it_goes(rig_without_shield: Rig, by_name: ByName) -> None:
    checks = by_name(examine(rig_without_shield, today=TODAY))
    assert (*checks,) == ALL
    assert checks["sensors"].health is Health.FAILED
    assert {checks[name].health for name in ("identity", "clock", "cycle counter")} == {Health.OK}
    assert {checks[name].health for name in ("magnetometer noise", "gyroscope noise")} == {Health.NOT_LOOKED_AT}
    assert exit_code([*checks.values()]) is ExitCode.CONNECTION_LOST


def test_a_port_elsewhere_that_nobody_serves_needs_no_other_cable(real_rig: Rig, by_name: ByName) -> None:
    answer = by_name(examine(real_rig, port="socket://127.0.0.1:1", today=TODAY))["answer"]
    assert answer.health is Health.FAILED
    assert "its server runs" in answer.remedy


def test_two_boards_are_no_choice_of_ours(real_rig: Rig, tree: UsbTree) -> None:
    tree.plug_in()
    tree.plug_in(serial=SECOND_K64F, tty="ttyACM1")
    with pytest.raises(SeveralBoardsError):
        [*examine(real_rig, root=tree.root, today=TODAY)]


def test_a_port_that_another_program_has_is_not_opened(real_rig: Rig, tree: UsbTree, by_name: ByName) -> None:
    with answering(lambda _data, _baud: b"") as path:
        tree.plug_in(behind=Path(path))
        (tree.root / "proc/4711/fd").mkdir(parents=True)
        (tree.root / "proc/4711/comm").write_text("minicom\n")
        (tree.root / "proc/4711/fd/3").symlink_to(path)
        checks = by_name(examine(real_rig, root=tree.root, today=TODAY))
    assert "minicom" in checks["port"].finding
    assert checks["answer"].health is Health.NOT_LOOKED_AT


@contextmanager
def answering(reply: Callable[[bytes, int], bytes]) -> Iterator[str]:
    """Serve a pseudo-terminal: what comes, and the speed that the other end has set, make what goes back."""
    far, near = os.openpty()
    tty.setraw(near)
    ended = threading.Event()

    def serve() -> None:
        os.set_blocking(far, False)
        while not ended.wait(0.01):
            try:
                data = os.read(far, 4096)
            except OSError:
                continue
            os.write(far, reply(data, termios.tcgetattr(far)[5]))

    thread = threading.Thread(target=serve)
    thread.start()
    try:
        yield os.ttyname(near)
    finally:
        ended.set()
        thread.join()
        os.close(far)
        os.close(near)


class Synchronised:
    """A board that answers SYNC alone, at one speed."""

    def __init__(self, baud: int, version: int = PROTOCOL_VERSION) -> None:
        self._decoder, self._baud, self._version = FrameDecoder(), baud, version

    def __call__(self, data: bytes, baud: int) -> bytes:
        if baud != self._baud:
            return b"\xf8" * len(data)
        frames = [item for item in self._decoder.feed(data) if isinstance(item, Frame) and item.type == Sync.code]
        return b"".join(
            encode_frame(
                Frame(
                    frame.type | REPLY_BIT,
                    frame.sequence,
                    b"\0" + frame.payload + self._version.to_bytes(2, "little"),
                )
            )
            for frame in frames
        )


@pytest.mark.slow
def test_another_baud_rate_that_answers_is_named(real_rig: Rig, tmp_path: Path, by_name: ByName) -> None:
    with answering(Synchronised(termios.B57600)) as path:
        checks = by_name(examine(real_rig, port=path, root=tmp_path, today=TODAY))
    assert checks["answer"].health is Health.FAILED
    assert "57600" in checks["answer"].finding
    assert "baud = 57600" in checks["answer"].remedy
    assert exit_code([*checks.values()]) is ExitCode.CONNECTION_LOST


def test_another_version_of_the_protocol_is_wrong_firmware(real_rig: Rig, tmp_path: Path, by_name: ByName) -> None:
    with answering(Synchronised(termios.B115200, PROTOCOL_VERSION + 1)) as path:
        checks = by_name(examine(real_rig, port=path, root=tmp_path, today=TODAY))
    assert checks["answer"].health is Health.OK
    assert str(PROTOCOL_VERSION + 1) in checks["protocol"].finding
    assert checks["protocol"].remedy.startswith(f"hiltest flash --port {path} --probe pyocd, ")
    assert checks["identity"].health is Health.NOT_LOOKED_AT
    assert exit_code([*checks.values()]) is ExitCode.WRONG_FIRMWARE


def test_firmware_that_prints_lines_is_to_be_flashed_over_unless_it_is_meant(
    real_rig: Rig, tree: UsbTree, by_name: ByName
) -> None:
    with answering(lambda data, _baud: b"compass. heading 12\r\n" if data else b"") as path:
        tree.plug_in(behind=Path(path))
        checks = by_name(examine(real_rig, root=tree.root, today=TODAY))
    assert (checks["answer"].health, checks["protocol"].health) == (Health.OK, Health.FAILED)
    assert checks["protocol"].remedy == f"hiltest flash --port usb://{K64F}, unless the firmware is yours"
    assert exit_code([*checks.values()]) is ExitCode.WRONG_FIRMWARE


@pytest.mark.slow
def test_a_board_on_which_nothing_answers_at_any_rate_is_to_be_flashed(
    real_rig: Rig, tree: UsbTree, by_name: ByName
) -> None:
    with answering(lambda _data, _baud: b"") as path:
        tree.plug_in(behind=Path(path))
        checks = by_name(examine(real_rig, root=tree.root, today=TODAY))
    assert checks["answer"].health is Health.FAILED
    assert "no other byte" in checks["answer"].finding
    assert checks["answer"].remedy == f"hiltest flash --port usb://{K64F}"
    assert exit_code([*checks.values()]) is ExitCode.CONNECTION_LOST


@pytest.mark.slow
@pytest.mark.parametrize(
    ("fault", "name", "words"),
    [
        (SensorFault("mag3110", "frozen"), "magnetometer noise", "MAG3110: 64 consecutive samples are identical"),
        (SensorFault("fxos8700cq", "saturated"), "accelerometer noise", "accelerometer: its y axis is at the end"),
        (SensorFault("fxas21002c", "frozen"), "gyroscope noise", "FXAS21002C: 400 consecutive samples are identical"),
    ],
)
def test_a_sensor_that_fails_is_named_by_its_own_check_and_the_others_are_made(
    rig: Rig, by_name: ByName, fault: SensorFault, name: str, words: str
) -> None:
    checks = by_name(examine(replace(rig, faults=Faults(sensor=fault)), today=TODAY))
    of_noise = {check for check in checks if check.endswith("noise")}
    assert {item for item in of_noise if checks[item].health is Health.FAILED} == {name}
    assert {checks[item].health for item in of_noise - {name}} == {Health.OK}
    assert words in checks[name].finding


def test_a_board_that_is_reset_while_it_is_looked_at_has_failed(rig: Rig, by_name: ByName) -> None:
    checks = by_name(examine(replace(rig, faults=Faults(reset=BoardReset("brown-out", 1.4))), today=TODAY))
    assert checks["clock"].health is Health.FAILED
    assert "the board was reset" in checks["clock"].finding
    assert "weak supply" in checks["clock"].remedy
    assert checks["magnetometer noise"].health is Health.NOT_LOOKED_AT


def test_a_board_that_is_unplugged_in_the_middle_leaves_the_rest_out(
    pty_board: StartPtyBoard, rig: Rig, real_rig: Rig, tmp_path: Path, by_name: ByName
) -> None:
    board = pty_board(rig)
    checks = []
    for item in examine(real_rig, port=board.path, root=tmp_path, today=TODAY):
        checks.append(item)
        if item.name == "sensors":
            board.unplug()
    result = by_name(checks)
    assert (*result,) == ALL
    assert result["clock"].health is Health.FAILED
    assert {result[name].health for name in ("cycle counter", "gyroscope noise", "measured field")} == {
        Health.NOT_LOOKED_AT
    }
    assert exit_code(checks) is ExitCode.CONNECTION_LOST
