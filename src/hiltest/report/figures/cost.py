"""Figures of accuracy and cost: worst heading over cycles, cycles over points, and error against the cycle budget."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import TypeGuard

from hiltest.report.figures.section import FigureGroup, numbers, panel_width, upper_limit, written
from hiltest.report.marks import KeyEntry, Mark, series
from hiltest.report.svg import Figure, Point, Sheet
from hiltest.run_record.run import Run, Table
from hiltest.text import format_number
from hiltest.verdict.calibrators import calibrator_costs

SIZES_TABLE, CURVE_TABLE = "cycles.sizes", "budget.curve"
_FEWEST = 2  # one dot is no comparison
_FAR = 5.0  # times the largest error: a limit farther away is not drawn, since all points would lie on one line
_WIDTH = panel_width(2, 2)
# Cycles for N points according to the thesis: its own calibrator, and the library's with one iteration per point.
_THESIS = (("thesis: 168 N + 2600", 168.0, 2600.0), ("thesis: 2860 N", 2860.0, 0.0))
_CURVE_COLUMNS = {
    "calibrator": "calibrator",
    "points": "points",
    "kind": "unit of effort",
    "effort": "effort",
    "cycles": "cycles",
    "fit": "fit",
    "mean_error": "mean error [deg]",
    "max_error": "worst error [deg]",
}


def cost_group(run: Run) -> FigureGroup | None:
    """Return the figures on accuracy and cost; None if no cost can be drawn."""
    table = run.table(SIZES_TABLE)
    drawn = [figure for figure in (_accuracy_figure(run), table and _sizes_figure(run, table)) if figure]
    sheets = [figure.sheet for figure in drawn[:1] if figure.sheet]
    if table and table.rows:
        headings = ["points", *(column.name for column in table.columns[1:])]
        sheets.append(Sheet("Cycles of one calibration", headings, [written(row) for row in table.rows]))
    return FigureGroup("cost", "Accuracy and cost", "", drawn, numbers=sheets) if drawn else None


def _accuracy_figure(run: Run) -> Figure | None:
    """Draw the worst heading over the cycles of each calibrator; None for fewer than two."""
    maxima = {cost: run.measurement(f"heading.{cost.name}.max") for cost in calibrator_costs(run)}
    rated = [
        (cost, cost.cycles / 1000.0, float(measurement.value), upper_limit(measurement))
        for cost, measurement in maxima.items()
        if cost.cycles and measurement and measurement.value and math.isfinite(measurement.value)
    ]
    if len(rated) < _FEWEST:
        return None
    far = _FAR * max(error for _, _, error, _ in rated)
    rated = [(cost, x, error, limit if limit and limit <= far else None) for cost, x, error, limit in rated]
    xs = [x for _, x, _, _ in rated]
    top = 1.15 * max(0.1, *(side for _, _, error, limit in rated for side in (error, limit or 0.0)))
    figure = Figure(
        title="Worst heading error over cycles",
        description="; ".join(
            f"{cost.name}: {error:.2f} degrees for {format_number(cost.cycles or 0)} cycles"
            for cost, _, error, _ in rated
        ),
        x_label="thousand cycles",
        y_label="worst heading error [deg]",
        x_range=(min(xs) / 1.5, max(xs) * 1.5),
        y_range=(0.0, top),
        log_x=True,
        width=_WIDTH,
    )
    for cost, x, error, limit in rated:
        style, mark = _series(run, cost.name)
        if limit is not None:
            figure.line([(x / 1.15, limit), (x * 1.15, limit)], "limit")
        figure.series(cost.name, [(x, error)], mark=mark, mark_style=f"{style} filled", radius=5.0)
    if any(limit is not None for *_, limit in rated):
        figure.key.append(KeyEntry("limit", "limit"))
    return figure


def _sizes_figure(run: Run, table: Table) -> Figure | None:
    """Draw the cycles of one calibration over its points."""
    sizes = numbers(table, "n")
    curves = {
        column.name: [
            (n, count / 1000.0)
            for n, count in zip(sizes, numbers(table, column.name), strict=True)
            if _is_positive(n) and _is_positive(count)
        ]
        for column in table.columns
        if column.name != "n"
    }
    curves = {name: points for name, points in curves.items() if points}
    points = [point for curve in curves.values() for point in curve]
    if not points:
        return None
    figure = Figure(
        title="Cycles of one calibration over its points",
        description="; ".join(
            f"{name}: {format_number(1000.0 * points[0][1])} cycles for {points[0][0]:g} points to "
            f"{format_number(1000.0 * points[-1][1])} for {points[-1][0]:g}"
            for name, points in curves.items()
        ),
        x_label="points n",
        y_label="thousand cycles",
        x_range=(0.0, 1.05 * max(n for n, _ in points)),
        y_range=_axis_range([y for _, y in points]),
        log_y=True,
        width=_WIDTH,
    )
    for name, points in curves.items():
        style, mark = _series(run, name)
        figure.line(points, style)
        figure.series(_law(run, name), points, mark=mark, mark_style=f"{style} filled")
    return figure


def _law(run: Run, name: str) -> str:
    """Return the straight line through the cycles of a calibrator, with its accuracy."""
    per_point, fixed, sweeps, sweep = (
        _value(run, f"cycles.{name}.{quantity}") for quantity in ("per_point", "fixed", "sweeps", "per_iteration")
    )
    line = "" if per_point is None or fixed is None else f"{per_point:.1f} n + {format_number(fixed)}"
    line += f" + {sweeps:.0f} sweeps of {format_number(sweep)}" if line and sweeps and sweep else ""
    worst, distance = _value(run, f"heading.{name}.max"), _value(run, f"cycles.{name}.float64_distance")
    accuracy = "" if distance is None else f"{distance:.2g} deg from float64 on even samples"
    accuracy = accuracy if worst is None else f"worst heading {worst:.2f} deg"
    return "; ".join(filter(None, (f"{name}: {line or 'cycles'}", accuracy)))


def budget_group(run: Run) -> FigureGroup | None:
    """Return the section on error against the cycle budget; None if the run has no curve."""
    table = run.table(CURVE_TABLE)
    figures = budget_figures(run)
    if table is None or not figures:
        return None
    columns = [written(table.column_if_any(name)) for name in _CURVE_COLUMNS]
    return FigureGroup(
        "budget",
        "Error against cycle budget",
        "Each calibrator with increasing effort on the same points: closed forms use more points, iterative solvers "
        "more sweeps, streaming calibrators more received points. Errors are means over the known angles. Hollow marks "
        "are fits of a sphere, without an ellipsoid. Vertical lines are the thesis' cycles for its own calibrator and "
        "for the library's.",
        figures,
        short="Budget",
        numbers=[Sheet("Every effort", list(_CURVE_COLUMNS.values()), list(zip(*columns, strict=True)))],
    )


def budget_figures(run: Run) -> list[Figure]:
    """Draw the mean heading error over the cycles, one figure per number of points, on logarithmic axes."""
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
                curve.spheres += curve.points[-1:] if is_sphere else []
    drawn = {points: curves for points, curves in sorted(figures.items()) if any(c.points for c in curves.values())}
    points_drawn = [point for curves in drawn.values() for curve in curves.values() for point in curve.points]
    thesis = [cycles / 1000.0 for points in drawn for _, cycles in _thesis(points)]
    frame = (
        [_axis_range([*(x for x, _ in points_drawn), *thesis]), _axis_range([y for _, y in points_drawn])]
        if points_drawn
        else []
    )
    return [_budget_figure(run, points, curves, frame, panel_width(len(drawn), 3)) for points, curves in drawn.items()]


@dataclass(slots=True)
class _Curve:
    """Thousand cycles and error of each effort with a calibration, and the cycles of the largest effort.

    `spheres` are the points without an ellipsoid fit.
    """

    points: list[Point] = field(default_factory=list)
    spheres: list[Point] = field(default_factory=list)
    cycles: float = 0.0

    def describe_end(self, name: str) -> str:
        """Return the end of the curve in words, or the cycles that gave no calibration."""
        if not self.points:
            return f"{name} has no calibration after {format_number(self.cycles)} cycles"
        thousands, error = self.points[-1]
        return f"{name} ends at {error:.2f} degrees for {format_number(1000.0 * thousands)} cycles"


def _thesis(points: float) -> list[tuple[str, float]]:
    return [(words, slope * points + fixed) for words, slope, fixed in _THESIS]


def _budget_figure(
    run: Run, points: float, curves: Mapping[str, _Curve], frame: Sequence[Point], width: float
) -> Figure:
    figure = Figure(
        title=f"{points:g} points",
        description="; ".join(curve.describe_end(name) for name, curve in curves.items()),
        x_label="thousand cycles",
        y_label="mean error [deg]",
        x_range=frame[0],
        y_range=frame[1],
        width=width,
        height=300.0,
        log_x=True,
        log_y=True,
    )
    for words, cycles in _thesis(points):
        figure.upright(cycles / 1000.0, f"{words} = {format_number(cycles)}", "thesis")
    for name, curve in curves.items():
        style, mark = _series(run, name)
        # A calibrator without a calibration is shown as well, since that is a result.
        figure.series(name if curve.points else f"{name}: none yet", curve.points, style, mark, radius=2.5)
        figure.marks(curve.spheres, f"{style} hollow", mark, radius=3.0)
    return figure


def _series(run: Run, name: str) -> tuple[str, Mark]:
    """Return the style of a calibrator, the same in every figure."""
    costed = [calibrator_cost.name for calibrator_cost in calibrator_costs(run)]
    offered = run.board.calibrators if run.board else ()
    return series(list(dict.fromkeys([*costed, *offered, name])).index(name))


def _axis_range(values: Sequence[float]) -> Point:
    return min(values) / 1.3, max(values) * 1.3


def _is_positive(value: object) -> TypeGuard[float]:
    return isinstance(value, int | float) and math.isfinite(value) and value > 0.0


def _value(run: Run, name: str) -> float | None:
    measurement = run.measurement(name)
    return None if measurement is None or measurement.value is None else float(measurement.value)
