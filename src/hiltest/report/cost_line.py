"""What each calibrator costs, in one line: the rig's budget, and each count with its accuracy, range and ratio."""

from __future__ import annotations

from hiltest.measurement import Measurement
from hiltest.record.run import Run
from hiltest.text import number, readable
from hiltest.verdict.calibrators import CalibratorResult, calibrator_results
from hiltest.verdict.summary import cost_reference, ratio_in_words

_MOST_POINTS = 10_000
_OF_THE_THESIS = (168.0, 2600.0)
"""What the thesis says that its own calibrator takes: cycles per point, and fixed."""


def cost_line(run: Run) -> str:
    """Return what the board's calibrators cost at the same points; empty where none was counted.

    A cost never stands without the worst heading that was reached for it. The budget is the one that the rig shows
    beside the per-point and the fixed cost of its reference, at as many points.
    """
    offered = run.board.calibrators if run.board else ()
    results = [each for each in calibrator_results(run.measurements) if each.name in offered]
    counted = [each for each in results if each.cycles is not None and each.cycles.value]
    if not counted:
        return ""
    reference = cost_reference(run, counted)
    parts = [_budget(run, reference.name) if reference else "", *(_cost(each, reference) for each in counted)]
    models = sorted({each.cycles.cycle_model for each in counted if each.cycles})
    return "; ".join(filter(None, (*parts, f"counted by {' and '.join(models)}"))) + "."


def _budget(run: Run, name: str) -> str:
    total, per_point, fixed = (run.measurement(f"cycles.{name}.{each}") for each in ("total", "per_point", "fixed"))
    slope, rest = (_most(each) for each in (per_point, fixed))
    if not (total and per_point and fixed and total.value and per_point.value and fixed.value and slope and rest):
        return ""
    points = (total.value - fixed.value) / per_point.value  # what the line was fitted to has no name of its own
    if not 1.0 <= points <= _MOST_POINTS:
        return ""
    budget = "Thesis budget" if (slope, rest) == _OF_THE_THESIS else "Budget"
    return f"{budget} for {round(points)} points {readable(round(points) * slope + rest)} cycles"


def _most(measurement: Measurement | None) -> float | None:
    return measurement.information.max if measurement and measurement.information else None


def _cost(result: CalibratorResult, reference: CalibratorResult | None) -> str:
    cycles, maximum = result.cycles, result.maximum
    band = f" ({cycles.band})" if cycles and cycles.band else ""
    worst = "no heading" if maximum.value is None else f"{number(maximum.value, maximum.unit)} {maximum.unit}"
    ratio = ratio_in_words(result, reference) if reference else ""
    cost = f"{result.name} {readable(cycles.value if cycles else None)}{band} for {worst}"
    return ", ".join(filter(None, (cost, ratio)))
