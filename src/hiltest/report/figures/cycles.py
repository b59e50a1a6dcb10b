"""Cycles against the number of points, with the straight line through them."""

from __future__ import annotations

import math
from collections.abc import Sequence

from hiltest.record.run import Run
from hiltest.report.figures.columns import numbers, written
from hiltest.report.figures.group import FigureGroup, Sheet
from hiltest.report.marks import KeyEntry, Mark
from hiltest.report.svg import Figure
from hiltest.text import readable

SIZES_TABLE = "cycles.sizes"
_KEY = (KeyEntry("counted on the board", "", Mark.DOT, "level filled"), KeyEntry("least squares", "level"))


def cycle_group(run: Run) -> FigureGroup | None:
    """Return the section, None when no size was counted."""
    table = run.table(SIZES_TABLE)
    if table is None or not table.rows:
        return None
    names = [column.name for column in table.columns if column.name != "n"]
    sizes = numbers(table, "n")
    figures = [_figure(run, name, sizes, numbers(table, name)) for name in names]
    counted_by = f" Counted by {run.board.cycle_model}." if run.board else ""
    return FigureGroup(
        "cycles", "Cycles against points",
        f"What one calibration costs for more and more points, interrupts masked.{counted_by}",
        [figure for figure in figures if figure], key=_KEY, small=True, short="Cycles",
        numbers=Sheet("Cycles of one calibration", ["points", *names], [written(row) for row in table.rows]),
    )


def _figure(run: Run, name: str, sizes: Sequence[float], cycles: Sequence[float]) -> Figure | None:
    points = [(n, count) for n, count in zip(sizes, cycles, strict=True) if math.isfinite(n) and math.isfinite(count)]
    if not points:
        return None
    per_point, fixed = (_value(run, f"cycles.{name}.{what}") for what in ("per_point", "fixed"))
    sweeps, per_sweep = (_value(run, f"cycles.{name}.{what}") for what in ("sweeps", "per_iteration"))
    right, top = 1.05 * max(n for n, _ in points), 1.1 * max(count for _, count in points)
    line = "" if per_point is None or fixed is None else f"{per_point:.1f} n + {readable(fixed)}"
    if line and sweeps and per_sweep:
        line += f" + {sweeps:.0f} sweeps of {readable(per_sweep)}"
        fixed = (fixed or 0.0) + sweeps * per_sweep
    figure = Figure(
        title="; ".join(filter(None, (f"{name}: {line or 'cycles'}", _accuracy(run, name)))),
        description=f"{len(points)} sizes, from {readable(points[0][1])} cycles for {points[0][0]:g} points to "
        f"{readable(points[-1][1])} for {points[-1][0]:g}",
        x_label="points n", y_label="thousand cycles", x_range=(0, max(right, 1.0)), y_range=(0, max(top, 1.0) / 1000),
        width=312.0, height=240.0,
    )
    if per_point is not None and fixed is not None:
        figure.line([(0, fixed / 1000), (right, (fixed + per_point * right) / 1000)], "level")
    figure.marks([(n, count / 1000) for n, count in points], "level filled")
    return figure


def _accuracy(run: Run, name: str) -> str:
    """Return what a calibrator's cycles buy: its worst heading, else how far its fit is from float64's."""
    worst, distance = _value(run, f"heading.{name}.max"), _value(run, f"cycles.{name}.float64_distance")
    if worst is not None:
        return f"worst heading {worst:.2f} deg"
    return "" if distance is None else f"{distance:.2g} deg from float64 on an even cloud"


def _value(run: Run, name: str) -> float | None:
    measurement = run.measurement(name)
    return None if measurement is None or measurement.value is None else float(measurement.value)
