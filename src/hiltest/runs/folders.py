"""The folder that a session keeps its record in.

Imported at the start of every pytest run on the machine: what writes is imported where something is written.
"""

from __future__ import annotations

import platform
from collections.abc import Collection, Iterator
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import TYPE_CHECKING

from hiltest.settings import make_folder

if TYPE_CHECKING:
    from hiltest.record.recorder import Recorder
    from hiltest.rig import Rig
    from hiltest.settings import Settings


class RecordFolder:
    """A folder that belongs to one session alone from `claim` to `release`."""

    def __init__(self, path: Path) -> None:
        self.path = path
        self._recorder: Recorder | None = None
        self._made = False

    def claim(self, settings: Settings, rig: Rig | None) -> Recorder:
        """Return the recorder; from the first call on `hiltest report` finds this record.

        Raises
        ------
        ConfigError
            If another run has the folder, or it cannot be written to.
        """
        from hiltest.record.journal import Journal
        from hiltest.record.recorder import Recorder
        from hiltest.record.revision import revision_of

        if self._recorder is None:
            self._made = not self.path.exists()
            make_folder(self.path)
            poses = settings.poses or (rig.procedure.poses if rig else "all")
            self._recorder = Recorder(
                Journal(self.path), suite=settings.suite, poses=poses, revision=revision_of(settings.label)
            )
        return self._recorder

    def release(self) -> None:
        """Give the folder back, when every file of the run is written."""
        if self._recorder is not None:
            self._recorder.release()
        if self._made:
            with suppress(OSError):  # a usage error leaves nothing in it, and a run does
                self.path.rmdir()


CHOSEN_FOLDER = "chosen"


def folder_beside_complete(out: Path, tests: Collection[str] | None = None) -> Path:
    """Return the folder for the record of a part of the tests: never that of a complete run's record.

    Parameters
    ----------
    out
        Folder that was asked for.
    tests
        What runs, where it is another set of tests only if the record has none of them; by default it always is.

    Returns
    -------
    Path
        `out` itself, unless it has the record of a complete run.
    """
    from hiltest.errors import ConfigError
    from hiltest.record.reader import read_record

    try:
        stored = read_record(out)
    except ConfigError:
        return out
    run = stored.run
    same_tests = tests is not None and not {test.id for test in run.tests}.isdisjoint(tests)
    is_complete = stored.ended and run.verdict.complete and not run.chosen
    return out / CHOSEN_FOLDER if is_complete and not same_tests else out


def said_of_folder(out: Path, folder: Path) -> str:
    """Return the line of a run of chosen tests about its folder."""
    from hiltest.report.terminal import shown_path

    return f"{shown_path(out)} keeps the record of its complete run; these tests are recorded in {shown_path(folder)}"


LOCK_FILE = "command.lock"


@contextmanager
def sole_command(folder: Path) -> Iterator[None]:
    """Keep a folder from other commands of several runs; the runs themselves each keep their own.

    Raises
    ------
    ConfigError
        If another command has it; it says which. Or if it cannot be written to.
    """
    from hiltest.record.journal import Journal
    from hiltest.record.run import utc_now

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
    from hiltest.errors import ConfigError

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
    from hiltest.record.journal import Journal
    from hiltest.runs.wire_traces import remove_traces

    claim = Journal(folder)
    claim.begin()
    remove_traces(folder)
    claim.finish()
    claim.release()
