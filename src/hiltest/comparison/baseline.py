"""A baseline: the numbers of a run that was kept, and what was accepted into it since."""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Literal

from hiltest.comparison.evidence import PASSED, Conditions, Evidence, Seed
from hiltest.comparison.model import FromBuild, Revision, Side, Tolerance
from hiltest.errors import ConfigError
from hiltest.measurement import Limit, Measurement, Outcome

SCHEMA: Literal["hiltest.baseline/1"] = "hiltest.baseline/1"


@dataclass(frozen=True, slots=True)
class Row:
    """One measurement on every seed of the baseline.

    Attributes
    ----------
    values : tuple of float, int or None
        In the order of the baseline's seeds; None where there was no number.
    failed : tuple of int or None
        Seeds on which it was out of its limit.
    limit : Limit or None
        That it had; None too in a file from before it was kept.
    tolerance : Tolerance or None
        That was in force; None in a file from before it was kept.
    build_id : str or None
        Of the firmware that it was accepted from; None for that of the baseline's side.
    """

    name: str
    unit: str
    cycle_model: str
    values: tuple[float | int | None, ...]
    failed: tuple[int | None, ...] = ()
    limit: Limit | None = None
    tolerance: Tolerance | None = None
    build_id: str | None = None


@dataclass(frozen=True, slots=True)
class Accepted:
    """One measurement that was moved into a baseline, from which build, and why.

    Attributes
    ----------
    name : str
        ``*`` where all were, by saving a run over the file.
    build_id : str
        That it is of since.
    was, now : float or None
        Means over the seeds; None where there was none, or is none any more.
    was_build_id : str or None
        That it was of before; None where there was none, and in a file from before it was kept.
    revision : Revision or None
        That the run was made for.
    """

    name: str
    because: str
    when_utc: str
    build_id: str
    was: float | None
    now: float | None
    was_build_id: str | None = None
    revision: Revision | None = None


@dataclass(frozen=True, slots=True)
class Baseline:
    """What stands in a baseline file.

    Attributes
    ----------
    saved_utc : str
        When it was saved, or last updated.
    side : Side
        Of the run that was saved; it counts what was accepted since and is of other builds.
    seeds : tuple of int or None
        None for a board that simulates nothing.
    measurements : tuple of Row
        Sorted by name; none of them volatile.
    history : tuple of Accepted
        Oldest first.
    passed : tuple of str
        Ids of the tests that passed on every seed; empty in a file from before they were kept.
    """

    schema: Literal["hiltest.baseline/1"]
    saved_utc: str
    side: Side
    conditions: Conditions
    seeds: tuple[int | None, ...]
    measurements: tuple[Row, ...]
    history: tuple[Accepted, ...] = ()
    passed: tuple[str, ...] = ()


def baseline_of(evidence: Evidence, saved_utc: str) -> Baseline:
    """Make a baseline of a run, or of several that differ in their seed.

    Raises
    ------
    ConfigError
        If the run was cut short or only chosen tests ran, no board answered, or nothing has a number.
    """
    if evidence.faults or evidence.conditions is None:
        reason = evidence.faults[0] if evidence.faults else f"{evidence.name}: no board answered"
        raise ConfigError(f"{reason}; a baseline is a run that is whole")
    if evidence.chosen:
        raise ConfigError(
            f"{evidence.name}: only chosen tests ran; a baseline is a run that is whole: run all of them, without -k, "
            "-m or names of tests"
        )
    seeds = tuple(evidence.measurements)
    rows = rows_of(evidence, seeds)
    if not rows:
        raise ConfigError(f"{evidence.name}: it has no number at all; a baseline is a run that measured something")
    return Baseline(
        SCHEMA, saved_utc, kept_side(evidence, saved_utc), evidence.conditions, seeds, rows, passed=_passed(evidence)
    )


def evidence_from(baseline: Baseline, file: str, sha256: str) -> Evidence:
    """Return a baseline as one side of a comparison."""
    measurements = {
        seed: {row.name: _measurement(row, index, seed) for row in baseline.measurements}
        for index, seed in enumerate(baseline.seeds)
    }
    # Counted here: the lines say what they are of, whatever was made of the file's head.
    accepted = accepted_from(baseline.measurements)
    side = replace(baseline.side, file=file, sha256=sha256, saved_utc=baseline.saved_utc, accepted=accepted)
    builds = {row.name: row.build_id for row in baseline.measurements if row.build_id is not None}
    in_force = {row.name: row.tolerance for row in baseline.measurements if row.tolerance is not None}
    return Evidence(
        side, baseline.conditions, measurements, is_baseline=True, builds=builds, in_force=in_force,
        tests={seed: dict.fromkeys(baseline.passed, PASSED) for seed in baseline.seeds},
    )


def renewed(baseline: Baseline, before: Baseline) -> Baseline:
    """Return a baseline that takes the place of another, whose history goes on."""
    entry = Accepted(
        "*", "renewed", baseline.saved_utc, baseline.side.build_id, None, None, before.side.build_id,
        baseline.side.revision,
    )  # fmt: skip
    return replace(baseline, history=(*before.history, entry))


def kept_side(run: Evidence, saved_utc: str) -> Side:
    """Return the side of a run as its baseline has it: where its record once lay says nothing to anybody else."""
    return replace(run.side, file="", sha256="", saved_utc=saved_utc)


def rows_of(evidence: Evidence, seeds: Sequence[Seed]) -> tuple[Row, ...]:
    """Return every measurement of a run that has a number on one of the seeds, and is not volatile, by name."""
    names = {name for each in evidence.measurements.values() for name in each}
    return tuple(row for name in sorted(names) if (row := _row(evidence, name, seeds)) is not None)


def accepted_from(rows: Sequence[Row]) -> tuple[FromBuild, ...]:
    """Count what is of other builds than the side."""
    counts = Counter(row.build_id for row in rows if row.build_id is not None)
    return tuple(FromBuild(build_id, counts[build_id]) for build_id in sorted(counts))


def _passed(evidence: Evidence) -> tuple[str, ...]:
    """Return the tests that passed on every seed."""
    on_each = [{test for test, outcome in made.items() if outcome == PASSED} for made in evidence.tests.values()]
    return tuple(sorted(set.intersection(*on_each))) if on_each else ()


def _row(evidence: Evidence, name: str, seeds: Sequence[Seed]) -> Row | None:
    """Return a measurement over the seeds; None when it was not made, has no number at all or is volatile."""
    made = {seed: evidence.measurements[seed].get(name) for seed in seeds}
    first = next((each for each in made.values() if each is not None), None)
    values = tuple(None if each is None else each.value for each in made.values())
    if first is None or first.volatile or all(value is None for value in values):
        return None
    failed = tuple(seed for seed, each in made.items() if each is not None and each.outcome is Outcome.FAIL)
    limit = next((each.limit for each in made.values() if each is not None and each.limit is not None), None)
    return Row(name, first.unit, first.cycle_model, values, failed, limit, evidence.in_force.get(name))


def _measurement(row: Row, index: int, seed: Seed) -> Measurement:
    outcome = Outcome.FAIL if seed in row.failed else Outcome.INFORMATION
    return Measurement(row.name, row.values[index], row.unit, row.limit, outcome=outcome, cycle_model=row.cycle_model)
