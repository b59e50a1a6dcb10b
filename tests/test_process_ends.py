"""Ends of a command that are not its own: an output that fails, signals, a parent that dies, resources that run out.

Each test starts the real command on a small suite of its own, and reads its exit code and its record.
"""

from __future__ import annotations

import errno
import os
import pty
import signal
import subprocess
import sys
import time
from collections.abc import Callable
from pathlib import Path

import pytest

from hiltest.processes import lacks_resources
from hiltest.run_record.reader import read_record
from hiltest.session.record_folder import sole_command

pytestmark = pytest.mark.slow

WAIT_S = 60.0
"""Limit of waits for an event; only a hung command reaches it."""

SUITE = """
import pathlib, time

def test_first(measure):
    measure("first", 1, "")

def test_second(measure):
    pathlib.Path("started").open("a").write("x")
    while not pathlib.Path("go").exists():
        time.sleep(0.01)
    measure("second", 2, "")
"""


@pytest.fixture
def bench(tmp_path: Path) -> Path:
    """Return a folder with a suite of two tests: the second waits for the file ``go``."""
    suites = tmp_path / "hil" / "suites"
    suites.mkdir(parents=True)
    (suites / "test_two.py").write_text(SUITE)
    return tmp_path


def start(bench: Path, *words: str, **streams: object) -> subprocess.Popen[str]:
    environment = {name: value for name, value in os.environ.items() if not name.startswith("HIL_")}
    streams = {"stdout": subprocess.DEVNULL, "stderr": subprocess.DEVNULL, **streams}
    command = [sys.executable, "-m", "hiltest", *words]
    return subprocess.Popen(command, cwd=bench, env=environment, text=True, **streams)  # type: ignore[call-overload]


def wait_until(happens: Callable[[], object]) -> None:
    ends_s = time.monotonic() + WAIT_S
    while not happens():
        assert time.monotonic() < ends_s
        time.sleep(0.01)


def started(bench: Path, runs: int = 1) -> Callable[[], bool]:
    """Return whether so many runs are in their second test."""
    return lambda: (bench / "started").exists() and (bench / "started").stat().st_size >= runs


def processes_in(bench: Path) -> list[int]:
    """Return the processes whose working folder is the bench."""
    found = []
    for process in Path("/proc").glob("[0-9]*"):
        try:
            if (process / "cwd").readlink() == bench and "Z" not in (process / "stat").read_text().split()[2]:
                found.append(int(process.name))
        except OSError:
            continue
    return found


def second_rig(bench: Path) -> Path:
    """Write a second rig for the same virtual board."""
    text = (Path(__file__).parents[1] / "hil" / "rigs" / "virtual-k64f.toml").read_text(encoding="utf-8")
    for name in ("left", "right"):
        (bench / f"{name}.toml").write_text(text.replace('name = "virtual-k64f"', f'name = "{name}"'))
    return bench


class TestOutput:
    @pytest.mark.parametrize("output", ["full device", "closed pipe"])
    def test_an_output_that_fails_changes_neither_the_verdict_nor_the_exit_code(self, output: str, bench: Path) -> None:
        (bench / "go").touch()
        if output == "full device":
            with open("/dev/full", "w") as full:
                run = start(bench, "run", "--out", "out", "--", "-v", stdout=full, stderr=full)
                code = run.wait(WAIT_S)
        else:
            reading, writing = os.pipe()
            os.close(reading)
            run = start(bench, "run", "--out", "out", "--", "-v", stdout=writing, stderr=writing)
            os.close(writing)
            code = run.wait(WAIT_S)
        record = read_record(bench / "out").run
        assert (code, record.verdict.exit_code, len(record.tests)) == (22, 22, 2)  # the rig's limits are not measured

    def test_a_terminal_that_is_stopped_ends_the_printing_only(self, bench: Path) -> None:
        (bench / "go").touch()
        terminal, side = pty.openpty()  # nobody reads: it is full after some kilobytes
        (bench / "hil" / "suites" / "test_long.py").write_text(
            "def test_long(hil_settings, capfd):\n    with capfd.disabled():\n        print('x' * 200_000)\n"
        )
        run = start(bench, "run", "--out", "out", "--", "-v", stdout=side, stderr=side)
        os.close(side)
        assert run.wait(WAIT_S) == 22
        os.close(terminal)
        assert len(read_record(bench / "out").run.tests) == 3


class TestSignals:
    @pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM, signal.SIGHUP])
    def test_each_acts_as_ctrl_c_on_a_run(self, number: signal.Signals, bench: Path) -> None:
        run = start(bench, "run", "--out", "out")
        wait_until(started(bench))
        run.send_signal(number)
        assert run.wait(WAIT_S) == 2
        record = read_record(bench / "out").run
        assert [test.id.rpartition("::")[2] for test in record.tests] == ["test_first"]
        assert record.verdict.outcome == "interrupted"
        assert [measurement.name for measurement in record.measurements if measurement.test] == ["first"]
        assert not (bench / "out" / "journal.jsonl").exists()

    def test_sigterm_acts_so_on_pytest_with_the_plugin(self, bench: Path) -> None:
        command = [sys.executable, "-m", "pytest", "-q", "--hil-out=out", "hil/suites"]
        run = subprocess.Popen(command, cwd=bench, stdout=subprocess.DEVNULL)
        wait_until(started(bench))
        run.send_signal(signal.SIGTERM)
        assert run.wait(WAIT_S) == 2
        assert read_record(bench / "out").run.verdict.outcome == "interrupted"

    @pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM, signal.SIGHUP, signal.SIGKILL])
    @pytest.mark.parametrize("mode", ["seeds", "rigs"])
    def test_the_runs_of_a_command_end_with_it(self, mode: str, number: signal.Signals, bench: Path) -> None:
        second_rig(bench)
        words = {
            "seeds": ["--seeds", "1..4", "--jobs", "2"],
            "rigs": ["--rig", "left.toml", "--rig", "right.toml"],
        }[mode]
        folders = {"seeds": ["seed-0001", "seed-0002"], "rigs": ["left", "right"]}[mode]
        command = start(bench, "run", "--out", "out", *words)
        wait_until(started(bench, runs=2))
        command.send_signal(number)
        code = command.wait(WAIT_S)
        assert code == (-signal.SIGKILL if number is signal.SIGKILL else 2)
        wait_until(lambda: not processes_in(bench))
        for folder in folders:
            record = read_record(bench / "out" / folder).run
            assert record.verdict.outcome == "interrupted"
            assert [measurement.name for measurement in record.measurements if measurement.test] == ["first"]
        with sole_command(bench / "out"):  # the lock is free
            pass

    def test_workers_of_a_study_end_with_it(self, bench: Path) -> None:
        study = start(bench, "study", "ellipsoids", "--instances", "100000", "--jobs", "2", "--out", "out")
        wait_until(lambda: len(processes_in(bench)) >= 3 or study.poll() is not None)
        assert study.poll() is None
        study.kill()
        study.wait(WAIT_S)
        wait_until(lambda: not processes_in(bench))


class TestCodes:
    def test_a_killed_worker_has_a_code_of_its_own(self, bench: Path) -> None:
        (bench / "hil" / "suites" / "test_two.py").write_text(
            "import os\n\ndef test_one(measure):\n    measure('first', 1, '')\n\n"
            "def test_two():\n    os.kill(os.getpid(), 9)\n"
        )
        assert start(bench, "run", "--out", "out", "--seeds", "1..1").wait(WAIT_S) == 24

    @pytest.mark.parametrize(
        ("limit", "code"),
        [("-n 8", 24), ("-f 2", 24), ("-n 64", 22)],
    )
    def test_a_lack_of_files_or_disk_is_no_failed_test(self, limit: str, code: int, bench: Path) -> None:
        (bench / "go").touch()
        command = f"ulimit {limit}; exec {sys.executable} -m hiltest run --out out"
        done = subprocess.run(["bash", "-c", command], cwd=bench, capture_output=True, text=True, timeout=WAIT_S)
        assert done.returncode == code, done.stdout + done.stderr
        assert "Traceback" not in done.stdout + done.stderr
        assert "INTERNALERROR" not in done.stdout
        # The next run in this folder is not disturbed.
        assert start(bench, "run", "--out", "out").wait(WAIT_S) == 22

    @pytest.mark.parametrize("error", ["MemoryError()", "OSError(28, 'No space left on device')"])
    def test_a_test_that_memory_or_disk_ends_has_not_failed(self, error: str, bench: Path) -> None:
        (bench / "hil" / "suites" / "test_two.py").write_text(
            f"def test_first(measure):\n    measure('first', 1, '')\n\ndef test_second(measure):\n    raise {error}\n"
        )
        assert start(bench, "run", "--out", "out").wait(WAIT_S) == 24
        record = read_record(bench / "out").run
        assert (record.verdict.exit_code, record.verdict.outcome) == (24, "cut short")
        assert [test.id.rpartition("::")[2] for test in record.tests] == ["test_first"]

    def test_an_error_that_no_command_expects_is_an_internal_error(self, bench: Path) -> None:
        breaks = "import hiltest.session.settings as s; s.file_name = None; import hiltest.commands.ports as p; "
        breaks += "p.ports.callback = lambda **_: 1 / 0; from hiltest.commands.cli import main; main(['ports'])"
        done = subprocess.run([sys.executable, "-c", breaks], cwd=bench, capture_output=True, text=True)
        assert done.returncode == 3
        assert done.stderr.splitlines()[-1] == "ERROR: internal error: ZeroDivisionError: division by zero"

    def test_a_lack_is_seen_behind_an_error_that_names_it(self) -> None:
        outer = ValueError("cannot write")
        outer.__cause__ = OSError(errno.EMFILE, "Too many open files")
        assert lacks_resources(outer)
        assert not lacks_resources(OSError(errno.ENOENT, "No such file"))
