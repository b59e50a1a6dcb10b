"""Records of runs as one side of a comparison."""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from dataclasses import replace
from hashlib import sha256
from pathlib import Path

from hiltest.comparison.baseline import SCHEMA as BASELINE_SCHEMA
from hiltest.comparison.evidence import NO_BOARD, Conditions, Evidence
from hiltest.comparison.model import Side, Tolerance
from hiltest.errors import ConfigError
from hiltest.report.journal import JOURNAL_FILE
from hiltest.report.record import Run
from hiltest.report.run_files import RUN_FILE, SEED_FOLDERS, SEEDS_FILE
from hiltest.report.verdict import failed_by_itself
from hiltest.strict_json import LARGEST_BYTES, is_folder, parse_json, read_bounded

_A_BASELINE = re.compile(rb'"schema"\s*:\s*"%s/' % re.escape(BASELINE_SCHEMA.partition("/")[0]).encode())
_A_SIDE = "name a run.json, its folder or a baseline"
_NO_SIDE = Side("", "", "", "", "", "", "", "", (), "")


def evidence_of(run: Run, *, file: str = "", sha256: str = "") -> Evidence:
    """Return one run as one side of a comparison.

    Parameters
    ----------
    run : Run
    file, sha256 : str, optional
        Where it was read from; empty for a run that is just ending.
    """
    board, rig = run.board, run.rig
    side = replace(_NO_SIDE, file=file, sha256=sha256, saved_utc=run.finished_utc, revision=run.revision)
    if board is not None:
        side = replace(
            side, firmware=board.firmware, version=board.version, build_id=board.build_id, compiler=board.compiler,
            cycle_model=board.cycle_model,
        )
    side = replace(side, rig=rig.name if rig else "", seeds=() if run.seed is None else (run.seed,))
    name = file or "this run"
    of_rig = _tolerances("rig.tolerances", run.rig.tolerances if run.rig else {}, name)
    fault = f"{name}: the run is not complete ({run.verdict.outcome}); run all of it again"
    return Evidence(
        side, _conditions(run), {run.seed: {each.name: each for each in run.measurements}}, of_rig,
        () if run.verdict.complete else (fault,), run.chosen, failed_by_itself(run),
        in_force=_tolerances("tolerances", run.tolerances, name),
        tests={run.seed: {each.id: each.outcome for each in run.tests}},  # the last attempt counts
    )


def read_evidence(place: Path) -> Evidence:
    """Read one side of a comparison.

    Parameters
    ----------
    place : Path
        A run's folder or its ``run.json``, the folder of a campaign, or a baseline file.

    Raises
    ------
    ConfigError
        If there is nothing of the kind, or it cannot be read; it says why and what to do.
    """
    if is_folder(place):
        seeds = sorted(each for each in place.glob(SEED_FOLDERS) if each.is_dir())
        if not _has_run(place):
            return _of_campaign(place, seeds) if seeds else _of_run(place)
        if (place / SEEDS_FILE).exists():
            raise ConfigError(
                f"{place}: holds both a single run and a campaign ({SEEDS_FILE}), one of them stale; name the run's "
                f"{RUN_FILE}, or run again with an --out of its own"
            )
        return _of_run(place)  # it is newer than any seeds beside it: a campaign begins by removing a single run
    content = read_bounded(place, largest_bytes=LARGEST_BYTES, otherwise=_A_SIDE)
    # A look is enough to tell which reader it is for; that one checks all of it.
    if _A_BASELINE.search(content):
        from hiltest.comparison.baseline_file import read_baseline_evidence

        return read_baseline_evidence(place)
    return _of_run(place)


def evidence_of_seeds(runs: Sequence[Evidence], file: str) -> Evidence:
    """Put runs that differ in their seed together as one side.

    Parameters
    ----------
    runs : sequence of Evidence
        At least one.
    file : str
        What to call them.
    """
    first = runs[0]
    faults = [fault for each in runs for fault in each.faults]
    for each in runs[1:]:
        if each.conditions != first.conditions:
            faults.append(f"{each.name}: under other conditions than {first.name}; run all seeds on one rig")
        elif _build(each.side) != _build(first.side):
            faults.append(f"{each.name}: of another firmware than {first.name}; run all seeds with one")
    measurements = {seed: found for each in runs for seed, found in each.measurements.items()}
    if len(measurements) < len(runs):
        faults.append(f"{file}: a seed stands there twice; run the campaign into an empty folder")
    digest = sha256("".join(each.side.sha256 for each in runs).encode()).hexdigest()
    side = replace(
        first.side, file=file, sha256=digest, seeds=tuple(seed for each in runs for seed in each.side.seeds),
        saved_utc=max(each.side.saved_utc for each in runs),
        revision=first.side.revision if len({each.side.revision for each in runs}) == 1 else None,
    )
    chosen = any(each.chosen for each in runs)
    failed = tuple(f"{why} on seed {', '.join(map(str, each.side.seeds))}" for each in runs for why in each.failed)
    return Evidence(
        side, first.conditions, measurements, first.tolerances, tuple(faults), chosen, failed,
        in_force={name: each for run in reversed(runs) for name, each in run.in_force.items()},
        tests={seed: found for each in runs for seed, found in each.tests.items()},
    )


def no_evidence(file: str) -> Evidence:
    """Return a side of which there is no record at all; what is compared with it cannot be judged."""
    return Evidence(replace(_NO_SIDE, file=file), None, {})


def _conditions(run: Run) -> Conditions | None:
    if run.board is None:
        # A run without one is whole only where no test needed it: its numbers are as good as any.
        return Conditions(
            board=NO_BOARD, rig_sha256=run.rig.conditions_sha256 if run.rig else "", calibrators=(), sensors=(),
            protocol_version=0, compiler_flags=(), poses=run.poses, suite=run.suite,
            calibrated=run.calibration is not None,
        ) if run.verdict.complete else None
    return Conditions(
        board=run.board.kind, rig_sha256=run.rig.conditions_sha256 if run.rig else "",
        calibrators=run.board.calibrators, sensors=tuple(each.name for each in run.board.sensors if each.present),
        protocol_version=run.board.protocol_version, compiler_flags=tuple(run.board.compiler_flags.split()),
        poses=run.poses, suite=run.suite, calibrated=run.calibration is not None,
    )


def _has_run(folder: Path) -> bool:
    """Say whether a folder holds what a single run wrote; a journal without a line is of one that never began."""
    journal = folder / JOURNAL_FILE
    return (folder / RUN_FILE).exists() or (journal.is_file() and journal.stat().st_size > 0)


def _tolerances(place: str, content: Mapping[str, tuple[float, float]], file: str) -> dict[str, Tolerance]:
    found = {}
    for name, each in content.items():
        try:
            found[name] = Tolerance(*each)
        except ValueError as error:
            raise ConfigError(f"{file}: {place}.{name}: {error}; run it again: hiltest run") from error
    return found


def _of_run(place: Path) -> Evidence:
    from hiltest.report.stored import read_stored

    stored = read_stored(place, otherwise=_A_SIDE)
    return evidence_of(stored.run, file=str(stored.path), sha256=stored.sha256)


def _of_campaign(folder: Path, seeds: Sequence[Path]) -> Evidence:
    runs, faults = [], []
    if not (folder / SEEDS_FILE).exists():
        faults.append(f"{folder}: the campaign was cut short: it has no {SEEDS_FILE}; run all of it again")
    for each in seeds:
        try:
            runs.append(_of_run(each))
        except ConfigError as error:
            faults.append(str(error))
    if not runs:
        raise ConfigError(faults[0])
    found = evidence_of_seeds(runs, str(folder))
    found = replace(found, faults=(*faults, *found.faults))
    return with_misses_allowed(found) if _seeds_may_fail(folder / SEEDS_FILE) else found


def with_misses_allowed(campaign: Evidence) -> Evidence:
    """Return the runs of a campaign that may miss a limit on some seeds, and has."""
    return replace(campaign, may_miss=True)


def _seeds_may_fail(file: Path) -> bool:
    """Say whether a campaign passed by itself, whatever single seeds did: some of them were allowed to miss limits."""
    try:
        content = parse_json(read_bounded(file, largest_bytes=LARGEST_BYTES, otherwise="run the campaign again"))
    except (ConfigError, ValueError):
        return False
    return isinstance(content, dict) and content.get("exit_code") == 0


def _build(side: Side) -> tuple[str, ...]:
    return (side.firmware, side.version, side.build_id, side.compiler, side.cycle_model)


