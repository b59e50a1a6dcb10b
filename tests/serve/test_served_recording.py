"""``hiltest serve --replay``: the line of a recorded run for a program, at its pace, or where it sends other bytes."""

from __future__ import annotations

import time
from pathlib import Path

import pytest

from hiltest.boards import BoardKind, RealBoard, open_board
from hiltest.errors import HiltestError
from hiltest.link.messages import Average, LinkStatistics, Points
from hiltest.link.ports import open_port
from hiltest.link.session import Session
from hiltest.link.transcript import Direction, Transcript
from hiltest.rig.bench_files import shipped
from hiltest.rig.rig_file import load_rig
from hiltest.tape.recorded_run import RecordedRun
from hiltest.tape.tape_recorder import Recorder
from hiltest.tape.values import plain

from .conftest import Serve

RIG = load_rig(shipped() / "rigs" / "virtual-k64f.toml")
ABOUT = plain(RecordedRun("0", "2026-01-01T00:00:00Z", "rig.toml", "", False, None, None, "gate"))


@pytest.fixture
def recording(tmp_path: Path) -> tuple[Path, list[float]]:
    """A recorded session of the virtual board, and the mean that its one long request was answered with."""
    path = tmp_path / "run.jsonl.gz"
    recorder = Recorder(path, ABOUT)
    with open_board(RIG, tape=recorder) as board:
        recorder.begin_test("test_average")
        answered = board.session.request(Average(40))
        board.session.request(LinkStatistics())
        recorder.end()
    return path, list(answered.magnetometer.mean)


@pytest.mark.parametrize("arguments", [[], ["--tcp", "0"]], ids=["pty", "tcp"])
def test_a_program_gets_the_recorded_answers_as_late_as_they_came_and_the_next_one_gets_them_too(
    serve: Serve, recording: tuple[Path, list[float]], arguments: list[str]
) -> None:
    path, mean = recording
    served = serve("--replay", str(path), *arguments)
    for last in (False, True):
        with RealBoard(served.board, RIG) as board:
            assert board.kind is BoardKind.REPLAY
            assert board.cycle_model == "undeclared@sram", "it must not pass for a board that it was recorded of"
            began_s = time.monotonic()
            again = board.session.request(Average(40))
            assert time.monotonic() - began_s > 0.4, "40 samples at 80 a second"
            assert list(again.magnetometer.mean) == mean
            if last:
                board.session.request(LinkStatistics())
    code, answer = served.ended()
    assert code == 0, answer
    assert "the recording is at its end" in answer


def test_other_bytes_end_it_with_both_and_their_place(serve: Serve, recording: tuple[Path, list[float]]) -> None:
    served = serve("--replay", str(recording[0]))
    with RealBoard(served.board, RIG) as board, pytest.raises(HiltestError):
        board.session.request(Points(0, 1))
    code, answer = served.ended()
    assert code == 20
    assert "the program sends POINTS first=0 count=1" in answer
    assert "in test_average had AVERAGE" in answer
    assert "run.jsonl.gz:" in answer


def test_lines_come_as_late_as_they_were_printed_and_a_command_must_be_the_recorded_one(serve: Serve) -> None:
    """The by-hand recording of a compass that prints ten lines a second, and is never told anything."""
    path = Path(__file__).parents[2] / "fixtures" / "recordings" / "text-by-hand.jsonl.gz"
    entries = [entry for entry in Transcript.read(path).entries if entry.direction is Direction.TO_HOST and entry.data]
    recorded, took_s = b"".join(entry.data for entry in entries), entries[-1].time_s - entries[0].time_s
    served = serve("--replay", str(path))
    port = open_port(served.board)
    began_s, heard = time.monotonic(), b""
    while len(heard) < len(recorded) and time.monotonic() < began_s + 20.0:
        heard += port.read_until(b"\n")
    assert heard == recorded
    assert time.monotonic() - began_s > took_s - 0.2 > 2.0, "as long as it took"
    port.write(b"cal\n")
    code, ended = served.ended()
    assert code == 20
    assert r"the program sends 'cal\n'" in ended
    assert "is at its end" in ended
    port.close()


def test_a_session_with_nonces_of_its_own_is_synchronised(serve: Serve, recording: tuple[Path, list[float]]) -> None:
    served = serve("--replay", str(recording[0]))
    for seed in range(5):
        session = Session(open_port(served.board), nonce_seed=seed)
        session.synchronise()
        session.close()
        time.sleep(0.1)  # until the server has seen it go


def test_a_bench_is_not_served_beside_a_recording(serve: Serve, recording: tuple[Path, list[float]]) -> None:
    with pytest.raises(AssertionError, match="--replay serves a recorded line"):
        serve("--replay", str(recording[0]), "--seed", "2")
