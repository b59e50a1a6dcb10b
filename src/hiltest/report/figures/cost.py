"""Accuracy against cost: where each calibrator stands, in one picture."""

from __future__ import annotations

import math

from hiltest.measurement import Measurement
from hiltest.record.run import Run
from hiltest.report.figures.columns import upper_limit
from hiltest.report.marks import KeyEntry, series
from hiltest.report.svg import Figure
from hiltest.text import readable
from hiltest.verdict.calibrators import CalibratorCost, calibrator_costs

_FEWEST = 2  # one dot is no comparison


def cost_figure(run: Run) -> Figure | None:
    """Draw the worst heading over the cycles of each calibrator, None when there are not two to compare."""
    rated = [(each, error) for each in calibrator_costs(run) if each.cycles and (error := _worst(run, each))]
    if len(rated) < _FEWEST:
        return None
    cycles = [each.cycles / 1000.0 for each, _ in rated if each.cycles]
    limits = [upper_limit(_maximum(run, each)) for each, _ in rated]
    top = 1.15 * max(*(error for _, error in rated), *(limit for limit in limits if limit is not None), 0.1)
    figure = Figure(
        title="Worst heading error over cycles",
        description="; ".join(
            f"{each.name}: {error:.2f} degrees for {readable(each.cycles or 0)} cycles" for each, error in rated
        ),
        x_label="thousand cycles", y_label="worst heading error [deg]", x_range=(min(cycles) / 1.5, max(cycles) * 1.5),
        y_range=(0.0, top), log_x=True,
    )
    for index, ((each, error), x, limit) in enumerate(zip(rated, cycles, limits, strict=True)):
        style, mark = series(index)
        if limit is not None:
            figure.line([(x / 1.15, limit), (x * 1.15, limit)], "limit")
        figure.marks([(x, error)], f"{style} filled", mark, radius=5.0)
        figure.key.append(KeyEntry(each.name, "", mark, f"{style} filled"))
    if any(limit is not None for limit in limits):
        figure.key.append(KeyEntry("limit", "limit"))
    return figure


def _maximum(run: Run, each: CalibratorCost) -> Measurement | None:
    return run.measurement(f"heading.{each.name}.max")


def _worst(run: Run, each: CalibratorCost) -> float | None:
    maximum = _maximum(run, each)
    value = None if maximum is None else maximum.value
    return float(value) if value is not None and math.isfinite(value) else None
