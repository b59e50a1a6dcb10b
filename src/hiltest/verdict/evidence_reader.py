"""Reader of records of runs as one side of a comparison."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

from hiltest.errors import ConfigError
from hiltest.json_files import read_json
from hiltest.run_record.files import SEEDS_FILE
from hiltest.run_record.reader import check_record, find_record, find_seeds
from hiltest.verdict.baseline import SCHEMA as BASELINE_SCHEMA
from hiltest.verdict.baseline import evidence_from
from hiltest.verdict.baseline_file import read_baseline
from hiltest.verdict.evidence import Evidence, allow_misses, evidence_of, evidence_of_seeds


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
    seeds = find_seeds(place)
    if not seeds:
        file = find_record(place, otherwise="name a run.json, its folder or a baseline")
        if file.has_family(BASELINE_SCHEMA):
            return evidence_from(read_baseline(file), str(file.path), file.sha256)
        record = check_record(file)
        return evidence_of(record.run, file=str(file.path), sha256=file.sha256)
    return _campaign_evidence(place, seeds)


def read_runs(places: Sequence[Path]) -> Evidence:
    """Read one side of a comparison from several runs of one firmware: with one seed each, or on a real board.

    Raises
    ------
    ConfigError
        For the reasons of `read_evidence`.
    """
    runs = [read_evidence(place) for place in places]
    return runs[0] if len(runs) == 1 else evidence_of_seeds(runs, f"{places[0]} and {len(runs) - 1} more")


def _campaign_evidence(folder: Path, seeds: Sequence[Path]) -> Evidence:
    runs, faults = [], []
    if not (folder / SEEDS_FILE).exists():
        faults.append(f"{folder}: the campaign was cut short: it has no {SEEDS_FILE}; repeat it")
    for seed in seeds:
        try:
            runs.append(read_evidence(seed))
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
