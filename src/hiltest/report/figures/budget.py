"""Heading error against cycle budget: the thesis' comparison of calibrators."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import TypeGuard

from hiltest.record.run import Run, Table
from hiltest.report.figures.columns import written
from hiltest.report.figures.group import FigureGroup, Sheet
from hiltest.report.marks import KeyEntry, series
from hiltest.report.svg import Figure, Point
from hiltest.text import readable

CURVE_TABLE = "budget.curve"
# As the thesis has them: what its own calibrator takes for N points, and the library's, one iteration a point.
_THESIS = (("thesis: 168 N + 2600", 168.0, 2600.0), ("thesis: 2860 N", 2860.0, 0.0))
_COLUMNS = {
    "calibrator": "calibrator", "points": "of points", "kind": "effort in", "effort": "effort", "cycles": "cycles",
    "fit": "fit", "mean_error": "mean error [deg]", "max_error": "worst error [deg]",
}


def budget_group(run: Run) -> FigureGroup | None:
    """Return the section, None when the run drew no curve."""
    table = run.table(CURVE_TABLE)
    figures = budget_figures(run)
    if table is None or not figures:
        return None
    return FigureGroup(
        "budget", "Error against cycle budget",
        "Each calibrator with more and more effort on the same points: a closed form with more of them, one that "
        "iterates with more sweeps, a stream calibrator with more points seen. Mean over the known angles. Hollow: "
        "there was no ellipsoid, only a sphere was fitted. Upright lines: the cycles that the thesis counts for its "
        "own calibrator and for the library's.",
        figures, numbers=_sheet(table), short="Budget",
    )


def budget_figures(run: Run) -> list[Figure]:
    """Draw the mean heading error over the cycles spent, one figure a number of points, on logarithmic axes."""
    table = run.table(CURVE_TABLE)
    if table is None:
        return []
    figures: dict[float, dict[str, _Curve]] = {}
    columns = [table.column_if_any(name) for name in ("points", "calibrator", "cycles", "mean_error", "sphere")]
    for points, calibrator, cycles, error, is_sphere in zip(*columns, strict=True):
        if _is_positive(points) and _is_positive(cycles):
            curve = figures.setdefault(points, {}).setdefault(str(calibrator), _Curve())
            curve.cycles = cycles
            if _is_positive(error):
                curve.points.append((cycles / 1000.0, error))
                (curve.spheres if is_sphere else curve.ellipsoids).append(curve.points[-1])
    return [_figure(points, curves) for points, curves in sorted(figures.items()) if _any_point(curves)]


@dataclass(slots=True)
class _Curve:
    """Thousand cycles and error of each effort that left a calibration, and the cycles of the largest effort."""

    points: list[Point] = field(default_factory=list)
    spheres: list[Point] = field(default_factory=list)
    ellipsoids: list[Point] = field(default_factory=list)
    cycles: float = 0.0

    def in_words(self, name: str) -> str:
        """Return where it ends, or what was spent on no calibration."""
        if not self.points:
            return f"{name} has no calibration after {readable(self.cycles)} cycles"
        thousands, error = self.points[-1]
        return f"{name} ends at {error:.2f} degrees for {readable(1000.0 * thousands)} cycles"


def _any_point(curves: Mapping[str, _Curve]) -> bool:
    return any(curve.points for curve in curves.values())


def _figure(points: float, curves: Mapping[str, _Curve]) -> Figure:
    thesis = [(words, slope * points + fixed) for words, slope, fixed in _THESIS]
    xs = [x for curve in curves.values() for x, _ in curve.points] + [cycles / 1000.0 for _, cycles in thesis]
    ys = [y for curve in curves.values() for _, y in curve.points]
    figure = Figure(
        title=f"{points:g} points", description="; ".join(curve.in_words(name) for name, curve in curves.items()),
        x_label="thousand cycles", y_label="mean error [deg]", x_range=_around(xs), y_range=_around(ys), height=300.0,
        log_x=True, log_y=True,
    )
    for words, cycles in thesis:
        figure.upright(cycles / 1000.0, f"{words} = {readable(cycles)}", "thesis")
    for index, (name, curve) in enumerate(curves.items()):
        style, mark = series(index)
        if curve.points:
            figure.line(curve.points, style)
            figure.marks(curve.spheres, f"{style} hollow", mark)
            figure.marks(curve.ellipsoids, f"{style} filled", mark, radius=3.0)
        # One that has no calibration yet is not left out: that is what it made of the points.
        words = name if curve.points else f"{name}: none yet"
        figure.key.append(KeyEntry(words, style, mark, f"{style} filled"))
    return figure


def _sheet(table: Table) -> Sheet:
    columns = [written(table.column_if_any(name)) for name in _COLUMNS]
    return Sheet("Every effort", list(_COLUMNS.values()), list(zip(*columns, strict=True)))


def _around(values: Sequence[float]) -> Point:
    return min(values) / 1.3, max(values) * 1.3


def _is_positive(value: object) -> TypeGuard[float]:
    return isinstance(value, int | float) and math.isfinite(value) and value > 0.0
