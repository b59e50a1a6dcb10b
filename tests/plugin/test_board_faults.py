"""Whose fault it is: a board that was reset, and a sensor that fails on a bench or on a virtual board."""

from __future__ import annotations

import json
from typing import Any

import pytest

from hiltest.rig.bench_files import shipped

RESET = 'reset = { by = "button", after_s = 0.5 }'
FROZEN = 'sensor = { part = "mag3110", fault = "frozen", after_s = 0.5 }'


def run(pytester: pytest.Pytester, faults: str, tests: str, *options: str) -> tuple[int, dict[str, dict[str, Any]]]:
    rig = (shipped() / "rigs" / "virtual-k64f.toml").read_text(encoding="utf-8").partition("[limits]")[0]
    (pytester.path / "rig.toml").write_text(f"{rig}\n[faults]\n{faults}\n" if faults else rig, encoding="utf-8")
    pytester.makepyfile(tests)
    done = pytester.runpytest_inprocess("--hil-rig=rig.toml", "--hil-out=out", *options)
    record = json.loads((pytester.path / "out" / "run.json").read_text(encoding="utf-8"))
    return int(done.ret), {test["id"].rpartition("::")[2]: test for test in record["tests"]}


def test_a_fixture_that_fails_on_a_board_that_was_reset_is_not_what_failed(pytester: pytest.Pytester) -> None:
    code, tests = run(
        pytester,
        RESET,
        """
        import numpy as np, pytest
        from hiltest.link.messages import GetCalibration, SetCalibration

        @pytest.fixture(scope="module")
        def stored(board):
            board.session.request(SetCalibration(1, np.eye(3), np.zeros(3)))
            board.sleep(1.0)
            return board.session.request(GetCalibration(1))  # NO_CALIBRATION

        def test_one(stored): pass
        def test_next(board): pass
        def test_of_no_board(): pass
    """,
    )
    assert code == 20
    assert tests["test_one"]["outcome"] == "connection lost"
    assert "the board was reset" in tests["test_one"]["reason"]
    assert tests["test_next"]["outcome"] == "skipped"


def test_what_was_measured_of_a_board_that_was_reset_is_not_recorded_and_what_was_before_is(
    pytester: pytest.Pytester,
) -> None:
    code, tests = run(
        pytester,
        RESET,
        """
        from hiltest.link.messages import Average

        def test_one(board, measure):
            measure("own.before", board.session.request(Average(8)).n)
            board.sleep(1.0)
            measure("own.after", board.session.request(Average(8)).n)
    """,
    )
    record = json.loads((pytester.path / "out" / "run.json").read_text(encoding="utf-8"))
    measured = {measurement["name"] for measurement in record["measurements"]}
    assert code == 20
    assert tests["test_one"]["outcome"] == "connection lost"
    assert "own.before" in measured
    assert "own.after" not in measured


AVERAGE = """
    from hiltest.link.messages import Average

    def test_one(board):
        board.sleep(1.0)
        board.session.request(Average(16))

    def test_next(board):
        assert board.identity.max_points
"""


def test_a_sensor_that_is_stuck_is_the_benchs_fault_and_what_needs_none_runs(pytester: pytest.Pytester) -> None:
    code, tests = run(pytester, FROZEN, AVERAGE)
    assert code == 20
    assert tests["test_one"]["outcome"] == "connection lost"
    assert "MAG3110: 16 consecutive samples are identical" in tests["test_one"]["reason"]
    assert tests["test_next"]["outcome"] == "passed"


def test_on_a_virtual_board_with_sound_sensors_it_is_the_firmwares(pytester: pytest.Pytester) -> None:
    code, tests = run(
        pytester,
        "",
        """
        import numpy as np, pytest
        from hiltest.link.messages import Average, Read
        from hiltest.link.replies import Statistic

        def test_one(board):
            still = Statistic(np.ones(3), np.zeros(3))
            reply = board.session.request(Average(16))
            object.__setattr__(reply, "magnetometer", still)  # as firmware that reads no new samples answers
            board.protocol.sample_checks.reply(reply)

        def test_two(board):
            board.session.request(Read(2, 1, timeout_us=1))
    """,
    )
    assert code == 1
    assert tests["test_one"]["outcome"] == "failed"
    assert "the firmware reads no new samples" in tests["test_one"]["reason"]
    assert tests["test_two"]["outcome"] == "failed"
    assert "SENSOR_TIMEOUT" in tests["test_two"]["reason"]
