"""A folder for a command that makes several runs in it: no other such command may use it meanwhile."""

from __future__ import annotations

import platform
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path

from hiltest.errors import ConfigError
from hiltest.report.journal import Journal
from hiltest.report.record import utc_now
from hiltest.runs.wire_traces import remove_traces
from hiltest.settings import make_folder

LOCK_FILE = "command.lock"


@contextmanager
def sole_command(folder: Path) -> Iterator[None]:
    """Keep a folder from other commands of several runs; the runs themselves each keep their own.

    Raises
    ------
    ConfigError
        If another command has it; it says which. Or if it cannot be written to.
    """
    make_folder(folder)
    lock = Journal(folder, LOCK_FILE)
    lock.announce({"environment": {"host": platform.node()}, "started_utc": utc_now()})
    try:
        yield
    finally:
        lock.finish()
        lock.release()


def remove_run(folder: Path) -> None:
    """Remove what an earlier run left in a folder, and the folder if that was all; one that a run has stays."""
    if not folder.is_dir():
        return
    with suppress(ConfigError):
        remove_record_in(folder)
    with suppress(OSError):
        folder.rmdir()


def remove_record_in(folder: Path) -> None:
    """Remove what an earlier run or campaign left in a folder; the folders of its seeds stay.

    Raises
    ------
    ConfigError
        If a run has the folder; it says which.
    """
    claim = Journal(folder)
    claim.begin()
    remove_traces(folder)
    claim.finish()
    claim.release()
