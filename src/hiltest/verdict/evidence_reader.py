"""Reader of records of runs as one side of a comparison."""

from __future__ import annotations

import os
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

from hiltest.errors import ConfigError
from hiltest.json_files import read_json
from hiltest.run_record.files import RUN_FILE, SEED_FOLDERS, SEEDS_FILE
from hiltest.run_record.journal import JOURNAL_FILE
from hiltest.verdict.baseline import SCHEMA as BASELINE_SCHEMA
from hiltest.verdict.evidence import Evidence, allow_misses, evidence_of, evidence_of_seeds

_A_SIDE = "name a run.json, its folder or a baseline"


def read_evidence(place: Path) -> Evidence:
    """Read one side of a comparison.

    Parameters
    ----------
    place
        Folder of a run or its ``run.json``, the folder of a campaign, or a baseline file.

    Raises
    ------
    ConfigError
        If no record is there, or it cannot be read; the message has the reason and a remedy.
    """
    if os.path.isdir(place):
        seeds = sorted(folder for folder in place.glob(SEED_FOLDERS) if folder.is_dir())
        if not _has_run(place):
            return _campaign_evidence(place, seeds) if seeds else _run_evidence(place)
        if (place / SEEDS_FILE).exists():
            raise ConfigError(
                f"{place}: has both a single run and a campaign ({SEEDS_FILE}); name the run's {RUN_FILE}, or run "
                "again with another --out"
            )
        return _run_evidence(place)  # the run is newer than any seeds beside it: a campaign removes a single run first
    if place.name.endswith(".jsonl"):
        return _run_evidence(place)
    file = read_json(place, otherwise=_A_SIDE)
    if str(file.schema).partition("/")[0] == BASELINE_SCHEMA.partition("/")[0]:
        from hiltest.verdict.baseline_file import evidence_in

        return evidence_in(file)
    from hiltest.run_record.reader import record_in

    record = record_in(file)
    return evidence_of(record.run, file=str(place), sha256=record.sha256)


def read_runs(places: Sequence[Path]) -> Evidence:
    """Read one side of a comparison from several runs of one firmware: with one seed each, or on a real board.

    Raises
    ------
    ConfigError
        For the reasons of `read_evidence`.
    """
    runs = [read_evidence(place) for place in places]
    return runs[0] if len(runs) == 1 else evidence_of_seeds(runs, f"{places[0]} and {len(runs) - 1} more")


def _has_run(folder: Path) -> bool:
    """Return whether a folder holds the files of a single run; an empty journal belongs to one that never began."""
    journal = folder / JOURNAL_FILE
    return (folder / RUN_FILE).exists() or (journal.is_file() and journal.stat().st_size > 0)


def _run_evidence(place: Path) -> Evidence:
    from hiltest.run_record.reader import read_record

    record = read_record(place, otherwise=_A_SIDE)
    return evidence_of(record.run, file=str(record.path), sha256=record.sha256)


def _campaign_evidence(folder: Path, seeds: Sequence[Path]) -> Evidence:
    runs, faults = [], []
    if not (folder / SEEDS_FILE).exists():
        faults.append(f"{folder}: the campaign was cut short: it has no {SEEDS_FILE}; repeat it")
    for seed in seeds:
        try:
            runs.append(_run_evidence(seed))
        except ConfigError as error:
            faults.append(str(error))
    if not runs:
        raise ConfigError(faults[0])
    evidence = evidence_of_seeds(runs, str(folder))
    evidence = replace(evidence, faults=(*faults, *evidence.faults))
    return allow_misses(evidence) if _seeds_may_fail(folder / SEEDS_FILE) else evidence


def _seeds_may_fail(file: Path) -> bool:
    """Return whether a campaign passed although seeds missed limits, because some of them may."""
    try:
        content = read_json(file, otherwise="run the campaign again").content
    except ConfigError:
        return False
    return isinstance(content, dict) and content.get("exit_code") == 0
