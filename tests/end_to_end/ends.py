"""Ends of a command that are not its own, in every mode; and the tables of them.

    python -m tests.end_to_end.ends

writes them into docs/reliability.md. The commands are real; their suite has two tests, of which the second waits for a
file.
"""

from __future__ import annotations

import os
import shutil
import signal
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from pathlib import Path

from hiltest.boards import default_firmware
from hiltest.errors import HiltestError
from hiltest.rig.bench_files import shipped
from hiltest.run_record.reader import read_record
from hiltest.session.record_folder import sole_command

PAGE = Path(__file__).parents[2] / "docs" / "reliability.md"
WAIT_S = 300.0
"""Limit of waits for an event; only a command that hangs reaches it."""
SUITE = """
import pathlib, time

def test_first(board, measure):
    measure("first", 1, "")

def test_second(board, measure, request):
    with pathlib.Path("started").open("a") as started:
        started.write("x")
    while not pathlib.Path("go").exists():
        time.sleep(0.01)
    firmware = request.config.getoption("--hil-firmware")
    measure("heading.second.rms", pathlib.Path(firmware).read_bytes()[-1] if firmware else 2, "deg")
"""


@dataclass(frozen=True)
class Mode:
    """A command, and the folders of its runs.

    Attributes
    ----------
    words : sequence of str
        The words after ``hiltest``.
    together : int
        How many runs wait in their second test at the same time; 0 for a command without runs.
    """

    name: str
    words: Sequence[str]
    together: int = 1
    folders: Sequence[str] = ("out",)
    prepare: Callable[[Path], None] = field(default=lambda folder: None)


def _two_rigs(folder: Path) -> None:
    text = (folder / "rig.toml").read_text(encoding="utf-8")
    for name in ("left", "right"):
        (folder / f"{name}.toml").write_text(text.replace('name = "virtual-k64f"', f'name = "{name}"'))


def _repository(folder: Path) -> None:
    """Make four commits: the third is worse. A build adds the byte of a file to the packaged firmware."""
    shutil.copy(default_firmware(), folder / "base.elf")
    (folder / "hil" / "rigs").mkdir()
    (folder / "rig.toml").rename(folder / "hil" / "rigs" / "virtual-k64f.toml")
    (folder / ".gitignore").write_text("build/\nout/\nstarted\ngo\n")
    git = ["git", "-C", str(folder), "-c", "user.name=A. Tester", "-c", "user.email=a@example.org"]
    subprocess.run([*git, "init", "--quiet", "--initial-branch=main"], check=True)
    for number, value in enumerate((1, 1, 9, 9)):
        (folder / "value").write_bytes(bytes([0, number, value]))
        subprocess.run([*git, "add", "."], check=True)
        subprocess.run([*git, "commit", "--quiet", "-m", f"commit {number}"], check=True)
        subprocess.run([*git, "tag", f"v{number}"], check=True)


_RUN = ("run", "--rig", "rig.toml", "--out", "out")
_BUILD = "mkdir -p build && cat base.elf value > build/app.elf"
RUN = Mode("`run`", _RUN)
RECORD = Mode("`run --record`", (*_RUN, "--record", "out/tape"))
SEEDS = Mode("`run --seeds`", (*_RUN, "--seeds", "1..2", "--jobs", "2"), 2, ("out/seed-0001", "out/seed-0002"))
RIGS = Mode(
    "`run`, two rigs",
    ("run", "--rig", "left.toml", "--rig", "right.toml", "--out", "out"),
    2,
    ("out/left", "out/right"),
    _two_rigs,
)
SERVE = Mode("`serve`", ("serve", "--rig", "rig.toml", "--link", "out-port"), 0, ())
BISECT = Mode(
    "`bisect`",
    ("bisect", "v0", "v3", "--firmware", "build/app.elf", "--out", "out", "--", _BUILD),
    folders=(),
    prepare=_repository,
)
MODES = (RUN, RECORD, SEEDS, RIGS, SERVE, BISECT)


def make_bench(folder: Path, mode: Mode) -> None:
    """Write a rig without limits, and the suite."""
    text = (shipped() / "rigs" / "virtual-k64f.toml").read_text(encoding="utf-8").partition("[limits]")[0]
    (folder / "rig.toml").write_text(text, encoding="utf-8")
    (folder / "hil" / "suites").mkdir(parents=True)
    (folder / "hil" / "suites" / "test_two.py").write_text(SUITE, encoding="utf-8")
    mode.prepare(folder)


def begin(folder: Path, mode: Mode, *wrapper: str, **streams: int) -> subprocess.Popen[str]:
    """Start the command of a mode in its bench, behind the words of another command."""
    environment = {name: value for name, value in os.environ.items() if not name.startswith(("HIL_", "PYTEST_"))}
    command = [*wrapper, sys.executable, "-m", "hiltest", *mode.words]
    pipes = {"stdin": subprocess.DEVNULL, "stdout": subprocess.PIPE, "stderr": subprocess.STDOUT} | streams
    return subprocess.Popen(
        command, cwd=folder, env=environment, text=True, errors="replace", start_new_session=True, **pipes
    )


def wait_until(happens: Callable[[], object]) -> None:
    """Wait for an event."""
    ends_s = time.monotonic() + WAIT_S
    while not happens():
        assert time.monotonic() < ends_s
        time.sleep(0.01)


def _has_started(folder: Path, mode: Mode) -> bool:
    if not mode.together:
        return (folder / "out-port").is_symlink()
    started = folder / "started"
    return started.exists() and started.stat().st_size >= mode.together


def processes_in(folder: Path) -> list[int]:
    """Return the processes that work in a folder, zombies left out."""
    numbers = []
    for process in Path("/proc").glob("[0-9]*"):
        try:
            if (process / "cwd").readlink().is_relative_to(folder) and "\nState:\tZ" not in (
                process / "status"
            ).read_text():
                numbers.append(int(process.name))
        except OSError:
            continue
    return numbers


@dataclass(frozen=True)
class End:
    """An end that a command does not choose: its name, and a function that makes it end."""

    name: str
    signals: Sequence[signal.Signals] = ()
    """Signals for the command; without one, its reader goes away."""


INTERRUPT, TWICE, TERMINATE, HANG_UP, READER, KILL = ENDS = (
    End("Ctrl-C", [signal.SIGINT]),
    End("Ctrl-C twice", [signal.SIGINT] * 2),
    End("SIGTERM", [signal.SIGTERM]),
    End("SIGHUP: the terminal is closed", [signal.SIGHUP]),
    End("SIGPIPE: the reader of its output ends"),
    End("SIGKILL", [signal.SIGKILL]),
)


@dataclass(frozen=True)
class Left:
    """The outcome of a command that was ended.

    Attributes
    ----------
    records : set of str
        Outcomes of its runs, each with the names that it measured.
    again : int
        Exit code of the same command, repeated.
    complete : bool
        Whether that one left complete records.
    """

    code: int
    output: str
    records: set[str]
    again: int
    complete: bool

    @property
    def cell(self) -> str:
        """The text of a cell of the table."""
        first = "killed" if self.code == -signal.SIGKILL else str(self.code)
        return "; ".join([first, *sorted(self.records), f"then {self.again}"])


def _records(folder: Path, mode: Mode) -> set[str]:
    texts = set()
    for name in mode.folders:
        try:
            run = read_record(folder / name).run
        except HiltestError:
            texts.add("no record")
            continue
        values = [(measurement.name, measurement.value) for measurement in run.measurements if measurement.test]
        assert values == [("first", 1), ("heading.second.rms", 2)][: len(values)]
        texts.add(f"{run.verdict.outcome}, {len(values)} of 2")
    return texts


def _repeat(folder: Path, mode: Mode) -> tuple[int, bool]:
    """Repeat a command; return its exit code, and whether its records are complete."""
    (folder / "go").touch()
    again = begin(folder, mode)
    if not mode.together:
        wait_until(lambda: _has_started(folder, mode) or again.poll() is not None)
        again.send_signal(signal.SIGTERM)
    output, _ = again.communicate(timeout=WAIT_S)
    assert "Traceback" not in output, output
    return again.returncode, _records(folder, mode) <= {"pass, 2 of 2"}


def end_by_signal(folder: Path, mode: Mode, end: End) -> Left:
    """Run a command, end it while its runs are in their second test, read the remaining records, and repeat it."""
    make_bench(folder, mode)
    running = begin(folder, mode)
    assert running.stdout is not None
    wait_until(lambda: _has_started(folder, mode) or running.poll() is not None)
    assert running.poll() is None, running.communicate()[0]
    output = ""
    if end.signals:
        for number in end.signals:
            running.send_signal(number)
            time.sleep(0.05)  # the second Ctrl-C comes while the first is dealt with
        output, _ = running.communicate(timeout=WAIT_S)
    else:
        running.stdout.close()
        (folder / "go").touch()
        if not mode.together:
            time.sleep(0.2)
            running.send_signal(signal.SIGTERM)
        running.wait(WAIT_S)
    wait_until(lambda: not processes_in(folder))
    with sole_command(folder / "out"):  # its lock is free
        records = _records(folder, mode)
    if mode is SERVE:
        assert (folder / "out-port").is_symlink() == (end is KILL)
        (folder / "out-port").unlink(missing_ok=True)
    (folder / "started").unlink(missing_ok=True)
    return Left(running.returncode, output, records, *_repeat(folder, mode))


def kill_after(folder: Path, mode: Mode, seconds: float) -> Left:
    """Run a command whose tests do not wait, kill it after some time, read the remaining records, and repeat it."""
    make_bench(folder, mode)
    (folder / "go").touch()
    running = begin(folder, mode)
    time.sleep(seconds)
    running.kill()
    output, _ = running.communicate(timeout=WAIT_S)
    wait_until(lambda: not processes_in(folder))
    records = _records(folder, mode)
    (folder / "out-port").unlink(missing_ok=True)
    (folder / "started").unlink(missing_ok=True)
    return Left(running.returncode, output, records, *_repeat(folder, mode))


@dataclass(frozen=True)
class Limit:
    """A limit under which a command runs.

    Attributes
    ----------
    steps : sequence of str
        Shell commands before the command, from the loosest to the tightest.
    mounts : bool
        Whether they mount: the command then runs in a namespace of its own, and its folder is copied at its end.
    """

    name: str
    steps: Sequence[str]
    mounts: bool = False


CLOCK = """
#define _GNU_SOURCE
#include <dlfcn.h>
#include <time.h>
#include <unistd.h>

int clock_gettime(clockid_t clock, struct timespec *now)
{
    int (*real)(clockid_t, struct timespec *);
    *(void **)&real = dlsym(RTLD_NEXT, "clock_gettime");
    int status = real(clock, now);
    if (clock == CLOCK_REALTIME && access("started", F_OK) == 0)
        now->tv_sec -= 86400;
    return status;
}
"""
_DISK = "mkdir -p out && mount -t tmpfs -o size={}k tmpfs out"
# The bench may lie in one of these folders, and Python too.
_TEMPORARY = [place for place in ("/tmp", "/var/tmp", "/usr/tmp", "/dev/shm") if not sys.prefix.startswith(place)]
_NO_TEMPORARY = (
    "mount --bind . /mnt && cd /mnt && "
    f"for f in {' '.join(_TEMPORARY)}; do [ ! -d $f ] || mount -t tmpfs -o ro tmpfs $f; done; export TMPDIR=/gone"
)
LIMITS = MEMORY, FILES, FILE_SIZE, DISK, READ_ONLY, NO_TEMPORARY, SET_BACK = (
    Limit("memory: 1 000, 700, 500 MB", [f"ulimit -v {size}000" for size in (1000, 700, 500)]),
    Limit("open files: 64, 24, 16, 12, 8", [f"ulimit -n {count}" for count in (64, 24, 16, 12, 8)]),
    Limit("size of a file: 64, 16, 4, 2, 1 kB", [f"ulimit -f {size}" for size in (64, 16, 4, 2, 1)]),
    Limit("a disk of 512, 128, 64, 32, 16, 4 kB", [_DISK.format(size) for size in (512, 128, 64, 32, 16, 4)], True),
    Limit("a folder that is read-only", [f"{_DISK.format(64)} && mount -o remount,ro out"], True),
    Limit("no folder for temporary files", [_NO_TEMPORARY], True),
    Limit("a clock that is set back by a day", ["export LD_PRELOAD=$PWD/clock.so"]),
)
LIMITED = (RUN, RECORD, SEEDS, RIGS)


def end_by_limit(folder: Path, mode: Mode, limit: Limit, step: str) -> Left:
    """Run a command to its end under a limit, read the remaining records, and repeat it without."""
    make_bench(folder, mode)
    if limit is SET_BACK:
        (folder / "clock.c").write_text(CLOCK, encoding="utf-8")
        subprocess.run(["gcc", "-shared", "-fPIC", "-o", "clock.so", "clock.c", "-ldl"], cwd=folder, check=True)
    (folder / "go").touch()
    (folder / "copy").mkdir()
    is_copied = limit.mounts and limit is not NO_TEMPORARY  # the record lies on a disk that ends with the namespace
    copy = "cp -a out/. copy; " if is_copied else ""
    script = f'{step} || exit 99; "$@"; code=$?; {copy}exit $code'
    running = begin(folder, mode, *(["unshare", "--mount"] if limit.mounts else []), "bash", "-c", script, "bash")
    output, _ = running.communicate(timeout=WAIT_S)
    wait_until(lambda: not processes_in(folder))
    if is_copied:
        (folder / "out").rmdir()
        (folder / "copy").rename(folder / "out")
    return Left(running.returncode, output, _records(folder, mode), *_repeat(folder, mode))


def texts_of_steps(lefts: Sequence[Left]) -> str:
    """Return the exit codes of the steps of a limit, and the code of the repeated command."""
    return (
        f"{', '.join(str(left.code) for left in lefts)}; then {', '.join(sorted({str(left.again) for left in lefts}))}"
    )


SIGNALS_HEADS = f"| end | {' | '.join(mode.name for mode in MODES)} |"
LIMITS_HEADS = f"| limit | {' | '.join(mode.name for mode in LIMITED)} |"


def _table(heads: str, rows: Sequence[Sequence[str]]) -> str:
    return "\n".join([heads, "|---" * (heads.count("|") - 1) + "|", *(f"| {' | '.join(row)} |" for row in rows)])


def shown(page: str, heads: str) -> str:
    """Return the table with these heads that a page shows."""
    begin_at = page.index(heads)
    return page[begin_at : page.index("\n\n", begin_at)]


def main() -> None:
    """Try every end, and write the tables."""
    with tempfile.TemporaryDirectory() as temporary:
        places = (Path(temporary) / str(number) for number in range(10_000))

        def place() -> Path:
            folder = next(places)
            folder.mkdir()
            return folder

        rows = []
        for end in ENDS:
            rows.append([end.name, *(end_by_signal(place(), mode, end).cell for mode in MODES)])
            print(rows[-1], flush=True)
        tables = {SIGNALS_HEADS: _table(SIGNALS_HEADS, rows)}
        rows = []
        for limit in LIMITS:
            cells = []
            for mode in LIMITED:
                lefts = [end_by_limit(place(), mode, limit, step) for step in limit.steps]
                cells.append(texts_of_steps(lefts))
                print(limit.name, mode.name, [(left.cell, left.complete) for left in lefts], flush=True)
            rows.append([limit.name, *cells])
        tables[LIMITS_HEADS] = _table(LIMITS_HEADS, rows)
        page = PAGE.read_text(encoding="utf-8")
        for heads, text in tables.items():
            page = page.replace(shown(page, heads), text)
        PAGE.write_text(page, encoding="utf-8")


if __name__ == "__main__":
    main()
