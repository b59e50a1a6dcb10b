"""Read a record back: a finished one, or what the journal of a run holds that was cut short or still goes on."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import Any

from hiltest.errors import ConfigError
from hiltest.report.journal import JOURNAL_FILE, is_going_on
from hiltest.report.record import RUN_FILE, Run, Verdict, volatile_places
from hiltest.report.schema import LARGEST_BYTES, check_schema, load_content, run_from
from hiltest.report.verdict import unfinished_verdict
from hiltest.strict_json import parse_json, read_bounded

_TRIES = 3
_NOT_YET = Verdict("cut short", 2, "", complete=False)
_OTHERWISE = "render another record, or run again: hiltest run"


@dataclass(frozen=True, slots=True)
class StoredRun:
    """A record as it was read.

    Attributes
    ----------
    run : Run
    content : mapping
        The same as JSON has it, with every field that only a newer hiltest knows: what is written again is written
        of this.
    path : Path
        ``run.json`` or the journal.
    """

    run: Run
    content: Mapping[str, Any]
    path: Path


def read_stored(place: Path) -> StoredRun:
    """Read the record of a run.

    Parameters
    ----------
    place : Path
        A run's folder, a ``run.json`` or a ``journal.jsonl``.

    Raises
    ------
    ConfigError
        If there is none, or it cannot be read; says why and what to do.
    """
    if not place.is_dir():
        return _from_journal(place) if place.name.endswith(".jsonl") else _from_record(place)
    for _ in range(_TRIES):
        try:
            return _from_folder(place)
        except _MovedOnError:
            continue
    raise ConfigError(f"{place}: runs come and go in this folder; read it again when they are through")


class _MovedOnError(ConfigError):
    """A run has finished, and removed its journal, while it was being read."""

    def __init__(self, path: Path) -> None:
        super().__init__(f"{path}: its run has finished, and {RUN_FILE} holds all of it")


def _from_folder(folder: Path) -> StoredRun:
    record, journal = folder / RUN_FILE, folder / JOURNAL_FILE
    has_record = record.exists()
    try:
        has_lines, goes_on = journal.stat().st_size > 0, is_going_on(journal)
    except FileNotFoundError:
        if not has_record:
            if record.exists():
                raise _MovedOnError(journal) from None
            raise ConfigError(f"{folder}: no record of a run: neither {RUN_FILE} nor {JOURNAL_FILE}") from None
        return _from_record(record)
    except OSError as error:
        raise ConfigError(f"{journal}: {error.strerror or error}") from error
    if has_lines:
        return _from_record(record) if has_record else _from_journal(journal)
    what = "has not begun to record yet" if goes_on else "was cut short before it began to record"
    older = f"; {record} is of the run before" if has_record else ""
    raise ConfigError(f"{folder}: the run that has this folder {what}{older}")


def _from_record(path: Path) -> StoredRun:
    content = load_content(path)
    return StoredRun(run_from(content, path), content, path)


def _from_journal(path: Path) -> StoredRun:
    try:
        going_on = is_going_on(path)
        lines = read_bounded(path, largest_bytes=LARGEST_BYTES, otherwise=_OTHERWISE).split(b"\n")
    except (OSError, ConfigError) as error:
        if not path.exists() and (path.parent / RUN_FILE).exists():
            raise _MovedOnError(path) from None
        raise ConfigError(f"{path}: {error.strerror}" if isinstance(error, OSError) else str(error)) from error
    # What follows the last line's end was being written when the process ended.
    content = _replayed(path, [_entry(path, number, line) for number, line in enumerate(lines[:-1], 1)])
    run = run_from(content, path)
    run = replace(run, verdict=unfinished_verdict(run, going_on=going_on), volatile=volatile_places(run))
    return StoredRun(run, {**content, "verdict": asdict(run.verdict), "volatile": run.volatile}, path)


def _entry(path: Path, number: int, line: bytes) -> dict[str, Any]:
    try:
        entry = parse_json(line)
    except ValueError as error:
        raise ConfigError(f"{path}: line {number} is damaged: {error}; the lines before it are whole") from error
    if not isinstance(entry, dict):
        raise ConfigError(f"{path}: line {number} is no entry of a journal; {_OTHERWISE}")
    return entry


def _replayed(path: Path, entries: list[dict[str, Any]]) -> dict[str, Any]:
    """Put the entries together as ``run.json`` would have them; what they hold is checked as its fields are."""
    if not entries or entries[0].get("kind") != "start":
        raise ConfigError(f"{path}: no journal of a run: it does not begin with a start; {_OTHERWISE}")
    start = {key: value for key, value in entries[0].items() if key not in ("kind", "process")}
    check_schema(path, start)
    content: dict[str, Any] = {
        "schema": None, "verdict": asdict(_NOT_YET), "board": None, "rig": None, "seed": None, **start,
        "finished_utc": start.get("started_utc"),
    }
    tests: list[Any] = []
    other_attempts: list[Any] = []
    measurements: dict[str, Any] = {}
    tables: dict[str, Any] = {}
    for number, entry in enumerate(entries[1:], 2):
        try:
            if entry["kind"] in ("rig", "board"):
                content |= {key: entry[key] for key in (entry["kind"], "seed")}
            elif entry["kind"] == "test":
                tests += [entry["test"]] if entry["test"] is not None else []
                measurements |= {each["name"]: each for each in entry["measurements"]}
                tables |= {each["name"]: each for each in entry["tables"]}
                other_attempts += entry.get("other_attempts", [])
                content["finished_utc"] = entry["utc"]
        except (LookupError, TypeError) as error:
            raise ConfigError(f"{path}: line {number} is no entry of a journal: {error}; {_OTHERWISE}") from error
    listed = {"measurements": measurements, "tables": tables}
    return content | {"tests": tests, "other_attempts": other_attempts} | {
        kind: [by_name[name] for name in sorted(by_name, key=str)] for kind, by_name in listed.items()
    }
