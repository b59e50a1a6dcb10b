"""A baseline: the numbers of a run that was kept, and what was accepted into it since."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from fnmatch import fnmatchcase
from typing import Literal

from hiltest.comparison.evidence import Conditions, Evidence, Seed
from hiltest.comparison.interval import mean_value
from hiltest.comparison.model import Side
from hiltest.comparison.obstacles import obstacles
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
    """

    name: str
    unit: str
    cycle_model: str
    values: tuple[float | int | None, ...]
    failed: tuple[int | None, ...] = ()
    limit: Limit | None = None


@dataclass(frozen=True, slots=True)
class Accepted:
    """One measurement that was moved into a baseline, from which build, and why.

    Attributes
    ----------
    name : str
        ``*`` where all were, by saving a run over the file.
    was, now : float or None
        Means over the seeds; None where there was none, or is none any more.
    """

    name: str
    because: str
    when_utc: str
    build_id: str
    was: float | None
    now: float | None


@dataclass(frozen=True, slots=True)
class Baseline:
    """What stands in a baseline file.

    Attributes
    ----------
    side : Side
        Of the run that was saved; what was accepted since may be of other builds.
    seeds : tuple of int or None
        None for a board that simulates nothing.
    measurements : tuple of Row
        Sorted by name; none of them volatile.
    history : tuple of Accepted
        Oldest first.
    """

    schema: Literal["hiltest.baseline/1"]
    saved_utc: str
    side: Side
    conditions: Conditions
    seeds: tuple[int | None, ...]
    measurements: tuple[Row, ...]
    history: tuple[Accepted, ...] = ()


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
    names = {name for each in evidence.measurements.values() for name in each}
    rows = tuple(row for name in sorted(names) if (row := _row(evidence, name, seeds)) is not None)
    if not rows:
        raise ConfigError(f"{evidence.name}: it has no number at all; a baseline is a run that measured something")
    side = replace(evidence.side, file="", sha256="", saved_utc=saved_utc)
    return Baseline(SCHEMA, saved_utc, side, evidence.conditions, seeds, rows)


def evidence_from(baseline: Baseline, file: str, sha256: str) -> Evidence:
    """Return a baseline as one side of a comparison."""
    measurements = {
        seed: {row.name: _measurement(row, index, seed) for row in baseline.measurements}
        for index, seed in enumerate(baseline.seeds)
    }
    side = replace(baseline.side, file=file, sha256=sha256, saved_utc=baseline.saved_utc)
    return Evidence(side, baseline.conditions, measurements)


def accept(
    baseline: Baseline, run: Evidence, patterns: Sequence[str], *, because: str, when_utc: str
) -> Baseline:
    """Move the named measurements of a run into a baseline, and keep all others.

    Parameters
    ----------
    baseline : Baseline
    run : Evidence
        On the same rig, with every seed of the baseline.
    patterns : sequence of str
        Names of measurements; ``*`` stands for anything. One that the run no longer makes is taken out.
    because : str
        Why it may be as it is now; goes into the history.
    when_utc : str

    Raises
    ------
    ConfigError
        If nothing has a name, the run is no like of the baseline, or it lacks a seed.
    """
    _refuse_another_bench(baseline, run)
    rows = {row.name: row for row in baseline.measurements}
    moved = {name: _row(run, name, baseline.seeds) for name in _named(patterns, rows, run)}
    history = [
        Accepted(name, because, when_utc, run.side.build_id, _mean(rows.get(name)), _mean(row))
        for name, row in sorted(moved.items()) if row != rows.get(name)
    ]
    kept = {name: row for name, row in (rows | moved).items() if row is not None}
    if not kept:
        raise ConfigError(f"nothing is moved: no measurement would be left; {run.name} has none of these")
    measurements = tuple(kept[name] for name in sorted(kept))
    return replace(baseline, measurements=measurements, history=(*baseline.history, *history))


def renewed(baseline: Baseline, before: Baseline) -> Baseline:
    """Return a baseline that takes the place of another, whose history goes on."""
    entry = Accepted("*", "renewed", baseline.saved_utc, baseline.side.build_id, None, None)
    return replace(baseline, history=(*before.history, entry))


def _refuse_another_bench(baseline: Baseline, run: Evidence) -> None:
    reasons = obstacles(evidence_from(baseline, "the baseline", ""), run, None, together=False)
    if reasons:
        raise ConfigError(f"nothing is moved: {reasons[0]}")
    missing = [str(seed) for seed in baseline.seeds if seed not in run.measurements]
    if missing:
        raise ConfigError(
            f"{run.name} has no seed {', '.join(missing)}, which the baseline has: a mean over some old and some new "
            "seeds says nothing; run with all of them (--seeds A..B)"
        )


def _named(patterns: Sequence[str], rows: dict[str, Row], run: Evidence) -> list[str]:
    known = sorted({*rows, *(name for each in run.measurements.values() for name in each)})
    named: list[str] = []
    for pattern in patterns:
        found = [name for name in known if name == pattern or fnmatchcase(name, pattern)]
        if not found:
            raise ConfigError(f"no measurement is called {pattern!r}, neither in the baseline nor in {run.name}")
        named += found
    return named


def _row(evidence: Evidence, name: str, seeds: Sequence[Seed]) -> Row | None:
    """Return a measurement over the seeds; None when it was not made, has no number at all or is volatile."""
    made = {seed: evidence.measurements[seed].get(name) for seed in seeds}
    first = next((each for each in made.values() if each is not None), None)
    values = tuple(None if each is None else each.value for each in made.values())
    if first is None or first.volatile or all(value is None for value in values):
        return None
    failed = tuple(seed for seed, each in made.items() if each is not None and each.outcome is Outcome.FAIL)
    limit = next((each.limit for each in made.values() if each is not None and each.limit is not None), None)
    return Row(name, first.unit, first.cycle_model, values, failed, limit)


def _measurement(row: Row, index: int, seed: Seed) -> Measurement:
    outcome = Outcome.FAIL if seed in row.failed else Outcome.INFORMATION
    return Measurement(row.name, row.values[index], row.unit, row.limit, outcome=outcome, cycle_model=row.cycle_model)


def _mean(row: Row | None) -> float | None:
    return mean_value([float(value) for value in row.values if value is not None]) if row else None
