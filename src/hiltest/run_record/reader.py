"""Reader of records: finished ones, and journals of runs that were cut short or still go on."""

from __future__ import annotations

import os
from collections.abc import Iterator, Mapping, Sequence
from contextlib import suppress
from dataclasses import asdict, dataclass, replace
from hashlib import sha256
from pathlib import Path
from typing import Any

from hiltest.errors import ConfigError
from hiltest.json_files import (
    LARGEST_BYTES,
    JsonFile,
    json_line,
    parse_json,
    read_as,
    read_bounded,
    read_json,
    require_schema,
    shown,
)
from hiltest.run_record.failures import unfinished_verdict
from hiltest.run_record.files import CAMPAIGN_FILE, RUN_FILE, SEED_FOLDERS
from hiltest.run_record.journal import JOURNAL_FILE, is_going_on
from hiltest.run_record.run import SCHEMA, Run, Verdict, mark_worst, tolerances_in_force, volatile_places
from hiltest.text import join_words

OTHERWISE = "render another record, or run again: hiltest run"
"""The next step for a record that cannot be read."""

# A run can begin or finish between two checks of its folder.
_TRIES = 3
_SEEDS_AT_MOST = 3
_UNKNOWN = asdict(Verdict("cut short", 2, "", complete=False))


@dataclass(frozen=True, slots=True)
class RecordFile:
    """A record and its file."""

    run: Run
    content: Mapping[str, Any]
    """Content as in JSON, including fields that only a newer hiltest knows; rewritten records are made from it."""
    path: Path
    """``run.json`` or the journal."""
    sha256: str
    """Digest of that file as it was read."""
    ended: bool
    """True if the run finished, so that the verdict is its own."""


def read_record(place: Path, *, otherwise: str = OTHERWISE) -> RecordFile:
    """Read the record of a run.

    Parameters
    ----------
    place
        Folder of a run, a ``run.json`` or a ``journal.jsonl``.
    otherwise
        Remedy for a file that is not JSON.

    Raises
    ------
    ConfigError
        If there is no record, or it cannot be read; the message has the reason and a remedy.
    """
    if place.name.endswith(".jsonl") and not os.path.isdir(place):
        return _read_journal(place)
    if not os.path.isdir(place):
        return record_in(read_json(place, otherwise=otherwise))
    record, journal = place / RUN_FILE, place / JOURNAL_FILE
    for _ in range(_TRIES):
        if journal.exists():
            with suppress(_NothingRecordedError):
                stored = _read_journal(journal)
                # For a finished run, run.json has the same content as soon as it is written.
                if not (stored.ended and record.exists()):
                    return stored
        if record.exists():
            return record_in(read_json(record, otherwise=otherwise))
    if seeds := sorted(str(folder) for folder in place.glob(SEED_FOLDERS) if folder.is_dir()):
        named = join_words(seeds, _SEEDS_AT_MOST)
        raise ConfigError(f"{place}: a campaign, not one run: {_campaign_state(place)}; name one of {named}")
    raise ConfigError(f"{place} has no record of a run: neither {RUN_FILE} nor a line in {JOURNAL_FILE}")


def _campaign_state(place: Path) -> str:
    """Return the file that summarises a campaign."""
    page = place / CAMPAIGN_FILE
    return f"all its seeds are in {page}" if page.exists() else f"cut short or going on, without {CAMPAIGN_FILE}"


class _NothingRecordedError(ConfigError):
    """A journal that was removed again, or that has no first line yet."""


def record_in(file: JsonFile) -> RecordFile:
    """Check the content of a ``run.json``.

    Raises
    ------
    ConfigError
        If it is of another schema, or a field is missing or wrong. Unknown fields are no error.
    """
    return RecordFile(_parse_run(file), file.content, file.path, file.sha256, ended=True)


def _parse_run(file: JsonFile) -> Run:
    path, run = file.path, read_as(file, Run, SCHEMA, otherwise=OTHERWISE)
    for kind, names in _unique_names(run):
        if len(set(names)) < len(names):
            twice = next(name for name in names if names.count(name) > 1)
            raise ConfigError(f"{path}: {kind} {shown(twice)} appears twice; {OTHERWISE}")
    for table in run.tables:
        for number, row in enumerate(table.rows, 1):
            if len(row) != len(table.columns):
                cells = f"{len(row)} cells in {len(table.columns)} columns"
                raise ConfigError(f"{path}: table {shown(table.name)}, row {number}: {cells}; {OTHERWISE}")
    return run


def _unique_names(run: Run) -> Iterator[tuple[str, Sequence[str]]]:
    """Yield names that must be unique, with their kind."""
    yield "measurement", [measurement.name for measurement in run.measurements]
    yield "table", [table.name for table in run.tables]
    for table in run.tables:
        yield f"column of table {shown(table.name)}:", [column.name for column in table.columns]


def _read_journal(path: Path) -> RecordFile:
    # The order matters: a run that is cut short between the two steps still counts as going on, and a finished one
    # does not count as cut short.
    try:
        going_on = is_going_on(path)
        text = read_bounded(path, largest_bytes=LARGEST_BYTES, otherwise=OTHERWISE)
    except (OSError, ConfigError) as error:
        reason = f"{path}: {error.strerror}" if isinstance(error, OSError) else str(error)
        raise (ConfigError if os.path.lexists(path) else _NothingRecordedError)(reason) from error
    lines = text.split(b"\n")
    # The process was writing the last, incomplete line when it ended.
    entries = [_entry(path, number, line) for number, line in enumerate(lines[:-1], 1)]
    starts = [index for index, entry in enumerate(entries) if entry.get("kind") == "start"]
    if not starts:
        raise _NothingRecordedError(f"{path}: it has no line; {OTHERWISE}")
    content = _join_entries(path, entries[starts[-1] :], first_line=starts[-1] + 1)
    run = _parse_run(JsonFile(path, json_line(content).encode(), content))
    ended = content["verdict"] is not _UNKNOWN
    run = replace(
        run,
        verdict=run.verdict if ended else unfinished_verdict(run, going_on=going_on),
        measurements=mark_worst(run.measurements, run.other_attempts),
    )
    run = replace(run, volatile=volatile_places(run), tolerances=_tolerances(run, path))
    noted = [
        {**read, "note": measurement.note}
        for read, measurement in zip(content["measurements"], run.measurements, strict=True)
    ]
    settled = {
        "verdict": asdict(run.verdict),
        "measurements": noted,
        "volatile": run.volatile,
        "tolerances": run.tolerances,
    }
    return RecordFile(run, content | settled, path, sha256(text).hexdigest(), ended)


def _tolerances(run: Run, path: Path) -> dict[str, tuple[float, float]]:
    try:
        return tolerances_in_force(run)
    except ValueError as error:
        raise ConfigError(f"{path}: rig.tolerances: {error}; {OTHERWISE}") from error


def _entry(path: Path, number: int, line: bytes) -> dict[str, Any]:
    try:
        entry = parse_json(line)
    except ValueError as error:
        raise ConfigError(f"{path}: line {number} is damaged: {error}; earlier lines are complete") from error
    if not isinstance(entry, dict):
        raise ConfigError(f"{path}: line {number} is not an entry of a journal; {OTHERWISE}")
    return entry


def _join_entries(path: Path, entries: list[dict[str, Any]], *, first_line: int) -> dict[str, Any]:
    """Join the entries to the content of ``run.json``; its fields are validated later."""
    start = {key: value for key, value in entries[0].items() if key not in ("kind", "process")}
    require_schema(path, start.get("schema"), SCHEMA, otherwise=OTHERWISE)
    content: dict[str, Any] = {
        "schema": None,
        "board": None,
        "rig": None,
        "seed": None,
        "calibration": None,
        **start,
        "finished_utc": start.get("started_utc"),
        "verdict": _UNKNOWN,
    }
    tests: list[Any] = []
    other_attempts: list[Any] = []
    measurements: dict[str, Any] = {}
    tables: dict[str, Any] = {}
    for number, entry in enumerate(entries[1:], first_line + 1):
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
            raise ConfigError(f"{path}: line {number} is not an entry of a journal: {error}; {OTHERWISE}") from error
    by_kind = {"measurements": measurements, "tables": tables}
    return (
        content
        | {"tests": tests, "other_attempts": other_attempts}
        | {kind: [by_name[name] for name in sorted(by_name, key=str)] for kind, by_name in by_kind.items()}
    )
