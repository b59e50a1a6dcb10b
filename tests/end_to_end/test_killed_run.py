"""Runs of the real commands, killed at random moments: what had finished is in the record, and nothing else is.

How many are killed is in HILTEST_KILLS: 10, and 50 in tox's reliability.
"""

from __future__ import annotations

import os
import random
import shutil
import signal
import subprocess
import sys
import time
from collections.abc import Callable, Mapping
from pathlib import Path

import pytest
from tests.finished_run import run_module

from hiltest.run_record.outcomes import TestOutcome
from hiltest.run_record.reader import read_record
from hiltest.run_record.run import Run

KILLS = int(os.environ.get("HILTEST_KILLS", "10"))
TESTS = 150
WAIT_S = 300.0

# Says before and after the plugin has taken a finished test, in files of its own, that it has.
WITNESS = """
import os
import pytest

def note(what, nodeid):
    out = os.open(what, os.O_WRONLY | os.O_CREAT | os.O_APPEND)
    os.write(out, (nodeid.rpartition("/")[2] + "\\n").encode())
    os.close(out)

@pytest.hookimpl(wrapper=True, tryfirst=True)
def pytest_runtest_logfinish(nodeid):
    note("finishing", nodeid)
    result = yield
    note("finished", nodeid)
    return result
"""
SUITE = f"""
import pytest

@pytest.mark.parametrize("number", range({TESTS}))
def test_many(measure, number):
    measure(f"many.{{number:03d}}", number * 1.5, "deg")
    measure.table(f"rows.{{number:03d}}", {{"n": ""}}, [(number,)] * 20)
"""


class Killed:
    """A command in a folder, which is killed when a number of its tests are through.

    Parameters
    ----------
    folder : Path
    command : list of str
        What follows ``python -m``. Keeps its record in ``out``.
    """

    def __init__(self, folder: Path, *command: str) -> None:
        self.folder = folder
        self._command = [sys.executable, "-m", *command]
        (folder / "witness.py").write_text(WITNESS, encoding="utf-8")
        paths = [str(folder), *filter(None, [os.environ.get("PYTHONPATH")])]
        kept = {name: value for name, value in os.environ.items() if not name.startswith("HIL_")}
        self._environment = kept | {"PYTHONPATH": os.pathsep.join(paths)}

    def run(self, *, kill_after: int, later_s: float) -> bool:
        """Run the command and kill it `later_s` after so many tests; return whether it was still there to be killed."""
        with subprocess.Popen(
            self._command, cwd=self.folder, env=self._environment, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL
        ) as running:
            ends_s = time.monotonic() + WAIT_S
            while len(self.witnessed("finishing")) < kill_after and running.poll() is None:
                assert time.monotonic() < ends_s, "the tests do not go on"
                time.sleep(0.002)
            time.sleep(later_s)
            running.kill()
        return running.returncode == -signal.SIGKILL

    def witnessed(self, case: str) -> list[str]:
        path = self.folder / case
        return path.read_text(encoding="utf-8").splitlines() if path.exists() else []

    def report(self) -> subprocess.CompletedProcess[str]:
        return run_module("hiltest", "report", "out", folder=self.folder, environment=self._environment)

    def check(self, expected: Callable[[list[str]], Mapping[str, object]]) -> Run | None:
        """Check what is left; `expected` says what finished tests have measured, volatile values left out."""
        finishing, finished = self.witnessed("finishing"), self.witnessed("finished")
        done = self.report()
        if done.returncode == 4:
            assert "no record of a run" in done.stderr
            assert finishing == []
            return None
        assert done.returncode == 0, done.stderr
        run = read_record(self.folder / "out").run
        if run.verdict.sentence == "PASS of the run before.":
            assert finishing == []
            return None
        assert done.stdout.splitlines()[-1] == run.verdict.sentence
        tests = [test.id for test in run.tests]
        assert tests in (finished, finishing)
        measured = {measurement.name: measurement.value for measurement in run.measurements if not measurement.volatile}
        if run.verdict.outcome == "cut short":
            # What the end of the session measures, behind its last test, may be there already.
            session = {measurement.name for measurement in run.measurements if not measurement.test}
            assert session <= {"board.virtual_seconds", "board.wall_seconds"}
            assert {name: value for name, value in measured.items() if name not in session} == expected(tests)
            assert not run.verdict.complete
        page = (self.folder / "out" / "report.html").read_text(encoding="utf-8")
        assert run.verdict.outcome != "cut short" or run.verdict.sentence.split(";")[0].partition(": ")[2] in page
        assert [name for name in measured if name not in page] == []
        return run


def _before(folder: Path) -> None:
    """Leave the record of an earlier run of the same tests in a folder, with a measurement that no other run has."""
    from hiltest.measurement import check
    from hiltest.report.render import write_reports
    from hiltest.run_record.journal import Journal
    from hiltest.run_record.recorder import Recorder
    from hiltest.run_record.run import TestResult, Verdict

    (folder / "out").mkdir()
    recorder = Recorder(Journal(folder / "out"), suite="gate", poses="all")
    recorder.begin()
    recorder.add([check("before.value", 1.0, unit="deg")], ())
    recorder.finish_test(TestResult("test_many.py::test_many[0]", TestOutcome.PASSED, 0.1))
    run = recorder.finish(Verdict("pass", 0, "PASS of the run before.", complete=True))
    write_reports(run, folder / "out")
    recorder.release()


@pytest.mark.parametrize("number", range(KILLS))
def test_a_run_of_many_tests_that_is_killed_leaves_each_that_had_finished(number: int, tmp_path: Path) -> None:
    dice = random.Random(number)
    if number % 2:
        _before(tmp_path)
    (tmp_path / "test_many.py").write_text(SUITE, encoding="utf-8")
    killed = Killed(tmp_path, "pytest", "-p", "witness", "-p", "no:cacheprovider", "--hil-out=out")
    # One in ten somewhere on the way to the first test, and as many at the end.
    if number % 10 == 9:
        killed.run(kill_after=0, later_s=dice.uniform(0.0, 3.0))
    elif number % 10 == 8:
        killed.run(kill_after=TESTS, later_s=dice.uniform(0.0, 0.2))
    else:
        assert killed.run(kill_after=dice.randrange(1, TESTS), later_s=dice.uniform(0.0, 0.01))

    def expected(tests: list[str]) -> Mapping[str, object]:
        numbers = [int(test.partition("[")[2].rstrip("]")) for test in tests]
        return {f"many.{number:03d}": number * 1.5 for number in numbers}

    run = killed.check(expected)
    if number % 10 < 8:
        assert run is not None
        assert run.verdict.outcome == "cut short"
        assert [table.name for table in run.tables] == [f"rows.{index:03d}" for index in range(len(run.tests))]


@pytest.mark.parametrize("number", range(max(2, KILLS // 10)))
def test_the_main_job_that_is_killed_leaves_what_it_had_measured(number: int, good_run, tmp_path: Path) -> None:
    dice = random.Random(1000 + number)
    tests = good_run.record["tests"]
    whole = {
        measurement["name"]: measurement
        for measurement in good_run.record["measurements"]
        if measurement["test"] and not measurement["volatile"]
    }
    killed = Killed(tmp_path, "hiltest", "run", "--out", "out", "--", "-p", "witness")
    assert killed.run(kill_after=dice.randrange(1, len(tests)), later_s=dice.uniform(0.0, 0.5))

    def expected(finished: list[str]) -> Mapping[str, object]:
        return {name: item["value"] for name, item in whole.items() if item["test"].rpartition("/")[2] in finished}

    run = killed.check(expected)
    assert run is not None
    assert run.board is not None
    assert run.board.build_id == good_run.record["board"]["build_id"]


def test_a_run_that_goes_on_keeps_its_folder_and_can_be_looked_at(tmp_path: Path) -> None:
    (tmp_path / "test_slow.py").write_text(
        "import pathlib, time\n"
        "def test_one(measure):\n    measure('first', 1, '')\n"
        f"def test_two(measure):\n    ends_s = time.monotonic() + {WAIT_S}\n"
        "    while not pathlib.Path('go').exists():\n"
        "        assert time.monotonic() < ends_s\n"
        "        time.sleep(0.01)\n"
        "    measure('second', 2, '')\n",
        encoding="utf-8",
    )
    killed = Killed(tmp_path, "pytest")
    command = [sys.executable, "-m", "pytest", "-p", "witness", "--hil-out=out", "test_slow.py"]
    environment = killed._environment
    with subprocess.Popen(command, cwd=tmp_path, env=environment, stdout=subprocess.DEVNULL) as running:
        ends_s = time.monotonic() + WAIT_S
        while not killed.witnessed("finished") and running.poll() is None and time.monotonic() < ends_s:
            time.sleep(0.01)
        looked = killed.report()
        second = run_module("hiltest", "run", "--out", "out", folder=tmp_path, environment=environment)
        (tmp_path / "go").touch()
        assert running.wait(timeout=WAIT_S) == 0
    assert looked.returncode == 0, looked.stderr
    assert looked.stdout.splitlines()[-1].startswith("STILL RUNNING: 1 test finished, 1 measurement kept")
    assert second.returncode == 4
    assert f"ERROR: the folder {tmp_path / 'out'} is in use by process {running.pid} on " in second.stderr
    assert "name another folder with --out" in second.stderr
    run = read_record(tmp_path / "out").run
    assert [measurement.name for measurement in run.measurements] == ["first", "second"]
    assert run.verdict.outcome == "pass"
    for page in ("report.html", "report.md"):
        assert "STILL RUNNING" not in (tmp_path / "out" / page).read_text(encoding="utf-8")


def test_two_runs_that_begin_in_one_folder_at_once_do_not_mix(tmp_path: Path) -> None:
    (tmp_path / "test_many.py").write_text(SUITE, encoding="utf-8")
    shutil.copy(tmp_path / "test_many.py", tmp_path / "test_much.py")
    command = [sys.executable, "-m", "pytest", "-p", "no:cacheprovider", "--hil-out=out"]
    environment = {name: value for name, value in os.environ.items() if not name.startswith("HIL_")}
    names = ("test_many.py", "test_much.py")
    pipes = {"stdout": subprocess.PIPE, "stderr": subprocess.PIPE, "text": True}
    both = [subprocess.Popen([*command, name], cwd=tmp_path, env=environment, **pipes) for name in names]
    errors = [item.communicate(timeout=WAIT_S)[1] for item in both]
    codes = [item.returncode for item in both]
    # One was first, unless it was through before the other had begun.
    assert sorted(codes) in ([0, 4], [0, 0])
    run = read_record(tmp_path / "out").run
    assert len({test.id.partition("::")[0] for test in run.tests}) == 1
    assert (len(run.tests), len(run.measurements)) == (TESTS, TESTS)
    for name, code, text in zip(names, codes, errors, strict=True):
        if code:
            assert "is in use by" in text
            assert name not in {test.id.partition("::")[0] for test in run.tests}
