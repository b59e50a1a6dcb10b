"""Every option that takes a file to write follows a link, writes to a pipe and leaves a device what it is."""

from __future__ import annotations

import os
import stat
import threading
from collections.abc import Iterator
from pathlib import Path

import click
import pytest
from tests.command_files import folder_of_all_inputs, run
from tests.finished_run import Finished

from hiltest.commands.cli import every_command

pytestmark = pytest.mark.slow

BASE = ("baseline", "save", "run.json")
IMU = ("fit", "imu", "imu.csv")
# What makes each option write; the file follows the last word.
WRITING = {
    "fit noise --html": ("fit", "noise", "rates.csv", "--html"),
    "baseline save FILE": BASE,
    "baseline update FILE": ("baseline", "update", "--accept", "*", "--because", "a test"),
    "calibrate --out": ("calibrate", "--out"),
    "decode --csv": ("decode", "packets.bin", "--csv"),
    "report export --out": ("report", "export", "run.json", "--format", "bencher", "--out"),
    "fit --export-ardupilot": ("fit", "points.csv", "--on", "host", "--unit", "uT", "--export-ardupilot"),
    "fit --export-header": ("fit", "points.csv", "--on", "host", "--export-header"),
    "fit --export-json": ("fit", "points.csv", "--on", "host", "--export-json"),
    "fit --html": ("fit", "points.csv", "--on", "host", "--html"),
    "fit imu --export-header": (*IMU, "--export-header"),
    "fit imu --export-json": (*IMU, "--export-json"),
    "log --out": ("log", "--seconds", "1", "--out"),
    "profile --flame-graph": ("profile", "shipped", "crc32", "text:123456789", "9", "--flame-graph"),
    "profile --folded": ("profile", "shipped", "crc32", "text:123456789", "9", "--folded"),
    "timing measure --out": ("timing", "measure", "--out"),
    "report trend --html": ("report", "trend", ".", "--html"),
    "profile worst --out": ("profile", "worst", "crc32", "uint8:9:0..255", "9", "--calls", "1", "--out"),
}


def options_that_write() -> Iterator[str]:
    """Yield the options and arguments of all commands whose help says that they are a file to write."""
    for name, command in every_command():
        for param in command.params:
            if isinstance(param, click.Option) and param.metavar == "FILE" and isinstance(param.type, click.Path):
                yield f"{name} {max(param.opts, key=len)}"
        if name.startswith("baseline"):
            yield f"{name} FILE"


def test_all_of_them_are_tested_here() -> None:
    assert set(WRITING) <= set(options_that_write())  # tests/test_read_files.py knows all other files


@pytest.fixture(scope="module")
def inputs(tmp_path_factory: pytest.TempPathFactory, default_run: Finished) -> Path:
    """A folder with what the commands read."""
    return folder_of_all_inputs(tmp_path_factory, default_run)


def words(option: str, file: str) -> tuple[str, ...]:
    return (*WRITING[option], file, *(["dearer.json"] if option == "baseline update FILE" else []))


@pytest.mark.parametrize("option", sorted(WRITING))
def test_a_link_is_followed_a_pipe_is_written_to_and_a_device_stays(
    option: str, inputs: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(inputs)
    link, target, pipe, device = (tmp_path / name for name in ("link", "target", "pipe", "device"))
    link.symlink_to("target")
    if option == "baseline update FILE":
        assert run("baseline", "save", "run.json", str(target)) == 0
    assert run(*words(option, str(link))) == 0
    assert link.is_symlink()
    assert target.stat().st_size > 0
    if option == "baseline update FILE":
        return  # it reads the file first, and a pipe or a device is none
    os.mkfifo(pipe)
    got: list[bytes] = []
    reader = threading.Thread(target=lambda: got.append(pipe.read_bytes()), daemon=True)
    reader.start()
    assert run(*words(option, str(pipe))) == 0
    reader.join(timeout=10.0)
    assert got != [b""]
    assert stat.S_ISFIFO(pipe.stat().st_mode)
    device.symlink_to("/dev/null")
    assert run(*words(option, str(device))) == 0
    assert device.is_symlink()
    assert stat.S_ISCHR(Path("/dev/null").stat().st_mode)
