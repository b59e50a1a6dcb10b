"""Every option and argument that takes a file to read refuses at once what has no end, what is huge, and a folder."""

from __future__ import annotations

import os
import resource
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path

import click
import pytest
from tests.command_files import folder_of_inputs, run
from tests.finished_run import Finished
from tests.test_jobs import FIRMWARE
from tests.test_written_files import WRITING

from hiltest.commands.cli import every_command
from hiltest.rig.bench_files import shipped

pytestmark = pytest.mark.slow

# What makes each of them read; {} is the file.
READING = {
    "fit noise log": ("fit", "noise", "{}"),
    "baseline save run": ("baseline", "save", "{}", "new.json"),
    "baseline review new": ("baseline", "review", "base.json", "{}"),
    "baseline review old": ("baseline", "review", "{}", "base.json"),
    "baseline update run": ("baseline", "update", "--accept", "*", "--because", "a test", "base.json", "{}"),
    "bisect --rig": ("bisect", "v1", "v2", "--firmware", "app.elf", "--rig", "{}", "--", "make"),
    "calibrate --firmware": ("calibrate", "--firmware", "{}"),
    "calibrate --rig": ("calibrate", "--rig", "{}"),
    "compare base": ("compare", "{}", "run.json"),
    "compare new": ("compare", "run.json", "{}"),
    "decode source": ("decode", "{}"),
    "judge --against": ("judge", "mine.py:calibrate", "--alone", "--against", "{}"),
    "judge --part": ("judge", "mine.elf", "--part", "{}"),
    "judge --recording": ("judge", "mine.py:Filter", "--recording", "{}"),
    "judge --signature": ("judge", "mine.c", "--alone", "--signature", "{}"),
    "listen --firmware": ("listen", "--rig", "text-compass", "--firmware", "{}"),
    "listen --rig": ("listen", "--rig", "{}"),
    "doctor --rig": ("doctor", "--rig", "{}"),
    "explain run": ("explain", "{}"),
    "explain --baseline": ("explain", "run.json", "--baseline", "{}"),
    "explain --firmware": ("explain", "run.json", "--baseline", "base.json", "--firmware", "{}"),
    "explain --against": ("explain", "run.json", "--baseline", "base.json", "--against", "{}"),
    "report export run": ("report", "export", "{}", "--format", "bencher"),
    "fit --firmware": ("fit", "points.csv", "--firmware", "{}"),
    "fit --accelerometer-log": ("fit", "points.csv", "--accelerometer-log", "{}"),
    "fit log": ("fit", "{}"),
    "fit imu --bias-from": ("fit", "imu", "imu.csv", "--bias-from", "{}"),
    "fit imu --gyroscope-log": ("fit", "imu", "imu.csv", "--gyroscope-log", "{}"),
    "fit imu --intervals": ("fit", "imu", "imu.csv", "--intervals", "{}"),
    "fit imu log": ("fit", "imu", "{}"),
    "flash --rig": ("flash", "--rig", "{}"),
    "flash elf": ("flash", "{}"),
    "start elf": ("start", "{}"),
    "init --firmware": ("init", "bench", "--firmware", "{}"),
    "log --firmware": ("log", "--seconds", "1", "--out", "log.csv", "--firmware", "{}"),
    "log --rig": ("log", "--seconds", "1", "--out", "log.csv", "--rig", "{}"),
    "play --firmware": ("play", "--rig", "field.toml", "--firmware", "{}"),
    "play --recording": ("play", "--rig", "field.toml", "--recording", "{}"),
    "play --rig": ("play", "--rig", "{}"),
    "profile --part": ("profile", "shipped", "crc32", "text:123456789", "9", "--part", "{}"),
    "profile --profile": ("profile", "shipped", "crc32", "text:123456789", "9", "--profile", "{}"),
    "profile elf": ("profile", "{}", "crc32"),
    "report record": ("report", "{}"),
    "run --against": ("run", "--against", "{}"),
    "run --baseline": ("run", "--baseline", "{}"),
    "run --calibration": ("run", "--calibration", "{}"),
    "run --firmware": ("run", "--firmware", "{}"),
    "run --replay": ("run", "--replay", "{}"),
    "run --rig": ("run", "--rig", "{}"),
    "serve --firmware": ("serve", "--firmware", "{}"),
    "serve --flash-file": ("serve", "--flash-file", "{}"),
    "serve --replay": ("serve", "--replay", "{}"),
    "serve --rig": ("serve", "--rig", "{}"),
    "study --firmware": ("study", "budget", "--firmware", "{}"),
    "study --rig": ("study", "choose", "--rig", "{}"),
    "timing check file": ("timing", "check", "{}"),
    "timing measure --rig": ("timing", "measure", "--rig", "{}"),
    "timing show --part": ("timing", "show", "--part", "{}"),
    "timing show --profile": ("timing", "show", "--profile", "{}"),
    "profile worst --firmware": ("profile", "worst", "crc32", "uint8:9:0..255", "9", "--firmware", "{}"),
    "profile worst --replay": ("profile", "worst", "--replay", "{}"),
}
# As help calls what is a file and no click.Path.
FILES = {"ELF", "FILE", "NAME|FILE", "FILE|COLUMN", "FILE|PORT"}
# Files that end in this are taken for files, others for names of what ships.
ENDS = {
    "fit imu --intervals": ".json",
    "judge --against": ".c",
    "judge --recording": ".npz",
    "play --recording": ".npz",
    **dict.fromkeys(("judge --part", "judge --signature"), ".toml"),
    **dict.fromkeys(("profile --part", "profile --profile", "timing show --part", "timing show --profile"), ".toml"),
}
REASONS = ("regular file", "larger than", "binary file", "not a readable NumPy archive")
# Processor time; a readable file takes a thousandth of a second beside the start of Python. A pipe is waited for.
AT_ONCE_S = 10.0


def options_that_read() -> Iterator[str]:
    """Yield the options and arguments of all commands that are files."""
    for name, command in every_command():
        for parameter in command.params:
            if (
                isinstance(parameter.type, click.Path) or parameter.metavar in FILES or parameter.name == "elf"
            ) and parameter.metavar != "DIR":
                yield f"{name} {max(parameter.opts, key=len)}"


def test_all_of_them_are_tested_here() -> None:
    written = {
        *WRITING,
        "baseline save file",
        "baseline update file",
        "judge --init",
        "run --coverage",
        "run --record",
    }
    assert set(options_that_read()) - written == set(READING)


@pytest.fixture(scope="module")
def inputs(tmp_path_factory: pytest.TempPathFactory, default_run: Finished) -> Path:
    """A folder with what the commands read besides."""
    folder = folder_of_inputs(tmp_path_factory, default_run, "1,2,3")
    assert run("baseline", "save", str(folder / "run.json"), str(folder / "base.json")) == 0
    rig = (shipped() / "rigs" / "virtual-k64f.toml").read_text(encoding="utf-8")
    (folder / "field.toml").write_text(f'{rig}\n[world.playback]\nfile = "field.csv"\n', encoding="utf-8")
    (folder / "mine.py").write_text(
        "def calibrate(samples):\n    return None\n\n\nclass Filter:\n    def __init__(self, rate_hz):\n        pass\n",
        encoding="utf-8",
    )
    (folder / "mine.c").write_text("int calibrate(void) { return 0; }\n", encoding="utf-8")
    (folder / "mine.elf").write_bytes(FIRMWARE.read_bytes())
    (folder / "field.csv").write_text("t_s,mx_uT,my_uT,mz_uT\n0,20,0,40\n1,20,0,40\n", encoding="utf-8")
    return folder


def make(kind: str, path: Path) -> None:
    if kind == "without end":
        path.symlink_to("/dev/zero")
    elif kind == "sparse":
        with path.open("wb") as file:
            file.truncate(64 << 30)
    elif kind == "folder":
        path.mkdir()
    else:
        os.mkfifo(path)


# Each option is tried with one of them: what they read with is the same for all.
KINDS = ("without end", "sparse", "folder")
TRIED = [(option, KINDS[index % len(KINDS)]) for index, option in enumerate(sorted(READING))]


@pytest.mark.parametrize(("option", "kind"), TRIED)
def test_what_no_such_file_can_be_is_refused_at_once(option: str, kind: str, inputs: Path, tmp_path: Path) -> None:
    path = tmp_path / f"hostile{ENDS.get(option, '')}"
    make(kind, path)
    words = [item.replace("{}", str(path)) for item in READING[option]]
    before = resource.getrusage(resource.RUSAGE_CHILDREN)
    done = subprocess.run(
        [sys.executable, "-m", "hiltest", *words], cwd=inputs, capture_output=True, text=True, timeout=60.0, check=False
    )
    after = resource.getrusage(resource.RUSAGE_CHILDREN)
    assert after.ru_utime + after.ru_stime - before.ru_utime - before.ru_stime < AT_ONCE_S
    # A base that cannot be read is a comparison that was not evaluated.
    assert done.returncode == (22 if option in {"run --baseline", "compare base"} else 4), done.stderr
    assert "hostile" in done.stdout + done.stderr
    assert "Traceback" not in done.stdout + done.stderr
    if kind != "folder":
        assert any(reason in done.stdout + done.stderr for reason in REASONS)


@pytest.mark.parametrize("option", ["run --rig", "profile elf", "report export run", "timing show --profile"])
def test_a_pipe_is_refused_where_a_file_is_read_more_than_once(option: str, inputs: Path, tmp_path: Path) -> None:
    path = tmp_path / f"hostile{ENDS.get(option, '')}"
    make("pipe", path)
    words = [item.replace("{}", str(path)) for item in READING[option]]
    done = subprocess.run(
        [sys.executable, "-m", "hiltest", *words],
        cwd=inputs,
        capture_output=True,
        text=True,
        timeout=AT_ONCE_S,
        check=False,
    )
    assert done.returncode == 4
    assert "not a regular file" in done.stderr
