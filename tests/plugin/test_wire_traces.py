"""A test that fails keeps what went over the line during it, and names the file; one that passes leaves nothing."""

from __future__ import annotations

import json
import os
import re
import tty
from pathlib import Path
from typing import Any

import pytest

# As in conftest.py: numpy and what is built on it cannot be imported twice in one process.
import hiltest.boards
import hiltest.link.trace_text  # noqa: F401
from hiltest.link.transcript import Direction, Transcript
from hiltest.session.wire_traces import file_name

HEAD = """
import pytest
from hiltest.link.messages import Calibrate, ClearPoints, GetCalibration, Select
from hiltest.link.replies import SensorKind
from hiltest.measurement import Limit

"""


def results_of(pytester: pytest.Pytester) -> dict[str, dict[str, Any]]:
    record = json.loads((pytester.path / "hil-out" / "run.json").read_text(encoding="utf-8"))
    return {test["id"].split("::")[-1]: test for test in record["tests"]}


def trace_of(pytester: pytest.Pytester, test: str) -> tuple[Path, list[str]]:
    path = pytester.path / "hil-out" / results_of(pytester)[test]["trace"]
    return path, path.read_text(encoding="utf-8").splitlines()


def test_a_failing_test_keeps_its_own_part_decoded_and_names_the_file(pytester: pytest.Pytester) -> None:
    pytester.makepyfile(
        test_line=HEAD
        + """
def test_good(board):
    board.session.request(ClearPoints())

def test_bad(board):
    board.session.request(GetCalibration(7))

def test_slow(board, measure):
    board.session.request(Select(board.sensor(SensorKind.MAGNETOMETER).sensor_id))
    measure("x", 3.0, "deg", limit=Limit(max=2))

def test_off_the_line(board):
    assert False
"""
    )
    result = pytester.runpytest_inprocess()
    result.assert_outcomes(passed=1, failed=3)
    path, lines = trace_of(pytester, "test_bad")
    assert lines[0] == "# wire trace of test_line.py::test_bad, until its call failed"
    assert re.fullmatch(
        r"# virtual FRDM-K64F, seed \d+; virtual time of the board \[s\], > to the board, < to the host", lines[1]
    )
    frames = [line.split(maxsplit=3) for line in lines[2:]]
    assert [(direction, case) for _, direction, _, case in frames] == [
        (">", "GET_CALIBRATION slot=7"),
        ("<", "GET_CALIBRATION NO_CALIBRATION"),
    ]
    assert frames[0][2] == frames[1][2], "a reply has the number of its request"
    assert 0.2 < float(frames[0][0]) < float(frames[1][0]), "virtual time goes on from power-on"
    raw = Transcript.read(path.with_suffix(".jsonl"))
    assert raw.clock == "virtual"
    assert {entry.direction for entry in raw.entries} == {Direction.TO_BOARD, Direction.TO_HOST}

    shown = f"hil-out/{results_of(pytester)['test_bad']['trace']}"
    result.stdout.fnmatch_lines(["  wire trace of 2 tests: hil-out/traces", "*- wire trace -*", f"*{shown}"])
    for report in ("report.html", "report.md"):
        assert path.stem in (path.parents[1] / report).read_text(encoding="utf-8").replace("\\", "")

    _, selected = trace_of(pytester, "test_slow")
    assert [line.split()[3] for line in selected[2:]] == ["SELECT", "SELECT"]
    assert (results_of(pytester)["test_good"]["trace"], results_of(pytester)["test_off_the_line"]["trace"]) == ("", "")
    stems = {item.stem for item in path.parent.iterdir()}
    assert stems == {file_name("test_line.py::test_bad"), file_name("test_line.py::test_slow")}


def test_a_session_fixture_that_fails_gives_its_part_to_every_test_it_fails(pytester: pytest.Pytester) -> None:
    pytester.makepyfile(
        test_line=HEAD
        + """
@pytest.fixture(scope="session")
def calibrated(board):
    return board.session.request(Calibrate(100, "direct"))

def test_before(board):
    board.session.request(ClearPoints())

def test_one(calibrated):
    pass

def test_between(board):
    board.session.request(ClearPoints())

def test_two(calibrated):
    pass
"""
    )
    pytester.runpytest_inprocess().assert_outcomes(passed=2, errors=2)
    results = results_of(pytester)
    assert results["test_one"]["trace"] == results["test_two"]["trace"] != ""
    _, lines = trace_of(pytester, "test_two")
    assert [line.split(maxsplit=3)[3] for line in lines[2:]] == [
        "CALIBRATE n=100 calibrator=direct iterations=0",
        "CALIBRATE TOO_FEW_POINTS",
    ]


def test_damaged_bytes_are_in_the_trace_and_traces_go_with_the_next_run(pytester: pytest.Pytester) -> None:
    pytester.makepyfile(
        test_line=HEAD
        + """
def test_noise(board):
    board.session.send_raw(b"\\x7enoise\\x7e")
    board.session.request(ClearPoints())
    assert not board
"""
    )
    pytester.runpytest_inprocess().assert_outcomes(failed=1)
    path, lines = trace_of(pytester, "test_noise")
    assert "damaged: 5 bytes between delimiters" in lines[2]
    own = path.with_name("mine.jsonl")
    own.write_text("{}\n")
    pytester.makepyfile(test_line="def test_noise(board):\n    pass\n")
    pytester.runpytest_inprocess().assert_outcomes(passed=1)
    assert list(path.parent.iterdir()) == [own], "what is not ours stays"
    own.unlink()
    pytester.runpytest_inprocess().assert_outcomes(passed=1)
    assert not path.parent.exists()


def test_a_board_that_never_answers_leaves_what_it_was_asked(
    pytester: pytest.Pytester, monkeypatch: pytest.MonkeyPatch
) -> None:
    _silent, slave = os.openpty()
    tty.setraw(slave)
    monkeypatch.setenv("HIL_PORT", os.ttyname(slave))
    pytester.makepyfile(test_line="def test_it(board):\n    pass\n")
    result = pytester.runpytest_inprocess()
    assert result.ret == 20
    _, lines = trace_of(pytester, "test_it")
    assert "wall time of the board" in lines[1]
    assert all(" SYNC nonce=" in line for line in lines[2:])
    assert len(lines) > 2
