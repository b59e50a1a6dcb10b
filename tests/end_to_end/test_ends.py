"""Ends of a command that are not its own, in every mode: signals, limits, a failing output, a killed worker."""

from __future__ import annotations

import errno
import os
import pty
import random
import signal
import subprocess
import sys
from pathlib import Path

import pytest
from tests.end_to_end.ends import (
    DISK,
    ENDS,
    FILE_SIZE,
    FILES,
    HANG_UP,
    KILL,
    LIMITED,
    LIMITS,
    MODES,
    PAGE,
    READ_ONLY,
    READER,
    RECORD,
    RIGS,
    RUN,
    SEEDS,
    SERVE,
    SIGNALS_HEADS,
    TERMINATE,
    TWICE,
    WAIT_S,
    End,
    Limit,
    Mode,
    begin,
    end_by_limit,
    end_by_signal,
    kill_after,
    make_bench,
    processes_in,
    shown,
    wait_until,
)

from hiltest.processes import lacks_resources
from hiltest.run_record.reader import read_record

pytestmark = pytest.mark.slow

KILLS = int(os.environ.get("HILTEST_KILLS", "10"))

# One of each kind; CI tries the others in parts.
FEW = {
    (RUN.name, TWICE.name),
    (RUN.name, READER.name),
    (RECORD.name, HANG_UP.name),
    (SEEDS.name, KILL.name),
    (RIGS.name, TERMINATE.name),
}
FEW_LIMITS = {FILES.steps[-1], FILE_SIZE.steps[-2]}


@pytest.mark.parametrize(
    ("mode", "end"),
    [
        pytest.param(
            mode, end, id=f"{mode.name} {end.name}", marks=[] if (mode.name, end.name) in FEW else pytest.mark.ci
        )
        for mode in MODES
        for end in ENDS
    ],
)
def test_a_command_that_is_ended_leaves_as_much_as_the_page_says(mode: Mode, end: End, tmp_path: Path) -> None:
    left = end_by_signal(tmp_path, mode, end)
    assert left.complete
    assert "Traceback" not in left.output
    row = next(line for line in shown(PAGE.read_text(encoding="utf-8"), SIGNALS_HEADS).splitlines() if end.name in line)
    cell = left.cell
    if end is TWICE:  # the second comes while the first is dealt with, or after that
        cell = cell.replace("cut short", "interrupted")
        cell = cell.replace("2; then", "0; then") if mode is SERVE else cell
    assert cell == row.split("|")[2 + MODES.index(mode)].strip()


@pytest.mark.parametrize(
    ("mode", "limit", "step"),
    [
        pytest.param(
            mode,
            limit,
            step,
            id=f"{mode.name} {limit.name} {number}",
            marks=[] if mode is RUN and step in FEW_LIMITS else pytest.mark.ci,
        )
        for mode in LIMITED
        for limit in LIMITS
        for number, step in enumerate(limit.steps)
    ],
)
def test_a_limit_fails_no_test_and_leaves_no_wrong_number(mode: Mode, limit: Limit, step: str, tmp_path: Path) -> None:
    if limit.mounts and subprocess.run(["unshare", "--mount", "true"], capture_output=True, check=False).returncode:
        pytest.skip("mounting needs root")
    left = end_by_limit(tmp_path, mode, limit, step)
    # 4: the file of --record cannot be written, or the folder of the record.
    assert left.code in ({0, 24, 4} if limit in (DISK, FILE_SIZE, READ_ONLY) else {0, 24}), left.output
    assert (left.code == 0) <= (left.records == {"pass, 2 of 2"})
    assert "Traceback" not in left.output
    assert "INTERNALERROR" not in left.output
    assert (left.again, left.complete) == (0, True)


@pytest.mark.ci
@pytest.mark.parametrize("mode", MODES, ids=[mode.name for mode in MODES])
@pytest.mark.parametrize("number", range(max(1, KILLS if KILLS >= 50 else KILLS // 10)))
def test_a_command_that_is_killed_at_any_moment_leaves_no_wrong_number(number: int, mode: Mode, tmp_path: Path) -> None:
    # From the start of Python to the end of the reports, which come after 3 to 6 s on a machine of its own.
    left = kill_after(tmp_path, mode, random.Random(f"{mode.name} {number}").uniform(0.3, 8.0))
    assert left.code in (-signal.SIGKILL, 0)
    outcomes = ("cut short", "interrupted", "pass")
    assert left.records <= {"no record", *(f"{outcome}, {count} of 2" for outcome in outcomes for count in range(3))}
    assert not left.records & {"pass, 0 of 2", "pass, 1 of 2"}
    assert (left.again, left.complete) == (0, True)


def exit_code(running: subprocess.Popen[str]) -> int:
    """Wait for the end of a command; return its exit code."""
    running.communicate(timeout=WAIT_S)
    return running.returncode


class TestOutput:
    def test_a_full_device_changes_neither_the_verdict_nor_the_exit_code(self, tmp_path: Path) -> None:
        make_bench(tmp_path, RUN)
        (tmp_path / "go").touch()
        with open("/dev/full", "w") as full:
            run = begin(tmp_path, RUN, stdout=full.fileno(), stderr=full.fileno())
            assert run.wait(WAIT_S) == 0
        assert len(read_record(tmp_path / "out").run.tests) == 2

    def test_a_terminal_that_is_stopped_ends_the_printing_only(self, tmp_path: Path) -> None:
        make_bench(tmp_path, RUN)
        (tmp_path / "go").touch()
        (tmp_path / "hil" / "suites" / "test_long.py").write_text(
            "def test_long(capfd):\n    with capfd.disabled():\n        print('x' * 200_000)\n"
        )
        terminal, side = pty.openpty()  # nobody reads: it is full after some kilobytes
        run = begin(tmp_path, RUN, stdout=side, stderr=side)
        os.close(side)
        assert run.wait(WAIT_S) == 0
        os.close(terminal)
        assert len(read_record(tmp_path / "out").run.tests) == 3

    def test_the_last_line_of_pytest_reaches_a_pipe(self, tmp_path: Path) -> None:
        make_bench(tmp_path, RUN)
        (tmp_path / "go").touch()
        command = [sys.executable, "-m", "pytest", "-q", "--hil-rig=rig.toml", "--hil-out=out", "hil/suites"]
        done = subprocess.run(command, cwd=tmp_path, capture_output=True, text=True, check=False, timeout=WAIT_S)
        assert done.stdout.splitlines()[-1].startswith("2 passed in")


def test_sigterm_acts_as_ctrl_c_on_pytest_with_the_plugin(tmp_path: Path) -> None:
    make_bench(tmp_path, RUN)
    command = [sys.executable, "-m", "pytest", "-q", "--hil-rig=rig.toml", "--hil-out=out", "hil/suites"]
    run = subprocess.Popen(command, cwd=tmp_path, stdout=subprocess.DEVNULL)
    wait_until((tmp_path / "started").exists)
    run.send_signal(signal.SIGTERM)
    assert run.wait(WAIT_S) == 2
    assert read_record(tmp_path / "out").run.verdict.outcome == "interrupted"


def test_workers_of_a_study_end_with_it(tmp_path: Path) -> None:
    words = ("study", "ellipsoids", "--instances", "100000", "--jobs", "2", "--out", "out")
    study = begin(tmp_path, Mode("study", words))
    wait_until(lambda: len(processes_in(tmp_path)) >= 3 or study.poll() is not None)
    assert study.poll() is None
    study.kill()
    study.communicate(timeout=WAIT_S)
    wait_until(lambda: not processes_in(tmp_path))


class TestCodes:
    def test_a_killed_worker_has_a_code_of_its_own(self, tmp_path: Path) -> None:
        make_bench(tmp_path, SEEDS)
        suite = "import os\n\ndef test_one():\n    os.kill(os.getpid(), 9)\n"
        (tmp_path / "hil" / "suites" / "test_two.py").write_text(suite)
        assert exit_code(begin(tmp_path, SEEDS)) == 24

    @pytest.mark.parametrize("error", ["MemoryError()", "OSError(28, 'No space left on device')"])
    def test_a_test_that_memory_or_disk_ends_has_not_failed(self, error: str, tmp_path: Path) -> None:
        make_bench(tmp_path, RUN)
        (tmp_path / "hil" / "suites" / "test_two.py").write_text(
            f"def test_first(measure):\n    measure('first', 1, '')\n\ndef test_second(measure):\n    raise {error}\n"
        )
        assert exit_code(begin(tmp_path, RUN)) == 24
        record = read_record(tmp_path / "out").run
        assert (record.verdict.exit_code, record.verdict.outcome) == (24, "cut short")
        assert [test.id.rpartition("::")[2] for test in record.tests] == ["test_first"]

    def test_an_error_that_no_command_expects_is_an_internal_error(self, tmp_path: Path) -> None:
        breaks = "import hiltest.session.settings as s; s.file_name = None; import hiltest.commands.ports as p; "
        breaks += "p.ports.callback = lambda **_: 1 / 0; from hiltest.commands.cli import main; main(['ports'])"
        done = subprocess.run([sys.executable, "-c", breaks], cwd=tmp_path, capture_output=True, text=True)
        assert done.returncode == 3
        assert done.stderr.splitlines()[-1] == "ERROR: internal error: ZeroDivisionError: division by zero"

    def test_a_lack_is_seen_behind_an_error_that_names_it(self) -> None:
        outer = ValueError("cannot write")
        outer.__cause__ = OSError(errno.EMFILE, "Too many open files")
        assert lacks_resources(outer)
        assert not lacks_resources(OSError(errno.ENOENT, "No such file"))
