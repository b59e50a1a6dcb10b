"""The folder for the record of a session.

Every pytest run on the machine imports this module: heavy modules are imported only for writing.
"""

from __future__ import annotations

import platform
from collections.abc import Collection, Iterator
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import TYPE_CHECKING

from hiltest.run_record.files import SEED_FOLDERS
from hiltest.session.settings import make_folder

if TYPE_CHECKING:
    from hiltest.rig import Rig
    from hiltest.run_record.recorder import Recorder
    from hiltest.session.settings import Settings


class RecordFolder:
    """A folder that belongs to one session exclusively from `claim` to `release`."""

    def __init__(self, path: Path) -> None:
        self.path = path
        self._recorder: Recorder | None = None
        self._is_new = False

    def claim(self, settings: Settings, rig: Rig | None) -> Recorder:
        """Return the recorder; from the first call on, `hiltest report` reads this record.

        Raises
        ------
        ConfigError
            If another run uses the folder, or it cannot be written to.
        """
        from hiltest.run_record.journal import Journal
        from hiltest.run_record.recorder import Recorder
        from hiltest.run_record.revision import revision_of

        if self._recorder is None:
            self._is_new = not self.path.exists()
            make_folder(self.path)
            poses = settings.poses or (rig.procedure.poses if rig else "all")
            self._recorder = Recorder(
                Journal(self.path), suite=settings.suite, poses=poses, revision=revision_of(settings.label)
            )
        return self._recorder

    def release(self) -> None:
        """Release the folder after every file of the run is written."""
        if self._recorder is not None:
            self._recorder.release()
        if self._is_new:
            with suppress(OSError):  # the folder is empty after a usage error, and not after a run
                self.path.rmdir()


CHOSEN_FOLDER = "chosen"


def folder_beside_complete(out: Path, tests: Collection[str] | None = None) -> Path:
    """Return the folder for the record of some of the tests, which must not replace that of a complete run.

    Parameters
    ----------
    out
        Requested folder.
    tests
        Tests that will run; they do not replace a record with other tests. By default they never replace one.

    Returns
    -------
    Path
        `out` itself, unless it holds the record of a complete run.
    """
    from hiltest.errors import ConfigError
    from hiltest.run_record.reader import read_record

    try:
        run = read_record(out).run
    except ConfigError:
        return out
    same_tests = tests is not None and not {test.id for test in run.tests}.isdisjoint(tests)
    is_complete = run.verdict.complete and not run.chosen
    return out / CHOSEN_FOLDER if is_complete and not same_tests else out


def folder_remark(out: Path, folder: Path) -> str:
    """Return a remark on the folder for the record of chosen tests."""
    from hiltest.report.terminal import shown_path

    return (
        f"{shown_path(out)} keeps the record of its complete run; the chosen tests are recorded in {shown_path(folder)}"
    )


LOCK_FILE = "command.lock"


@contextmanager
def sole_command(folder: Path) -> Iterator[None]:
    """Lock a folder against other commands that make several runs; each run locks its own folder.

    Raises
    ------
    ConfigError
        If another command has the lock, which the message names, or the folder cannot be written to.
    """
    from hiltest.run_record.journal import Journal
    from hiltest.run_record.run import utc_now

    make_folder(folder)
    lock = Journal(folder, LOCK_FILE)
    lock.announce({"environment": {"host": platform.node()}, "started_utc": utc_now()})
    try:
        yield
    finally:
        lock.finish()
        lock.release()


def remove_run(folder: Path) -> None:
    """Remove an earlier run from a folder, and the folder if it is then empty, unless a run uses it."""
    from hiltest.errors import ConfigError

    if not folder.is_dir():
        return
    with suppress(ConfigError):
        remove_record_in(folder)
    with suppress(OSError):
        folder.rmdir()


def remove_record_in(folder: Path) -> None:
    """Remove an earlier run or campaign from a folder; the folders of its seeds stay.

    Raises
    ------
    ConfigError
        If a run uses the folder, which the message names.
    """
    from hiltest.run_record.journal import Journal
    from hiltest.session.wire_traces import remove_traces

    claim = Journal(folder)
    claim.begin()
    remove_traces(folder)
    claim.finish()
    claim.release()


def remove_runs(folder: Path) -> None:
    """Remove the run or the campaign of an earlier command from a folder."""
    for run_folder in (*folder.glob(SEED_FOLDERS), folder):
        remove_run(run_folder)
