"""Search for runs in a folder and the folders under it."""

from __future__ import annotations

import os
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from datetime import UTC, datetime
from fnmatch import fnmatchcase
from pathlib import Path, PurePosixPath

from hiltest.errors import ConfigError
from hiltest.json_files import shown
from hiltest.report.trend.series import RunEntry
from hiltest.run_record.files import OLDER_FOLDER, RUN_FILE, SEED_FOLDERS, SEEDS_FILE
from hiltest.run_record.journal import JOURNAL_FILE
from hiltest.run_record.reader import check_record, find_record
from hiltest.run_record.run import SCHEMA as RUN_SCHEMA
from hiltest.run_record.run import Run
from hiltest.verdict.baseline import SCHEMA as BASELINE_SCHEMA
from hiltest.verdict.baseline import evidence_from
from hiltest.verdict.baseline_file import read_baseline
from hiltest.verdict.evidence import evidence_of, evidence_of_seeds

_RECORDS = frozenset({RUN_FILE, JOURNAL_FILE})
_OTHERWISE = "nothing of it is shown"
_LARGEST = 1e30


@dataclass(frozen=True, slots=True)
class Skipped:
    """A file that is no run or cannot be read, with the reason."""

    file: str
    reason: str


def read_folder(folder: Path) -> tuple[list[RunEntry], list[Skipped]]:
    """Read every run, campaign and baseline in a folder and the folders under it.

    Hidden folders, and the older firmware of a run with ``--against``, are omitted.

    Returns
    -------
    entries : list of RunEntry
        Entries, named by their paths relative to the folder.
    skipped : list of Skipped
        Files that have the name of a record or end with ``.json`` and cannot be read as one.

    Raises
    ------
    ConfigError
        If the folder does not exist.
    """
    if not folder.is_dir():
        raise ConfigError(f"{folder}: no such folder; name a folder with records of runs")
    entries: list[RunEntry] = []
    skipped: list[Skipped] = []

    def skip(path: Path, reason: str) -> None:
        named, _, rest = reason.partition(": ")  # the reason may name a file in the folder of the path
        is_there = rest and Path(named).is_relative_to(path)
        skipped.append(Skipped(_relative_name(Path(named) if is_there else path, folder), rest if is_there else reason))

    def unreadable(error: OSError) -> None:
        skip(Path(error.filename), error.strerror or str(error))

    for name, subfolders, files in os.walk(folder, onerror=unreadable):
        current = Path(name)
        subfolders[:] = sorted(
            subfolder for subfolder in subfolders if not (subfolder.startswith(".") or _is_older(subfolder, current))
        )
        runs = [current] if _RECORDS & set(files) else []
        for path in [*runs, *(current / file for file in sorted(files) if _may_be_record(file))]:
            try:
                entries += _entries(path, folder)
            except ConfigError as error:
                skip(path, str(error))
    return _campaigns(entries), skipped


def _is_older(name: str, folder: Path) -> bool:
    """Return whether a folder holds the older firmware of ``--against``, the base of the run in its parent folder."""
    if name != OLDER_FOLDER:
        return False
    return any((folder / file).exists() for file in (*_RECORDS, SEEDS_FILE)) or any(folder.glob(SEED_FOLDERS))


def _relative_name(path: Path, folder: Path) -> str:
    return path.relative_to(folder).as_posix()


def _may_be_record(name: str) -> bool:
    return name.endswith(".json") and name not in _RECORDS


def _entries(path: Path, folder: Path) -> Iterator[RunEntry]:
    """Yield the run or baseline in a file or folder; other files of hiltest yield nothing."""
    file = find_record(path, otherwise=_OTHERWISE)
    entry_name = _relative_name(file.path, folder)
    if file.has_family(BASELINE_SCHEMA):
        evidence = evidence_from(read_baseline(file), entry_name, file.sha256)
        knows_limits = any(
            measurement.limit
            for measurements in evidence.measurements.values()
            for measurement in measurements.values()
        )
        when_utc = _time(evidence.side.saved_utc, path)
        yield _check_size(RunEntry(entry_name, when_utc, evidence, knows_limits), path)
    elif path.is_dir() or file.has_family(RUN_SCHEMA):
        yield _run_entry(check_record(file).run, file.path, entry_name)
    elif not str(file.schema).startswith("hiltest."):
        raise ConfigError(f"{path}: not a record of hiltest: schema is {shown(file.schema)}")


def _run_entry(run: Run, path: Path, entry_name: str) -> RunEntry:
    if run.board is None:
        raise ConfigError(f"{path}: no board answered ({run.verdict.outcome})")
    return _check_size(RunEntry(entry_name, _time(run.started_utc, path), evidence_of(run, file=entry_name)), path)


def _check_size(entry: RunEntry, path: Path) -> RunEntry:
    """Reject numbers that are too large for a sum or an axis."""
    for measurements in entry.evidence.measurements.values():
        for measurement in measurements.values():
            if measurement.value is not None and abs(measurement.value) > _LARGEST:
                raise ConfigError(f"{path}: {shown(measurement.name)} is {measurement.value:g}, which nothing measures")
    return entry


def _time(text: str, path: Path) -> str:
    """Return a time in one format, so that times sort."""
    try:
        return datetime.fromisoformat(text).astimezone(UTC).strftime("%Y-%m-%dT%H:%M:%SZ")
    except (ValueError, OverflowError) as error:
        raise ConfigError(f"{path}: began at {shown(text)}, which is not a time") from error


def _campaigns(entries: Sequence[RunEntry]) -> list[RunEntry]:
    """Combine the seeds of a campaign if they have the same build and conditions."""
    alone: list[RunEntry] = []
    campaigns: dict[PurePosixPath, list[RunEntry]] = {}
    for entry in entries:
        seed_folder = PurePosixPath(entry.file).parent
        is_seed = fnmatchcase(seed_folder.name, SEED_FOLDERS)
        (campaigns.setdefault(seed_folder.parent, []) if is_seed else alone).append(entry)
    for folder, seeds in campaigns.items():
        joined = evidence_of_seeds([seed.evidence for seed in seeds], str(folder))
        alike = {(seed.evidence.conditions, _build(seed)) for seed in seeds}
        if len(alike) > 1 or len(joined.measurements) < len(seeds):
            alone += seeds
        else:
            alone.append(RunEntry(str(folder), min(seed.when_utc for seed in seeds), joined))
    return alone


def _build(entry: RunEntry) -> tuple[str, ...]:
    """Return the firmware of an entry."""
    side = entry.evidence.side
    return side.firmware, side.version, side.build_id, side.compiler, side.cycle_model
