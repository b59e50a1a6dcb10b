"""Every command of hiltest with its name, how it is called in this process, and the files that commands read."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

import click
import pytest
from tests.finished_run import Finished
from tests.logs.recording import six_faces_and_turns, write

from hiltest.cli import commands, main


def every_command(command: click.Command = commands, name: str = "") -> Iterator[tuple[str, click.Command]]:
    """Yield the name and the command of each that is no group."""
    if not isinstance(command, click.Group):
        yield name, command
        return
    context = click.Context(command)
    for word in command.list_commands(context):
        if (each := command.get_command(context, word)) is not None:
            yield from every_command(each, f"{name} {word}".strip())


def run(*arguments: str) -> int:
    """Run a command in this process; return its exit code."""
    with pytest.raises(SystemExit) as ended:
        main(arguments)
    return int(ended.value.code or 0)


def folder_of_inputs(parent: pytest.TempPathFactory, default_run: Finished, points: str) -> Path:
    """Return a folder with the record of a run, an IMU log and magnetometer points."""
    folder = parent.mktemp("inputs")
    (folder / "run.json").write_bytes((default_run.folder / "run.json").read_bytes())
    write(folder / "imu.csv", *six_faces_and_turns().readings())
    (folder / "points.csv").write_text(f"mx_uT,my_uT,mz_uT\n{points}\n", encoding="utf-8")
    return folder
