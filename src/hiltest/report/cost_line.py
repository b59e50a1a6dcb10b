"""The cost of the calibrators in one line: thesis budget, counts with bands and what they reach, and the ratio."""

from __future__ import annotations

from hiltest.measurement import FLASH_TIE, Measurement, cannot_be_ranked, ratio_band
from hiltest.record.run import Run
from hiltest.text import readable
from hiltest.verdict.calibrators import CalibratorResult, calibrator_results

_OLD = "iterative"
"""What the others are compared with: the calibrator that was there before."""
_OURS = "direct"
_MOST_POINTS = 10_000
_OF_THE_THESIS = (168.0, 2600.0)
"""What the thesis says that its own calibrator takes: cycles per point, and fixed."""


def cost_line(run: Run) -> str:
    """Return what ours and the old calibrator cost at the same points, empty where one of them was not measured.

    A cost never stands without the worst heading that was reached for it. The budget is the one that the rig shows
    beside the per-point and the fixed cost, at as many points.
    """
    found = [each for each in calibrator_results(run.measurements) if each.cycles and each.cycles.value]
    old = next((each for each in found if each.name == _OLD), None)
    ours = [each for each in found if each.name == _OURS or each.name.startswith(f"{_OURS}-")]
    if old is None or not ours:
        return ""
    parts = [_budget(run), *map(_cost, (*ours, old)), *(_ratio(old, each) for each in ours)]
    models = sorted({each.cycles.cycle_model for each in (*ours, old) if each.cycles})
    return "; ".join(filter(None, (*parts, f"counted by {' and '.join(models)}"))) + "."


def _budget(run: Run) -> str:
    total, per_point, fixed = (run.measurement(f"cycles.{_OURS}.{each}") for each in ("total", "per_point", "fixed"))
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


def _cost(result: CalibratorResult) -> str:
    cycles, worst = result.cycles, result.maximum.value
    assert cycles is not None
    assert cycles.value is not None
    band = f" ({cycles.band})" if cycles.band else ""
    return f"{result.name} {readable(cycles.value)}{band} for {'no heading' if worst is None else f'{worst:.2f} deg'}"


def _ratio(old: CalibratorResult, ours: CalibratorResult) -> str:
    assert old.cycles is not None
    assert ours.cycles is not None
    if not old.cycles.value or not ours.cycles.value:
        return ""
    if cannot_be_ranked(old.cycles, ours.cycles):
        return f"{old.name} and {ours.name} are within {FLASH_TIE:.0%} and from flash, which ranks neither"
    band = ratio_band(old.cycles, ours.cycles)
    shown = f" ({band[0]:.2f} to {band[1]:.2f})" if band else ""
    return f"{old.name} costs {old.cycles.value / ours.cycles.value:.2f} times {ours.name}{shown}"
