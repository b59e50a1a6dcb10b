"""Accepting a change into a baseline, by name."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from difflib import get_close_matches
from fnmatch import fnmatchcase

from hiltest.comparison.baseline import (
    Accepted,
    Baseline,
    Row,
    accepted_from,
    evidence_from,
    kept_side,
    rows_of,
)
from hiltest.comparison.evidence import Evidence
from hiltest.comparison.interval import mean_value
from hiltest.comparison.obstacles import obstacles
from hiltest.errors import ConfigError


def accept(
    baseline: Baseline, run: Evidence, patterns: Sequence[str], *, because: str, when_utc: str
) -> Baseline:
    """Move the named measurements of a run into a baseline, and keep all others.

    Parameters
    ----------
    baseline : Baseline
    run : Evidence
        On the same rig, with every seed of the baseline. One of chosen tests takes nothing out.
    patterns : sequence of str
        Names of measurements; ``*`` stands for anything. One that the run no longer makes is taken out.
    because : str
        Why it may be as it is now; goes into the history.
    when_utc : str

    Raises
    ------
    ConfigError
        If nothing has a name, the run is no like of the baseline, it lacks a seed, or a measurement that its tests
        were not chosen for would be taken out.

    Notes
    -----
    Every measurement keeps the build that it is of. Once all are those of the run, the baseline is of that run.
    """
    _refuse_another_bench(baseline, run)
    rows = {row.name: row for row in baseline.measurements}
    of_run = {row.name: row for row in rows_of(run, baseline.seeds)}
    named = _named(patterns, rows, run)
    _refuse_what_was_not_chosen(run, [name for name in named if name in rows and name not in of_run])
    moved = {name: of_run.get(name) for name in named if of_run.get(name) != _as_of_run(rows.get(name), of_run)}
    if not moved:
        return baseline
    history = [
        Accepted(
            name, because, when_utc, run.side.build_id, _mean(rows.get(name)), _mean(row),
            _build_id(rows.get(name), baseline), run.side.revision,
        )
        for name, row in sorted(moved.items())
    ]  # fmt: skip
    from_run = {name: row and replace(row, build_id=run.side.build_id) for name, row in moved.items()}
    after = replace(baseline, saved_utc=when_utc, history=(*baseline.history, *history))
    return _with_rows(after, rows | from_run, of_run, run)


def _with_rows(
    baseline: Baseline, rows: Mapping[str, Row | None], of_run: Mapping[str, Row], run: Evidence
) -> Baseline:
    """Return a baseline with these measurements, of the run that they all are of or of several builds."""
    kept = {name: row for name, row in sorted(rows.items()) if row is not None}
    if not kept:
        raise ConfigError(f"nothing is moved: no measurement would be left; {run.name} has none of these")
    if run.conditions is not None and of_run == {name: _as_of_run(row, of_run) for name, row in kept.items()}:
        side = replace(kept_side(run, baseline.saved_utc), seeds=baseline.side.seeds)
        return replace(baseline, side=side, conditions=run.conditions, measurements=tuple(of_run.values()))
    build_id = baseline.side.build_id
    measurements = tuple(replace(row, build_id=None) if row.build_id == build_id else row for row in kept.values())
    side = replace(baseline.side, saved_utc=baseline.saved_utc, accepted=accepted_from(measurements))
    return replace(baseline, side=side, measurements=measurements)


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


def _refuse_what_was_not_chosen(run: Evidence, missing: Sequence[str]) -> None:
    """Take nothing out because its test did not run."""
    if run.chosen and missing:
        others = f" and {len(missing) - 1} more" if len(missing) > 1 else ""
        raise ConfigError(
            f"nothing is moved: only chosen tests ran, and {run.name} has no {missing[0]}{others}; accept what it "
            "measured, by names that nothing else has, or run all tests, without -k, -m or names of tests"
        )


def _named(patterns: Sequence[str], rows: dict[str, Row], run: Evidence) -> list[str]:
    known = sorted({*rows, *(name for each in run.measurements.values() for name in each)})
    named: list[str] = []
    for pattern in patterns:
        found = [name for name in known if name == pattern or fnmatchcase(name, pattern)]
        if not found:
            nearest = get_close_matches(pattern, known, n=1)
            hint = f"; did you mean {nearest[0]!r}?" if nearest else ""
            raise ConfigError(f"no measurement is called {pattern!r}, neither in the baseline nor in {run.name}{hint}")
        named += found
    return named


def _build_id(row: Row | None, baseline: Baseline) -> str | None:
    if row is None:
        return None
    return baseline.side.build_id if row.build_id is None else row.build_id


def _as_of_run(row: Row | None, of_run: Mapping[str, Row]) -> Row | None:
    """Return a measurement as a run has it that measured the same: what two builds have alike was not moved.

    The run knows no build of a single measurement, and always a tolerance, which an older file does not state.
    """
    if row is None:
        return None
    same = of_run.get(row.name, row)
    return replace(row, build_id=None, tolerance=row.tolerance or same.tolerance)


def _mean(row: Row | None) -> float | None:
    return mean_value([float(value) for value in row.values if value is not None]) if row else None
