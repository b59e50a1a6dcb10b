"""Read a record: a finished one, or the journal of a run that was cut short or still goes on."""

from __future__ import annotations

import json
import os
from collections.abc import Iterator, Mapping, Sequence
from contextlib import suppress
from dataclasses import asdict, dataclass, replace
from hashlib import sha256
from pathlib import Path
from typing import Any

from pydantic import TypeAdapter, ValidationError

from hiltest.errors import ConfigError
from hiltest.record.failures import unfinished_verdict
from hiltest.record.files import CAMPAIGN_FILE, RUN_FILE, SEED_FOLDERS
from hiltest.record.journal import JOURNAL_FILE, is_going_on
from hiltest.record.run import SCHEMA, Run, Verdict, in_force, marked, volatile_places
from hiltest.strict_json import LARGEST_BYTES, JsonFile, parse_json, read_bounded, read_json, shown
from hiltest.text import listed

OTHERWISE = "render another record, or run again: hiltest run"
"""The next step for a record that cannot be read."""

_ADAPTER = TypeAdapter(Run)
# A run can begin or finish between two looks at its folder.
_TRIES = 3
_SEEDS_AT_MOST = 3
_UNKNOWN = asdict(Verdict("cut short", 2, "", complete=False))


@dataclass(frozen=True, slots=True)
class RecordFile:
    """A record as it was read."""

    run: Run
    content: Mapping[str, Any]
    """The same as JSON has it, with every field that only a newer hiltest knows: what is written again is written
    of this."""
    path: Path
    """``run.json`` or the journal."""
    sha256: str
    """Digest of that file as it was read."""
    ended: bool
    """Whether the run has come to its end, and the verdict is its own."""


def read_record(place: Path, *, otherwise: str = OTHERWISE) -> RecordFile:
    """Read the record of a run.

    Parameters
    ----------
    place
        A run's folder, a ``run.json`` or a ``journal.jsonl``.
    otherwise
        What to do where a file is no JSON.

    Raises
    ------
    ConfigError
        If there is none, or it cannot be read; says why and what to do.
    """
    if place.name.endswith(".jsonl") and not os.path.isdir(place):
        return _from_journal(place)
    if not os.path.isdir(place):
        return record_in(read_json(place, otherwise=otherwise))
    record, journal = place / RUN_FILE, place / JOURNAL_FILE
    for _ in range(_TRIES):
        if journal.exists():
            with suppress(_NothingRecordedError):
                stored = _from_journal(journal)
                # Of a run that has come to its end run.json holds the same, once it is written.
                if not (stored.ended and record.exists()):
                    return stored
        if record.exists():
            return record_in(read_json(record, otherwise=otherwise))
    if seeds := sorted(str(each) for each in place.glob(SEED_FOLDERS) if each.is_dir()):
        named = listed(seeds, _SEEDS_AT_MOST)
        raise ConfigError(f"{place}: a campaign, not one run: {_of_all_seeds(place)}; name one of {named}")
    raise ConfigError(f"{place}: no record of a run: neither {RUN_FILE} nor a line in {JOURNAL_FILE}")


def _of_all_seeds(place: Path) -> str:
    """Return the file that sums up a campaign."""
    page = place / CAMPAIGN_FILE
    return f"all its seeds are in {page}" if page.exists() else f"cut short or going on, without {CAMPAIGN_FILE}"


class _NothingRecordedError(ConfigError):
    """A journal that is gone again, or in which no run has written its first line yet."""


def record_in(file: JsonFile) -> RecordFile:
    """Check what stands in a ``run.json``.

    Raises
    ------
    ConfigError
        If it is of another schema, or a field is missing or wrong; says which. Unknown fields are no error.
    """
    _check_schema(file.path, file.schema, file.content)
    return RecordFile(_run_from(file.content, file.path), file.content, file.path, file.sha256, ended=True)


def _check_schema(path: Path, found: object, content: Any) -> None:
    """Refuse what is no record of a run, and what is one of another major version."""
    if found == SCHEMA:
        return
    said = f"{path}: schema is {shown(found)}, this hiltest reads {shown(SCHEMA)}"
    if not isinstance(found, str) or found.partition("/")[0] != SCHEMA.partition("/")[0]:
        raise ConfigError(f"{said}: it is no record of a run")
    try:
        writer = f" (hiltest {shown(content['environment']['versions']['hiltest'])})"
    except (LookupError, TypeError):
        writer = ""
    raise ConfigError(f"{said}: use the version that wrote it{writer}, or make the run again with this one")


def _run_from(content: Mapping[str, Any], path: Path) -> Run:
    try:
        # As JSON, and strictly: a number in quotes is no number, and a list is what a tuple is written as.
        run = _ADAPTER.validate_json(json.dumps(content), strict=True)
    except ValidationError as error:
        first = error.errors()[0]
        place = "".join(f"{step}." for step in first["loc"])[:-1]
        raise ConfigError(f"{path}: {place or 'as a whole'}: {first['msg']}; {OTHERWISE}") from error
    for kind, names in _named_once(run):
        if len(set(names)) < len(names):
            twice = next(name for name in names if names.count(name) > 1)
            raise ConfigError(f"{path}: {kind} {shown(twice)} stands twice; {OTHERWISE}")
    for table in run.tables:
        for number, row in enumerate(table.rows, 1):
            if len(row) != len(table.columns):
                cells = f"{len(row)} cells in {len(table.columns)} columns"
                raise ConfigError(f"{path}: table {shown(table.name)}, row {number}: {cells}; {OTHERWISE}")
    return run


def _named_once(run: Run) -> Iterator[tuple[str, Sequence[str]]]:
    """Yield the names that may each stand once, and of what."""
    yield "measurement", [measurement.name for measurement in run.measurements]
    yield "table", [each.name for each in run.tables]
    for table in run.tables:
        yield f"column of table {shown(table.name)}:", [column.name for column in table.columns]


def _from_journal(path: Path) -> RecordFile:
    # In this order: a run that is cut short between the two still counts as one that goes on, and none that has
    # come to its end counts as cut short.
    try:
        going_on = is_going_on(path)
        text = read_bounded(path, largest_bytes=LARGEST_BYTES, otherwise=OTHERWISE)
    except (OSError, ConfigError) as error:
        said = f"{path}: {error.strerror}" if isinstance(error, OSError) else str(error)
        raise (ConfigError if os.path.lexists(path) else _NothingRecordedError)(said) from error
    lines = text.split(b"\n")
    # What follows the last line's end was being written when the process ended.
    entries = [_entry(path, number, line) for number, line in enumerate(lines[:-1], 1)]
    starts = [index for index, entry in enumerate(entries) if entry.get("kind") == "start"]
    if not starts:
        raise _NothingRecordedError(f"{path}: no run has written its first line; {OTHERWISE}")
    content = _replayed(path, entries[starts[-1]:], first_line=starts[-1] + 1)
    run = _run_from(content, path)
    ended = content["verdict"] is not _UNKNOWN
    several = {other_attempt.name for other_attempt in run.other_attempts}
    run = replace(
        run, verdict=run.verdict if ended else unfinished_verdict(run, going_on=going_on),
        measurements=tuple(marked(each) if each.name in several else each for each in run.measurements),
    )
    run = replace(run, volatile=volatile_places(run), tolerances=_tolerances(run, path))
    noted = [
        {**read, "note": each.note} for read, each in zip(content["measurements"], run.measurements, strict=True)
    ]
    settled = {
        "verdict": asdict(run.verdict), "measurements": noted, "volatile": run.volatile, "tolerances": run.tolerances,
    }
    return RecordFile(run, content | settled, path, sha256(text).hexdigest(), ended)


def _tolerances(run: Run, path: Path) -> dict[str, tuple[float, float]]:
    try:
        return in_force(run)
    except ValueError as error:
        raise ConfigError(f"{path}: rig.tolerances: {error}; {OTHERWISE}") from error


def _entry(path: Path, number: int, line: bytes) -> dict[str, Any]:
    try:
        entry = parse_json(line)
    except ValueError as error:
        raise ConfigError(f"{path}: line {number} is damaged: {error}; the lines before it are whole") from error
    if not isinstance(entry, dict):
        raise ConfigError(f"{path}: line {number} is no entry of a journal; {OTHERWISE}")
    return entry


def _replayed(path: Path, entries: list[dict[str, Any]], *, first_line: int) -> dict[str, Any]:
    """Join the entries as ``run.json`` has them; they are checked as its fields are."""
    start = {key: value for key, value in entries[0].items() if key not in ("kind", "process")}
    _check_schema(path, start.get("schema"), start)
    content: dict[str, Any] = {
        "schema": None, "board": None, "rig": None, "seed": None, "calibration": None, **start,
        "finished_utc": start.get("started_utc"), "verdict": _UNKNOWN,
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
                measurements |= {each["name"]: each for each in entry["measurements"]}
                tables |= {each["name"]: each for each in entry["tables"]}
                other_attempts += entry.get("other_attempts", [])
                content["finished_utc"] = entry["utc"]
        except (LookupError, TypeError) as error:
            raise ConfigError(f"{path}: line {number} is no entry of a journal: {error}; {OTHERWISE}") from error
    listed = {"measurements": measurements, "tables": tables}
    return content | {"tests": tests, "other_attempts": other_attempts} | {
        kind: [by_name[name] for name in sorted(by_name, key=str)] for kind, by_name in listed.items()
    }
