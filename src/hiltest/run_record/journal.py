"""The journal of a run: one line of JSON for each finished test, on the disk before the next test starts.

``journal.jsonl`` exists as long as its run goes on, and the process holds a lock on it, which the kernel releases
however the process ends. The files in a folder therefore show the state of its run:

- no journal: ``run.json`` is the record of a run that has finished;
- a journal with a lock on it: the run goes on;
- a journal without a lock: the run was cut short, and the journal has every finished test. ``run.json``, if it exists,
  belongs to the previous run, unless the journal ends with the verdict: then both have the same content, and the
  journal also has the operator's steps, with which the next run can continue.
"""

from __future__ import annotations

import fcntl
import os
import time
from collections.abc import Mapping
from dataclasses import asdict, replace
from io import FileIO
from pathlib import Path
from typing import Any

from hiltest.errors import ConfigError, NothingRecordedError
from hiltest.json_files import JsonFile, json_line, parse_json_lines, read_json, require_schema
from hiltest.run_record.exit_codes import ExitCode
from hiltest.run_record.files import CAMPAIGN_FILE, COVERAGE_FILE, RECORD_FILES, SEEDS_FILE, UNFINISHED
from hiltest.run_record.run import SCHEMA, Verdict

JOURNAL_FILE = "journal.jsonl"

# A process that only checks whether a run goes on holds the lock for a moment; another run holds it longer than this.
_TRIES = 5
_BETWEEN_TRIES_S = 0.05
_OTHERWISE = "wait for it, or name another folder with --out"


STILL_RUNNING, CUT_SHORT = (
    asdict(Verdict(outcome, ExitCode.INTERRUPTED, "", complete=False)) for outcome in ("still running", "cut short")
)
"""Verdicts of runs without an end: never complete, and without a sentence."""


class Journal:
    """A folder that belongs to one run exclusively, from its construction to `release`.

    Parameters
    ----------
    folder
        Folder; its content stays unchanged until `begin`.
    name
        Name of the file.

    Raises
    ------
    ConfigError
        If another run uses the folder, which the message names, or the folder cannot be written to.
    """

    def __init__(self, folder: Path, name: str = JOURNAL_FILE) -> None:
        self.folder = folder
        self.path = folder / name
        try:
            self._file = _open_locked(self.path)
            # A line that a killed run was writing is dropped; its complete lines stay until `begin`.
            before = self._file.read()
            self._bytes_before = before.rfind(b"\n") + 1
            self._before = before[: self._bytes_before]
            self._file.truncate(self._bytes_before)
        except OSError as error:
            reason = error.strerror or str(error)
            raise ConfigError(f"cannot write a record to {folder}: {reason}; name another folder with --out") from error
        self._announced = self._begun = self._finished = False

    def earlier(self, kind: str) -> tuple[dict[str, Any], list[dict[str, Any]]]:
        """Return the start and the entries of a kind from the last run in this folder that wrote some.

        The result is empty without such a run, or if a line is damaged.
        """
        try:
            entries = parse_json_lines(self._before)
        except ValueError:
            return {}, []
        runs: list[list[dict[str, Any]]] = []
        for entry in entries:
            if entry.get("kind") == "start":
                runs.append([])
            if runs and entry.get("kind") in ("start", kind):
                runs[-1].append(entry)
        latest = next((run for run in reversed(runs) if len(run) > 1), None)
        return (latest[0], latest[1:]) if latest else ({}, [])

    def announce(self, content: Mapping[str, Any]) -> None:
        """Write the first line: from now on `hiltest report` reads this run instead of an earlier one in the folder."""
        self.append("start", {**content, "process": os.getpid()})
        self._announced = True

    def begin(self) -> None:
        """Remove the record of the previous run, since this run takes place."""
        remove_record(self.folder)
        if not self._announced:
            self._file.truncate(0)  # without a first line, old entries could pass for newer ones
        self._begun = True

    def append(self, kind: str, content: Mapping[str, Any]) -> None:
        """Write one entry through to the disk.

        Raises
        ------
        OSError
            If it cannot be written, as on a full disk; no part of the line remains.
        """
        line = json_line({"kind": kind, **content}) + "\n"
        # A lone surrogate, as in a file name that is not UTF-8, becomes a question mark.
        remaining = memoryview(line.encode("utf-8", "replace"))
        whole_bytes = os.fstat(self._file.fileno()).st_size
        try:
            while remaining:
                remaining = remaining[self._file.write(remaining) :]
            os.fsync(self._file.fileno())
        except OSError:
            self._file.truncate(whole_bytes)
            raise

    def finish(self) -> None:
        """Note that ``run.json`` has the whole content, so that `release` will remove the file."""
        self._finished = True

    def release(self) -> None:
        """Release the folder; the journal is removed if ``run.json`` has its whole content, or the run never began."""
        if self._file.closed:
            return
        if not self._begun:
            self._file.truncate(self._bytes_before)
        if self._finished or not (self._begun or self._bytes_before):
            # The file is removed under the lock: a process that opened it before notices that it was replaced.
            self.path.unlink(missing_ok=True)
        self._file.close()


def remove_record(folder: Path) -> None:
    """Remove the record of an earlier run or campaign from a folder, and half-written files of a killed one.

    The folders of a campaign's seeds stay: without the campaign's files they do not count as newer than a run.
    """
    for name in (*RECORD_FILES, COVERAGE_FILE, SEEDS_FILE, CAMPAIGN_FILE):
        (folder / name).unlink(missing_ok=True)
        for path in folder.glob(f"{name}.*{UNFINISHED}"):
            path.unlink(missing_ok=True)


def is_going_on(path: Path) -> bool:
    """Return whether the run of this journal still goes on."""
    descriptor = os.open(path, os.O_RDONLY | os.O_NONBLOCK)  # a pipe of this name would block
    try:
        fcntl.flock(descriptor, fcntl.LOCK_SH | fcntl.LOCK_NB)
    except BlockingIOError:
        return True
    finally:
        os.close(descriptor)
    return False


def read_journal(path: Path, *, otherwise: str) -> JsonFile:
    """Read the last run of a journal as the ``run.json`` that it would have; the types of its fields are not checked.

    A run without an end has the verdict `STILL_RUNNING` or `CUT_SHORT`.

    Parameters
    ----------
    otherwise
        Remedy if it is refused.

    Raises
    ------
    NothingRecordedError
        If no run has begun.
    ConfigError
        If it cannot be read, is of another schema, or a line is not an entry of a journal; the message has its number.
    """
    try:
        # The order matters: a run that is cut short between the two steps still counts as going on, and a finished one
        # does not count as cut short.
        going_on = is_going_on(path)
    except OSError as error:
        raise ConfigError(f"{path}: {error.strerror}; {otherwise}") from error
    file = read_json(path, otherwise=otherwise, in_lines=True)
    entries: list[dict[str, Any]] = file.content
    starts = [index for index, entry in enumerate(entries) if entry.get("kind") == "start"]
    if not starts:
        raise NothingRecordedError(f"{path}: it has no line; {otherwise}")
    start = {key: value for key, value in entries[starts[-1]].items() if key not in ("kind", "process")}
    require_schema(path, start.get("schema"), SCHEMA, otherwise=otherwise)
    content: dict[str, Any] = {
        "schema": None,
        "board": None,
        "rig": None,
        "seed": None,
        "calibration": None,
        **start,
        "finished_utc": start.get("started_utc"),
        "verdict": STILL_RUNNING if going_on else CUT_SHORT,
    }
    tests: list[Any] = []
    other_attempts: list[Any] = []
    measurements: dict[str, Any] = {}
    tables: dict[str, Any] = {}
    for number, entry in enumerate(entries[starts[-1] + 1 :], starts[-1] + 2):
        try:
            if entry["kind"] in ("rig", "board", "calibration", "end"):
                content |= {key: value for key, value in entry.items() if key != "kind"}
            elif entry["kind"] == "test":
                tests += [entry["test"]] if entry["test"] is not None else []
                measurements |= {measurement["name"]: measurement for measurement in entry["measurements"]}
                tables |= {table["name"]: table for table in entry["tables"]}
                other_attempts += entry.get("other_attempts", [])
                content["finished_utc"] = entry["utc"]
        except (LookupError, TypeError) as error:
            fault = f"line {number} is not an entry of a journal: {error}"
            raise ConfigError(f"{path}: {fault}; {otherwise}") from error
    content |= {"tests": tests, "other_attempts": other_attempts}
    for kind, by_name in {"measurements": measurements, "tables": tables}.items():
        content[kind] = [by_name[name] for name in sorted(by_name, key=str)]
    return replace(file, content=content, text=json_line(content).encode())


def _open_locked(path: Path) -> FileIO:
    for attempt in range(_TRIES):
        if attempt:
            time.sleep(_BETWEEN_TRIES_S)
        file = path.open("a+b", buffering=0)
        try:
            fcntl.flock(file, fcntl.LOCK_EX | fcntl.LOCK_NB)
            # The previous run may have removed the file between the two steps; then it has no other holder.
            if os.path.samestat(os.fstat(file.fileno()), path.stat()):
                file.seek(0)
                return file
        except (BlockingIOError, FileNotFoundError):
            pass
        except OSError:
            file.close()
            raise
        file.close()
    raise ConfigError(f"the folder {path.parent} is in use by {_holder(path)}: {_OTHERWISE}")


def _holder(path: Path) -> str:
    """Return the process that holds a journal, according to its first line."""
    try:
        start = [entry for entry in parse_json_lines(path.read_bytes()) if entry["kind"] == "start"][-1]
        return f"process {start['process']} on {start['environment']['host']}, since {start['started_utc']}"
    except (OSError, ValueError, LookupError, TypeError):
        return "another run that has just begun"
