"""A baseline: the numbers of a run that was kept, and the changes accepted since."""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from difflib import get_close_matches
from fnmatch import fnmatchcase
from typing import Literal

from hiltest.errors import ConfigError
from hiltest.json_files import shown
from hiltest.measurement import Limit, Measurement, Outcome, Tolerance
from hiltest.run_record.comparison import FromBuild, Side
from hiltest.run_record.outcomes import TestOutcome
from hiltest.run_record.run import Column, Table, refuse_twice
from hiltest.text import format_count, id_without_repetition
from hiltest.verdict.evidence import ERROR_COLUMN, REAL, Accepted, Conditions, Evidence, Seed
from hiltest.verdict.obstacles import obstacles
from hiltest.verdict.statistics import mean_value

SCHEMA: Literal["hiltest.baseline/2"] = "hiltest.baseline/2"
UNSEALED_SCHEMA: Literal["hiltest.baseline/1"] = "hiltest.baseline/1"
"""Schema of older files, which have no digest of their content."""
_POSE = ("heading", "pitch", "roll")


@dataclass(frozen=True, slots=True)
class BaselineRow:
    """One measurement on every seed of the baseline."""

    name: str
    unit: str
    cycle_model: str
    values: tuple[float | int | None, ...]
    """Values in the order of the baseline's seeds; None for a seed without a number."""
    failed: tuple[int | None, ...] = ()
    """Seeds on which the measurement was out of its limit."""
    limit: Limit | None = None
    """Limit of the measurement; None also in older files, which lack it."""
    tolerance: Tolerance | None = None
    """Tolerance that was in force; None in older files, which lack it."""
    build_id: str | None = None
    """Build that the measurement was accepted from; None for the build of the baseline's side."""


@dataclass(frozen=True, slots=True)
class Baseline:
    """Contents of a baseline file."""

    schema: Literal["hiltest.baseline/1", "hiltest.baseline/2"]
    saved_utc: str
    """Time at which the file was saved or last updated."""
    side: Side
    """The run that was saved, with the number of measurements accepted from other builds since."""
    conditions: Conditions
    seeds: tuple[int | None, ...]
    """Seeds; None for a board that simulates nothing, and the numbers of the runs if it ran several times."""
    measurements: tuple[BaselineRow, ...]
    """Measurements that are not volatile, sorted by name."""
    history: tuple[Accepted, ...] = ()
    """Accepted changes, oldest first."""
    passed: tuple[str, ...] = ()
    """Ids of the tests that passed on every seed; empty in older files, which lack them."""
    suites: Mapping[str, str] = field(default_factory=dict)
    """SHA-256 of each file of tests and each conftest.py of the saved run; empty in older files, which lack it."""
    poses: Table | None = None
    """Heading errors at the known angles, on the first seed; None in older files, which lack them."""

    def __post_init__(self) -> None:
        if not self.seeds:
            raise ValueError("it has no run: seeds is empty")
        if not self.measurements:
            raise ValueError("it has nothing to compare: measurements is empty")
        refuse_twice("seed", self.seeds)
        refuse_twice("measurement", [row.name for row in self.measurements])
        for row in self.measurements:
            if len(row.values) != len(self.seeds):
                raise ValueError(f"{shown(row.name)} has {len(row.values)} values for {len(self.seeds)} seeds")
            if all(value is None for value in row.values):
                raise ValueError(f"{shown(row.name)} has no number")


def baseline_of(evidence: Evidence, saved_utc: str) -> Baseline:
    """Make a baseline of one run, or of several that differ in their seed.

    Raises
    ------
    ConfigError
        If the run was cut short or only chosen tests ran, no board answered, or nothing has a number.
    """
    if evidence.faults or evidence.conditions is None:
        reason = evidence.faults[0] if evidence.faults else f"{evidence.name}: no board answered"
        raise ConfigError(f"{reason}; a baseline needs a complete run")
    if evidence.chosen:
        raise ConfigError(
            f"{evidence.name}: only chosen tests ran; a baseline needs a complete run: run all tests, without -k, -m "
            "or names of tests"
        )
    seeds = tuple(evidence.measurements)
    rows = rows_of(evidence, seeds)
    if not rows:
        raise ConfigError(f"{evidence.name}: it has no number; a baseline needs measurements")
    return Baseline(
        SCHEMA,
        saved_utc,
        kept_side(evidence, saved_utc),
        evidence.conditions,
        seeds,
        rows,
        passed=_passed_tests(evidence),
        suites=evidence.suites,
        poses=_heading_errors(evidence.poses),
    )


def evidence_from(baseline: Baseline, file: str, sha256: str) -> Evidence:
    """Return a baseline as one side of a comparison."""
    measurements = {
        seed: {row.name: _measurement(row, index, seed) for row in baseline.measurements}
        for index, seed in enumerate(baseline.seeds)
    }
    # The count is taken from the rows, which name their builds: the head of the file may have been edited.
    accepted = accepted_from(baseline.measurements)
    side = replace(baseline.side, file=file, sha256=sha256, saved_utc=baseline.saved_utc, accepted=accepted)
    builds = {row.name: row.build_id for row in baseline.measurements if row.build_id is not None}
    in_force = {row.name: row.tolerance for row in baseline.measurements if row.tolerance is not None}
    return Evidence(
        side,
        baseline.conditions,
        measurements,
        is_baseline=True,
        builds=builds,
        tolerances=in_force,
        in_force=in_force,
        suites=baseline.suites,
        sealed=baseline.schema == SCHEMA,
        record=baseline.side.sha256,
        history=baseline.history,
        poses=baseline.poses,
        tests={
            seed: dict.fromkeys(map(id_without_repetition, baseline.passed), TestOutcome.PASSED)
            for seed in baseline.seeds
        },
    )


def renewed(baseline: Baseline, before: Baseline) -> Baseline:
    """Return a baseline that replaces another one and continues its history."""
    entry = Accepted(
        "*",
        "renewed",
        baseline.saved_utc,
        baseline.side.build_id,
        None,
        None,
        before.side.build_id,
        baseline.side.revision,
    )
    return replace(baseline, history=(*before.history, entry))


def kept_side(run: Evidence, saved_utc: str) -> Side:
    """Return the side of a run for its baseline, without the path of its record."""
    return replace(run.side, file="", saved_utc=saved_utc)


def rows_of(evidence: Evidence, seeds: Sequence[Seed]) -> tuple[BaselineRow, ...]:
    """Return the measurements of a run that have a number on some seed and are not volatile, by name."""
    names = {name for measurement in evidence.measurements.values() for name in measurement}
    return tuple(row for name in sorted(names) if (row := _row(evidence, name, seeds)) is not None)


def accepted_from(rows: Sequence[BaselineRow]) -> tuple[FromBuild, ...]:
    """Count the measurements that come from other builds than the side's."""
    counts = Counter(row.build_id for row in rows if row.build_id is not None)
    return tuple(FromBuild(build_id, counts[build_id]) for build_id in sorted(counts))


def _heading_errors(poses: Table | None) -> Table | None:
    """Return the columns that a picture of the errors needs, in thousandths of a degree."""
    if poses is None:
        return None
    names = [column.name for column in poses.columns if column.name in _POSE or column.name.startswith(ERROR_COLUMN)]
    rows = zip(*(poses.column(name) for name in names), strict=True)
    return Table(
        poses.name,
        tuple(Column(name, "deg") for name in names),
        tuple(tuple(round(cell, 3) if isinstance(cell, float) else cell for cell in row) for row in rows),
    )


def _passed_tests(evidence: Evidence) -> tuple[str, ...]:
    """Return the tests that passed on every seed."""
    passed_on_seeds = [
        {test for test, outcome in outcomes.items() if outcome is TestOutcome.PASSED}
        for outcomes in evidence.tests.values()
    ]
    return tuple(sorted(set.intersection(*passed_on_seeds))) if passed_on_seeds else ()


def _row(evidence: Evidence, name: str, seeds: Sequence[Seed]) -> BaselineRow | None:
    """Return a measurement over the seeds; None if it was not made, has no number at all or is volatile."""
    by_seed = {seed: evidence.measurements[seed].get(name) for seed in seeds}
    first = next((measurement for measurement in by_seed.values() if measurement is not None), None)
    values = tuple(None if measurement is None else measurement.value for measurement in by_seed.values())
    if first is None or first.volatile or all(value is None for value in values):
        return None
    failed = tuple(
        seed for seed, measurement in by_seed.items() if measurement is not None and measurement.outcome is Outcome.FAIL
    )
    limit = next(
        (
            measurement.limit
            for measurement in by_seed.values()
            if measurement is not None and measurement.limit is not None
        ),
        None,
    )
    return BaselineRow(name, first.unit, first.cycle_model, values, failed, limit, evidence.in_force.get(name))


def _measurement(row: BaselineRow, index: int, seed: Seed) -> Measurement:
    outcome = Outcome.FAIL if seed in row.failed else Outcome.INFORMATION
    return Measurement(row.name, row.values[index], row.unit, row.limit, outcome=outcome, cycle_model=row.cycle_model)


def accept(baseline: Baseline, run: Evidence, patterns: Sequence[str], *, because: str, when_utc: str) -> Baseline:
    """Move the named measurements of a run into a baseline, and leave all others unchanged.

    Parameters
    ----------
    run
        Run on the same rig, with every seed of the baseline. A run of chosen tests removes no measurement.
    patterns
        Names of measurements; ``*`` stands for anything. Measurements that the run no longer makes are removed.
    because
        Reason for the change; recorded in the history.

    Raises
    ------
    ConfigError
        If nothing matches a pattern, the run cannot be compared with the baseline, it lacks a seed, or a measurement
        would be removed only because its test was not chosen.

    Notes
    -----
    Every measurement keeps its build. If all of them equal those of the run, the baseline becomes one of that run.
    """
    _refuse_another_bench(baseline, run)
    rows = {row.name: row for row in baseline.measurements}
    run_rows = {row.name: row for row in rows_of(run, baseline.seeds)}
    named = _matching_names(patterns, rows, run)
    _refuse_unchosen(run, [name for name in named if name in rows and name not in run_rows])
    moved = {name: run_rows.get(name) for name in named if run_rows.get(name) != _as_in_run(rows.get(name), run_rows)}
    if not moved:
        return baseline
    history = [
        Accepted(
            name,
            because,
            when_utc,
            run.side.build_id,
            _mean(rows.get(name)),
            _mean(row),
            _build_id(rows.get(name), baseline),
            run.side.revision,
        )
        for name, row in sorted(moved.items())
    ]
    from_run = {name: row and replace(row, build_id=run.side.build_id) for name, row in moved.items()}
    after = replace(baseline, schema=SCHEMA, saved_utc=when_utc, history=(*baseline.history, *history))
    return _replace_rows(after, rows | from_run, run_rows, run)


def _replace_rows(
    baseline: Baseline, rows: Mapping[str, BaselineRow | None], run_rows: Mapping[str, BaselineRow], run: Evidence
) -> Baseline:
    """Return a baseline with the given rows, which are of one run or of several builds."""
    remaining = {name: row for name, row in sorted(rows.items()) if row is not None}
    if not remaining:
        raise ConfigError(f"nothing changes: no measurement would remain, since {run.name} has none of the named ones")
    if run.conditions is not None and run_rows == {name: _as_in_run(row, run_rows) for name, row in remaining.items()}:
        side = replace(kept_side(run, baseline.saved_utc), seeds=baseline.side.seeds)
        rows_from_run = tuple(run_rows.values())
        baseline = replace(baseline, suites=run.suites, poses=_heading_errors(run.poses))
        return replace(baseline, side=side, conditions=run.conditions, measurements=rows_from_run)
    build_id = baseline.side.build_id
    measurements = tuple(replace(row, build_id=None) if row.build_id == build_id else row for row in remaining.values())
    side = replace(baseline.side, saved_utc=baseline.saved_utc, accepted=accepted_from(measurements))
    return replace(baseline, side=side, measurements=measurements)


def _refuse_another_bench(baseline: Baseline, run: Evidence) -> None:
    reasons = obstacles(evidence_from(baseline, "the baseline", ""), run, None, together=False)
    if reasons:
        raise ConfigError(f"nothing changes: {reasons[0]}")
    missing = [str(seed) for seed in baseline.seeds if seed not in run.measurements]
    if missing and baseline.conditions.board == REAL:
        raise ConfigError(
            f"{run.name} has {format_count(len(run.measurements), 'run')}, and the baseline {len(baseline.seeds)}; "
            "name as many, or "
            "save a new one: hiltest baseline save RUN... FILE"
        )
    if missing:
        raise ConfigError(
            f"{run.name} has no seed {', '.join(missing)}, which the baseline has: means need the same seeds; run "
            "with all of them (--seeds A..B)"
        )


def _refuse_unchosen(run: Evidence, missing: Sequence[str]) -> None:
    """Refuse to drop a measurement because its test did not run."""
    if run.chosen and missing:
        others = f" and {len(missing) - 1} more" if len(missing) > 1 else ""
        raise ConfigError(
            f"nothing changes: only chosen tests ran, and {run.name} has no {missing[0]}{others}; accept its "
            "measurements by their full names, or run all tests, without -k, -m or names of tests"
        )


def _matching_names(patterns: Sequence[str], rows: dict[str, BaselineRow], run: Evidence) -> list[str]:
    all_names = sorted({*rows, *(name for measurement in run.measurements.values() for name in measurement)})
    named: list[str] = []
    for pattern in patterns:
        matches = [name for name in all_names if name == pattern or fnmatchcase(name, pattern)]
        if not matches:
            nearest = get_close_matches(pattern, all_names, n=1)
            hint = f"; did you mean {nearest[0]!r}?" if nearest else ""
            raise ConfigError(
                f"no measurement has the name {pattern!r}, neither in the baseline nor in {run.name}{hint}"
            )
        named += matches
    return named


def _build_id(row: BaselineRow | None, baseline: Baseline) -> str | None:
    if row is None:
        return None
    return baseline.side.build_id if row.build_id is None else row.build_id


def _as_in_run(row: BaselineRow | None, run_rows: Mapping[str, BaselineRow]) -> BaselineRow | None:
    """Return a row as a run that measured the same values would have it, so that equal rows do not count as moved.

    A run states no build for a single measurement, and always a tolerance, which an older file does not state.
    """
    if row is None:
        return None
    same = run_rows.get(row.name, row)
    return replace(row, build_id=None, tolerance=row.tolerance or same.tolerance)


def _mean(row: BaselineRow | None) -> float | None:
    return mean_value([float(value) for value in row.values if value is not None]) if row else None
