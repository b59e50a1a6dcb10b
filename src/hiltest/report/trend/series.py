"""Measurements over runs under the same conditions, and their change points."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import pairwise
from statistics import fmean

from hiltest.measurement import Limit, Measurement, Outcome
from hiltest.run_record.comparison import Change, Difference
from hiltest.verdict.chance import chance_of
from hiltest.verdict.compare import add_accuracy
from hiltest.verdict.difference import difference
from hiltest.verdict.evidence import Evidence, Seed
from hiltest.verdict.pairs import Pairs
from hiltest.verdict.run_noise import FALSE_ALARMS

_MOVED = (Change.WORSE, Change.BETTER, Change.CHANGED)  # order of the changes of one run


@dataclass(frozen=True, slots=True)
class RunEntry:
    """A run, a campaign of several seeds or a baseline, with its time.

    `knows_limits` is false for an older baseline, which lacks the limits of its numbers.
    """

    file: str
    when_utc: str
    evidence: Evidence
    knows_limits: bool = True


@dataclass(frozen=True, slots=True)
class TrendLine:
    """Conditions that joined runs share: rig, cycle model, seeds and known angles."""

    rig: str
    rig_sha256: str
    board: str
    cycle_model: str
    sensors: tuple[str, ...]
    poses: str
    calibrated: bool
    seeds: tuple[Seed, ...]


@dataclass(frozen=True, slots=True)
class Point:
    """One measurement of one entry: over several seeds their mean, smallest and largest value.

    If the entry does not know its limit, it is that of the previous point.
    """

    entry: int
    value: float
    low: float
    high: float
    limit: Limit | None
    outcome: str
    knows_limit: bool = True


@dataclass(frozen=True, slots=True)
class ChangePoint:
    """A change beyond the tolerance, between successive entries of a line that have the number."""

    before: int
    after: int
    difference: Difference


@dataclass(frozen=True, slots=True)
class Series:
    """One measurement of one line, in order of time; `line` is an index into `Trend.lines`."""

    line: int
    cycle_model: str
    points: tuple[Point, ...]
    change_points: tuple[ChangePoint, ...]


@dataclass(frozen=True, slots=True)
class MeasurementTrend:
    """One measurement over all entries."""

    name: str
    unit: str
    series: tuple[Series, ...]

    @property
    def change_points(self) -> tuple[ChangePoint, ...]:
        """Change points of all its series, in order of time."""
        return tuple(
            sorted((step for series in self.series for step in series.change_points), key=lambda step: step.after)
        )

    @property
    def limit(self) -> Limit | None:
        """Limit of the newest entry that states one."""
        knowing = [point for series in self.series for point in series.points if point.knows_limit]
        return max(knowing, key=lambda point: point.entry).limit if knowing else None


@dataclass(frozen=True, slots=True)
class Trend:
    """All measurements, by name, over entries in order of time; `line_of` is the index of each entry's line."""

    entries: tuple[RunEntry, ...]
    lines: tuple[TrendLine, ...]
    line_of: tuple[int, ...]
    measured: tuple[MeasurementTrend, ...]

    @property
    def change_points(self) -> tuple[ChangePoint, ...]:
        """Change points of all measurements, the newest first; those of one run in the order of a comparison."""
        steps = (step for measured in self.measured for step in measured.change_points)
        return tuple(
            sorted(steps, key=lambda step: (-step.after, _MOVED.index(step.difference.change), step.difference.concern))
        )


def trend_of(entries: Sequence[RunEntry]) -> Trend:
    """Join measurements that were made under the same conditions, and detect the change points.

    Parameters
    ----------
    entries
        Entries in any order, each with a board that answered.

    Returns
    -------
    Trend
        Trend with the changes that a comparison of two successive runs would call better, worse or changed.
    """
    in_time = tuple(sorted(entries, key=lambda entry: (entry.when_utc, entry.file)))
    line_of = [conditions_of(entry) for entry in in_time]
    lines: dict[TrendLine, list[int]] = {}
    for index, line in enumerate(line_of):
        lines.setdefault(line, []).append(index)
    series: dict[tuple[str, str], list[Series]] = {}
    for number, indices in enumerate(lines.values()):
        for key, numbers in _numbers(in_time, indices).items():
            series.setdefault((key.name, key.unit), []).append(_series(key, number, in_time, numbers))
    measured = tuple(MeasurementTrend(name, unit, tuple(series[name, unit])) for name, unit in sorted(series))
    numbers_of = {line: number for number, line in enumerate(lines)}
    return Trend(in_time, tuple(lines), tuple(numbers_of[line] for line in line_of), measured)


def conditions_of(entry: RunEntry) -> TrendLine:
    """Return the conditions of an entry, which joined entries share."""
    side, conditions = entry.evidence.side, entry.evidence.conditions
    seeds = tuple(sorted(entry.evidence.measurements, key=lambda seed: -1 if seed is None else seed))
    if conditions is None:
        return TrendLine(side.rig, "", "", side.cycle_model, (), "", calibrated=False, seeds=seeds)
    return TrendLine(
        side.rig,
        conditions.rig_sha256,
        conditions.board,
        side.cycle_model,
        conditions.sensors,
        conditions.poses,
        calibrated=conditions.calibrated,
        seeds=seeds,
    )


@dataclass(frozen=True, slots=True)
class _Key:
    """Name, unit and cycle model, which all points of a line share."""

    name: str
    unit: str
    cycle_model: str


# By entry and seed.
_Numbers = dict[int, dict[Seed, Measurement]]


def _numbers(entries: Sequence[RunEntry], indices: Sequence[int]) -> dict[_Key, _Numbers]:
    """Return the measurements of some entries, except volatile ones, which say nothing about the firmware."""
    numbers: dict[_Key, _Numbers] = {}
    for index in indices:
        for seed, measurements in entries[index].evidence.measurements.items():
            for measurement in measurements.values():
                if measurement.value is not None and not measurement.volatile:
                    key = _Key(measurement.name, measurement.unit, measurement.cycle_model)
                    numbers.setdefault(key, {}).setdefault(index, {})[seed] = measurement
    return numbers


def _series(key: _Key, line: int, entries: Sequence[RunEntry], numbers: _Numbers) -> Series:
    points = [_point(index, by_seed, knows_limit=entries[index].knows_limits) for index, by_seed in numbers.items()]
    for number, point in enumerate(points[1:], 1):
        if not point.knows_limit:
            points[number] = replace(point, limit=points[number - 1].limit)
    return Series(line, key.cycle_model, tuple(points), tuple(_steps(key.name, entries, numbers)))


def _point(index: int, by_seed: Mapping[Seed, Measurement], *, knows_limit: bool) -> Point:
    values = [float(measurement.value) for measurement in by_seed.values() if measurement.value is not None]
    shown = _deciding_seed(by_seed)
    return Point(index, fmean(values), min(values), max(values), shown.limit, str(shown.outcome), knows_limit)


def _steps(name: str, entries: Sequence[RunEntry], numbers: _Numbers) -> Iterator[ChangePoint]:
    for (before, base), (after, new) in pairwise(numbers.items()):
        paired = base.keys() & new.keys()
        if all(base[seed].value == new[seed].value for seed in paired):
            continue
        evidence = entries[after].evidence
        was, now = ({seed: _remove_limit(side[seed]) for seed in paired} for side in (base, new))
        pairs = Pairs(name, was, now)
        board = evidence.conditions.board if evidence.conditions else ""
        share = FALSE_ALARMS / max(map(len, evidence.measurements.values()))  # of all that this run measured
        chance = replace(chance_of(pairs, board, evidence.tolerances), share=share)
        change = difference(pairs, board, evidence.tolerances, chance)
        if change.change in _MOVED:
            described = add_accuracy(change, entries[before].evidence.measurements, evidence.measurements)
            yield ChangePoint(before, after, replace(described, outcome=str(_deciding_seed(new).outcome)))


def _remove_limit(measurement: Measurement) -> Measurement:
    """Return a measurement without its limit: a limit that was moved is no change of the measurement."""
    return replace(measurement, outcome=Outcome.INFORMATION)


def _deciding_seed(by_seed: Mapping[Seed, Measurement]) -> Measurement:
    """Return the measurement of one of several seeds: one that gates, if any."""
    return next((measurement for measurement in by_seed.values() if measurement.gates), next(iter(by_seed.values())))
