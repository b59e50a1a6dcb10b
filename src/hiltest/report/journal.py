"""The journal of a run: one line of JSON for each finished test, on the disk before the next test starts.

``journal.jsonl`` is there as long as its run goes on, and the process holds a lock on it, which the kernel takes back
however the process ends. What lies in a folder therefore says what became of its run:

====================  ==================================================
``run.json`` alone    finished
a journal, locked     goes on
a journal, not        was cut short; everything that had finished is in it
====================  ==================================================

A journal without a line beside ``run.json`` belongs to a run that came later and has not begun to record.
"""

from __future__ import annotations

import fcntl
import json
import os
import time
from collections.abc import Mapping
from pathlib import Path
from typing import IO, Any

from hiltest.errors import ConfigError
from hiltest.report.record import RECORD_FILES, UNFINISHED

JOURNAL_FILE = "journal.jsonl"

# Whoever only asks whether a run goes on holds the lock for a moment; another run holds it for longer than this.
_TRIES = 5
_BETWEEN_TRIES_S = 0.05
_OTHERWISE = "wait for it, or name another folder with --out"


class Journal:
    """A folder that belongs to one run, from here to `release`.

    Parameters
    ----------
    folder : Path
        What lies in it stays as it is until `begin`.

    Raises
    ------
    ConfigError
        If another run has the folder; it says which. Or if the folder cannot be written to.
    """

    def __init__(self, folder: Path) -> None:
        self.folder = folder
        self.path = folder / JOURNAL_FILE
        try:
            self._file = _open_locked(self.path)
        except OSError as error:
            reason = error.strerror or str(error)
            raise ConfigError(f"cannot keep a record in {folder}: {reason}; name another one with --out") from error
        self._begun = self._finished = False

    def begin(self, content: Mapping[str, Any]) -> None:
        """Remove the record of the run before, so that it is never taken for this one's, and write the first line."""
        remove_record(self.folder)
        self._file.truncate(0)
        self._begun = True
        self.append("start", {**content, "process": os.getpid()})

    def append(self, kind: str, content: Mapping[str, Any]) -> None:
        """Write one entry through to the disk.

        Raises
        ------
        OSError
            If it cannot be written, as on a full disk; no part of the line is left then.
        """
        line = json.dumps({"kind": kind, **content}, allow_nan=False, ensure_ascii=False) + "\n"
        # A lone surrogate, as of a file's name that is no UTF-8, becomes a question mark.
        left = memoryview(line.encode("utf-8", "replace"))
        whole_bytes = os.fstat(self._file.fileno()).st_size
        try:
            while left:
                left = left[self._file.write(left):]
            os.fsync(self._file.fileno())
        except OSError:
            self._file.truncate(whole_bytes)
            raise

    def finish(self) -> None:
        """Note that ``run.json`` holds all of it: `release` will remove the file."""
        self._finished = True

    def release(self) -> None:
        """Give the folder back; a journal that holds nothing, or nothing more than ``run.json``, goes with it."""
        if self._file.closed:
            return
        nothing = not self._begun and os.fstat(self._file.fileno()).st_size == 0
        if self._finished or nothing:
            # While it is locked: who opened it before that will see that it is another file now.
            self.path.unlink(missing_ok=True)
        self._file.close()


def remove_record(folder: Path) -> None:
    """Remove what a run before wrote into a folder, and what a killed one left half-written."""
    for name in RECORD_FILES:
        (folder / name).unlink(missing_ok=True)
        for path in folder.glob(f"{name}.*{UNFINISHED}"):
            path.unlink(missing_ok=True)


def is_going_on(path: Path) -> bool:
    """Say whether the run of this journal still goes on."""
    with path.open("rb") as file:
        try:
            fcntl.flock(file, fcntl.LOCK_SH | fcntl.LOCK_NB)
        except BlockingIOError:
            return True
        return False


def _open_locked(path: Path) -> IO[bytes]:
    for attempt in range(_TRIES):
        if attempt:
            time.sleep(_BETWEEN_TRIES_S)
        file = path.open("ab", buffering=0)
        try:
            fcntl.flock(file, fcntl.LOCK_EX | fcntl.LOCK_NB)
            # The run that had it may have removed it between the two steps: then it is nobody's.
            if os.path.samestat(os.fstat(file.fileno()), path.stat()):
                return file
        except (BlockingIOError, FileNotFoundError):
            pass
        except OSError:
            file.close()
            raise
        file.close()
    raise ConfigError(f"the folder {path.parent} is in use by {_holder(path)}: {_OTHERWISE}")


def _holder(path: Path) -> str:
    """Return who holds a journal, as far as its first line tells."""
    try:
        with path.open("rb") as file:
            start = json.loads(file.readline())
        return f"process {start['process']} on {start['environment']['host']}, since {start['started_utc']}"
    except (OSError, ValueError, LookupError, TypeError):
        return "another run that has just begun"
