"""pytest-xdist: tests that use hiltest run in one worker, and the record is the one that a single process writes."""

from __future__ import annotations

import json
from typing import Any

import pytest

from ..finished_run import without_volatile

pytest.importorskip("xdist")

GROUPED = ("-n2", "--dist=loadgroup")
ALONE = ("-n2",)

BOARD = """
import os
import pytest
from hiltest.measurement import Limit

@pytest.mark.parametrize("k", range(4))
def test_of_a_project(k):
    pass

def test_slots(board, measure):
    measure("board.slots", board.identity.slots, "", limit=Limit(min=1))

def test_name(board, measure):
    measure.table("name", {"letter": ""}, [[each] for each in board.identity.name])
"""
MORE = """
import os
from hiltest.measurement import Limit

def test_noise(measure):
    measure("lamp.noise", 4.5, "uV", limit=Limit(max=5))

def test_process(measure, board):
    measure("host.process", os.getpid(), "", volatile=True)
"""


def record_of(pytester: pytest.Pytester) -> dict[str, Any]:
    content: dict[str, Any] = json.loads((pytester.path / "hil-out" / "run.json").read_text(encoding="utf-8"))
    return content


@pytest.mark.parametrize("options", [ALONE, GROUPED], ids=" ".join)
def test_two_workers_write_the_record_that_one_process_does(
    pytester: pytest.Pytester, options: tuple[str, ...]
) -> None:
    pytester.makepyfile(test_board=BOARD, test_more=MORE)
    assert pytester.runpytest_inprocess().ret == 0
    alone = record_of(pytester)
    result = pytester.runpytest_inprocess(*options)
    assert result.ret == 0
    result.stdout.fnmatch_lines(["PASS."])
    shared = record_of(pytester)
    for item in (alone, shared):
        item["tests"].sort(key=lambda test: str(test["id"]))
    assert without_volatile(shared) == without_volatile(alone)
    assert shared["board"]["firmware"] == "hiltest-frdm-k64f"
    assert {"board.slots", "board.virtual_seconds", "lamp.noise"} <= {
        measurement["name"] for measurement in shared["measurements"]
    }


def test_tests_of_one_board_in_several_workers_are_refused(pytester: pytest.Pytester) -> None:
    pytester.makepyfile(test_board=BOARD, test_more=MORE)
    result = pytester.runpytest_inprocess("-n2", "--dist=loadfile")
    assert result.ret == pytest.ExitCode.USAGE_ERROR
    result.stderr.fnmatch_lines(
        [
            "ERROR: 2 workers, and test_board.py::test_slots uses hiltest: * must run in one worker. "
            "Leave out --dist loadfile, or -n"
        ]
    )
    assert not (pytester.path / "hil-out" / "run.json").exists()


def test_a_test_that_has_a_group_of_its_own_is_refused(pytester: pytest.Pytester) -> None:
    pytester.makepyfile("""
        import pytest

        @pytest.mark.xdist_group("oven")
        def test_warm(measure):
            pass
    """)
    result = pytester.runpytest_inprocess(*GROUPED)
    assert result.ret == pytest.ExitCode.USAGE_ERROR
    result.stderr.fnmatch_lines(["ERROR: *::test_warm@hil_oven uses hiltest, * not in the xdist_group 'hil' alone*"])


def test_a_rig_that_is_wrong_is_the_same_usage_error(
    pytester: pytest.Pytester, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("HIL_RIG", "no-such-rig.toml")
    pytester.makepyfile(BOARD)
    result = pytester.runpytest_inprocess("-n1")
    assert result.ret == pytest.ExitCode.USAGE_ERROR
    result.stderr.fnmatch_lines(["ERROR: *no-such-rig.toml*"])


def test_firmware_that_is_none_is_the_same_usage_error(pytester: pytest.Pytester) -> None:
    pytester.makefile(".elf", mine="no ELF")
    pytester.makepyfile(BOARD)
    result = pytester.runpytest_inprocess(*GROUPED, "--hil-firmware=mine.elf")
    assert result.ret == pytest.ExitCode.USAGE_ERROR
    result.stderr.fnmatch_lines(["ERROR: *mine.elf*"])


def test_a_lost_bench_keeps_its_exit_code(pytester: pytest.Pytester) -> None:
    pytester.makepyfile("""
        from hiltest.errors import LinkLostError

        def test_plain():
            pass

        def test_lost(measure):
            measure("lamp.current", 2.0, "mA")
            raise LinkLostError("/dev/ttyACM0", "unplugged")
    """)
    assert pytester.runpytest_inprocess(*GROUPED).ret == 20
    record = record_of(pytester)
    assert {test["outcome"] for test in record["tests"]} == {"passed", "connection lost"}
    assert [measurement["name"] for measurement in record["measurements"]] == ["lamp.current"]


@pytest.mark.parametrize("options", [ALONE, GROUPED], ids=" ".join)
def test_a_worker_that_dies_is_a_failed_test_in_the_record(pytester: pytest.Pytester, options: tuple[str, ...]) -> None:
    pytester.makepyfile("""
        import os

        def test_before(measure):
            measure("lamp.current", 2.0, "mA")

        def test_dies(measure):
            os._exit(7)
    """)
    # pytest-xdist gives the test to each new worker that replaces a dead one: here to one.
    assert pytester.runpytest_inprocess(*options, "--max-worker-restart=1").ret == 1
    tests = {test["id"].split("::")[1]: test for test in record_of(pytester)["tests"]}
    assert tests["test_before"]["outcome"] == "passed"
    assert tests["test_dies"]["outcome"] == "error"
    assert "crashed while running" in tests["test_dies"]["reason"]
    assert [measurement["name"] for measurement in record_of(pytester)["measurements"]] == ["lamp.current"]


def test_other_tests_are_spread_over_the_workers_and_those_of_hiltest_are_not(pytester: pytest.Pytester) -> None:
    pytester.makepyfile("""
        import os, time
        from pathlib import Path
        import pytest

        @pytest.mark.parametrize("k", range(6))
        def test_of_a_project(k):
            Path(f"{os.getpid()}.worker").touch()
            for _ in range(600):  # until the other worker has had one too, or a minute has passed
                if len(list(Path().glob("*.worker"))) == 2:
                    return
                time.sleep(0.1)

        @pytest.mark.parametrize("k", range(6))
        def test_lamp(measure, k):
            measure(f"process.{k}", os.getpid(), "", volatile=True)
    """)
    result = pytester.runpytest_inprocess(*ALONE, "-v")
    assert result.ret == 0
    lines = [line.split() for line in result.outlines if "PASSED" in line]
    workers = {name: {line[0] for line in lines if name in line[-1]} for name in ("of_a_project", "test_lamp")}
    assert {name: len(worker) for name, worker in workers.items()} == {"of_a_project": 2, "test_lamp": 1}
    assert len({measurement["value"] for measurement in record_of(pytester)["measurements"]}) == 1


def test_who_distributes_tests_without_hiltest_notices_nothing(pytester: pytest.Pytester) -> None:
    pytester.makepyfile("def test_it():\n    pass\n\ndef test_other():\n    pass\n")
    result = pytester.runpytest_inprocess("-n2", "--hil-rig=no-such-rig.toml")
    result.assert_outcomes(passed=2)
    assert not (pytester.path / "hil-out").exists()


def test_a_report_that_leaves_the_process_is_plain_data_and_comes_back_whole(pytester: pytest.Pytester) -> None:
    """As pytest-reportlog writes them to a file."""
    pytester.makepyfile(MORE.replace("(measure, board)", "(measure)"))
    pytester.makeconftest("""
        import json

        def pytest_runtest_logreport(report):
            if report.when == "call" and "noise" in report.nodeid:
                data = json.loads(json.dumps(hooks.pytest_report_to_serializable(config=config, report=report)))
                again = hooks.pytest_report_from_serializable(config=config, data=data)
                assert again.hil_found.measurements == report.hil_found.measurements
                assert again.hil_found.tables == report.hil_found.tables
                print("came back:", *again.hil_found.measurements)

        def pytest_configure(config):
            globals().update(config=config, hooks=config.hook)
    """)
    result = pytester.runpytest_inprocess("-s")
    assert result.ret == 0
    result.stdout.fnmatch_lines(["*came back: lamp.noise = 4.5 uV, limit at most 5: pass"])
