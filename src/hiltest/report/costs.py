"""What each calibrator costs: one that takes all points at once, or one that lives with the stream."""

from __future__ import annotations

from dataclasses import dataclass, replace

from hiltest.measurement import Measurement
from hiltest.report.calibrator_results import calibrator_results, cheapest_first, value_of
from hiltest.report.record import Run

STAGES_TABLE = "stream.stages"


@dataclass(frozen=True, slots=True)
class CalibratorCost:
    """Cycles of one calibrator.

    Attributes
    ----------
    name : str
    cycles : float or None
        Of a calibration from all its points: of one that lives with the stream, all its points and the fit.
    points : int or None
        That a stream calibrator was given; None for one that takes all at once.
    """

    name: str
    cycles: float | None
    points: int | None = None

    @property
    def lives_with_the_stream(self) -> bool:
        """Whether it was given its points one by one."""
        return self.points is not None


def calibrator_costs(run: Run) -> list[CalibratorCost]:
    """Return the cost of each calibrator whose heading was measured, cheapest first, streams after the others."""
    given = _points_given(run)
    counted = {
        each.name: _stream_cycles(run, each.name, given[each.name]) if each.name in given else each.cycles
        for each in calibrator_results(run.measurements)
    }
    costs = [CalibratorCost(name, value_of(counted[name]), given.get(name)) for name in cheapest_first(counted)]
    return sorted(costs, key=lambda each: each.lives_with_the_stream)


def _points_given(run: Run) -> dict[str, int]:
    """Return how many points each stream calibrator had seen at its last stage."""
    table = run.table(STAGES_TABLE)
    if table is None:
        return {}
    stages = zip(table.column_if_any("calibrator"), table.column_if_any("points"), strict=True)
    return {str(name): int(points) for name, points in stages if isinstance(points, int | float)}


def _stream_cycles(run: Run, name: str, points: int) -> Measurement | None:
    """Return the cycles of all points and of the fit at the end: the mean is over the same points."""
    mean, fit = (run.measurement(f"stream.{name}.{what}") for what in ("cycles_mean", "fit_cycles"))
    if mean is None or fit is None or mean.value is None or fit.value is None:
        return None
    return replace(mean, value=float(mean.value) * points + float(fit.value))
