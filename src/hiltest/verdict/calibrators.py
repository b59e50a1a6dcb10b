"""Accuracy and cost of each calibrator of a run."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

from hiltest.calibration.fit import FitStatus
from hiltest.measurement import KINDS, Measurement, Outcome, cannot_be_ranked
from hiltest.run_record.run import Run

WORST_HEADING = KINDS["heading.{calibrator}.max"]
MEAN_ERROR = KINDS["heading.{calibrator}.bias"]
UNCALIBRATED = "uncalibrated"
AS_READ = "as read"
"""Row of the heading without calibration in a table of calibrators."""
WORSE_THAN_NONE = "worse than as read"
"""Mark of a calibration with a larger worst heading error than no calibration."""
FROM_FLASH = "cycles.{}.from_flash"
WITHOUT_WAITS, WITH_WAITS = "cycles without memory waits (ranked)", "cycles as it runs from flash"
"""Headings of both columns of cycles if something was counted with the waits of memories."""


@dataclass(frozen=True, slots=True)
class CalibratorResult:
    """Accuracy and cost of one calibrator; `from_flash` are its cycles with the waits of memories."""

    name: str
    maximum: Measurement
    centred: Measurement | None
    cycles: Measurement | None
    from_flash: Measurement | None


def calibrator_results(measurements: Sequence[Measurement]) -> tuple[CalibratorResult, ...]:
    """Return accuracy and cost of each calibrator with a measured heading, cheapest first.

    Parameters
    ----------
    measurements
        Measurements of one run.

    Returns
    -------
    tuple of CalibratorResult
        All calibrators but ``uncalibrated``. Calibrators without a cycle count come last; ties are sorted by name.
    """
    by_name = {measurement.name: measurement for measurement in measurements}
    names = [
        measurement.subject
        for measurement in measurements
        if measurement.kind is WORST_HEADING and not has_no_number(measurement)
    ]
    results = [_calibrator_result(name, by_name) for name in names if name != UNCALIBRATED]
    order = cheapest_first({result.name: result.cycles for result in results})
    return tuple(sorted(results, key=lambda result: order.index(result.name)))


def heading_as_read(measurements: Sequence[Measurement]) -> Measurement | None:
    """Return the worst heading error without calibration; None if it has no number."""
    name = f"heading.{UNCALIBRATED}.max"
    return next((measurement for measurement in measurements if measurement.name == name and measurement.value), None)


def is_worse_than_none(maximum: Measurement | None, as_read: Measurement | None) -> bool:
    """Return whether a worst heading error is larger than the one without calibration."""
    calibrated_deg, as_read_deg = value_of(maximum), value_of(as_read)
    return calibrated_deg is not None and as_read_deg is not None and calibrated_deg > as_read_deg


def cheapest_first(costs: Mapping[str, Measurement | None]) -> list[str]:
    """Return names by their cycle counts; names without one come last.

    Names whose counts cannot be ranked against the cheapest of a group belong to that group and are sorted by name; the
    next name begins another group. A chain of close costs is no tie, since its ends can be ranked.
    """
    by_cost = sorted(costs, key=lambda name: (value_of(costs[name]) or float("inf"), name))
    groups: list[list[str]] = []
    for name in by_cost:
        if groups and cannot_be_ranked(costs[groups[-1][0]], costs[name]):
            groups[-1].append(name)
        else:
            groups.append([name])
    return [name for group in groups for name in sorted(group)]


def _calibrator_result(name: str, by_name: dict[str, Measurement]) -> CalibratorResult:
    return CalibratorResult(
        name,
        by_name[f"heading.{name}.max"],
        centred=by_name.get(f"heading.{name}.max_centred"),
        cycles=by_name.get(f"cycles.{name}.total"),
        from_flash=by_name.get(FROM_FLASH.format(name)),
    )


def fit_status(name: str, by_name: Mapping[str, Measurement]) -> FitStatus:
    """Return the status of a calibrator's fit."""
    return FitStatus(int(value_of(by_name.get(f"fit.{name}.status")) or FitStatus.ELLIPSOID))


def has_no_number(measurement: Measurement) -> bool:
    """Return whether a limit was not evaluated because the number is missing, rather than a reference."""
    return measurement.outcome is Outcome.UNSET and measurement.value is None


def value_of(measurement: Measurement | None) -> float | None:
    """Return the number of a measurement; None if either is missing."""
    return None if measurement is None or measurement.value is None else float(measurement.value)


def maximum_of(measurement: Measurement | None) -> float | None:
    """Return the upper side of a measurement's limit; None without one."""
    return None if measurement is None or measurement.limit is None else measurement.limit.max


STAGES_TABLE = "stream.stages"


@dataclass(frozen=True, slots=True)
class CalibratorCost:
    """Cycles of one calibrator."""

    name: str
    cycles: float | None
    """Cycles of a calibration from all its points; for a streaming calibrator, of all its points and the fit."""
    points: int | None = None
    """Number of points that a streaming calibrator received; None for one that takes all at once."""

    @property
    def is_streaming(self) -> bool:
        """True for a streaming calibrator, which receives its points one by one."""
        return self.points is not None


def calibrator_costs(run: Run) -> list[CalibratorCost]:
    """Return the cost of each calibrator whose heading was measured: cheapest first, streaming calibrators last."""
    points = _points_received(run)
    cycles = {
        result.name: _stream_cycles(run, result.name, points[result.name]) if result.name in points else result.cycles
        for result in calibrator_results(run.measurements)
    }
    costs = [CalibratorCost(name, value_of(cycles[name]), points.get(name)) for name in cheapest_first(cycles)]
    return sorted(costs, key=lambda cost: cost.is_streaming)


def _points_received(run: Run) -> dict[str, int]:
    """Return how many points each streaming calibrator had received at its last stage."""
    table = run.table(STAGES_TABLE)
    if table is None:
        return {}
    stages = zip(table.column_if_any("calibrator"), table.column_if_any("points"), strict=True)
    return {str(name): int(points) for name, points in stages if isinstance(points, int | float)}


def _stream_cycles(run: Run, name: str, points: int) -> Measurement | None:
    """Return the cycles of all points and of the final fit; the mean is over the same points."""
    mean, fit = (run.measurement(f"stream.{name}.{quantity}") for quantity in ("cycles_mean", "fit_cycles"))
    if mean is None or fit is None or mean.value is None or fit.value is None:
        return None
    return replace(mean, value=float(mean.value) * points + float(fit.value))
