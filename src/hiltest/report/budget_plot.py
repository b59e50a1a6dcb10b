"""Heading error against cycle budget: the thesis' comparison of calibrators, from a table of the record."""

from __future__ import annotations

import math
from collections.abc import Sequence

from hiltest.report.record import Run
from hiltest.report.svg import Figure, Point
from hiltest.report.verdict import grouped

CURVE_TABLE = "budget.curve"
# As the thesis has them: what its own calibrator takes for N points, and the library's, one iteration a point.
_THESIS = (("thesis: 168 N + 2600", 168.0, 2600.0), ("thesis: 2860 N", 2860.0, 0.0))
_STYLES = 4  # of lines, in the style sheet


def budget_figures(run: Run) -> list[Figure]:
    """Draw the mean heading error over the cycles spent, one figure a number of points, on logarithmic axes."""
    table = run.table(CURVE_TABLE)
    if table is None:
        return []
    curves: dict[float, dict[str, list[Point]]] = {}
    columns = (table.column(name) for name in ("points", "calibrator", "cycles", "mean_error"))
    for points, calibrator, cycles, error in zip(*columns, strict=True):
        if isinstance(points, int | float) and _positive(cycles) and _positive(error):
            curves.setdefault(points, {}).setdefault(str(calibrator), []).append((float(cycles), float(error)))
    return [_figure(points, named) for points, named in sorted(curves.items())]


def _figure(points: float, named: dict[str, list[Point]]) -> Figure:
    thesis = [(words, slope * points + fixed) for words, slope, fixed in _THESIS]
    xs = [x for curve in named.values() for x, _ in curve] + [cycles for _, cycles in thesis]
    ys = [y for curve in named.values() for _, y in curve]
    figure = Figure(
        title=f"{points:g} points: mean heading error over cycles", description=_words(named),
        x_label="cycles", y_label="mean error [deg]", x_range=_around(xs), y_range=_around(ys), height=320.0,
        headroom=16.0 * math.ceil(len(named) / 2), logarithmic=True,
    )
    for words, cycles in thesis:
        figure.upright(cycles, f"{words} = {grouped(cycles)}", "thesis")
    styles = {name: f"series-{index % _STYLES}" for index, name in enumerate(named)}
    for name, curve in named.items():
        figure.line(curve, styles[name])
        figure.rings(curve, styles[name], radius=2.5)
    figure.key(styles.items())
    return figure


def _words(named: dict[str, list[Point]]) -> str:
    ends = ((name, *curve[-1]) for name, curve in named.items())
    return "; ".join(f"{name} ends at {error:.2f} degrees for {grouped(cycles)} cycles" for name, cycles, error in ends)


def _around(values: Sequence[float]) -> Point:
    return min(values) / 1.3, max(values) * 1.3


def _positive(value: object) -> bool:
    return isinstance(value, int | float) and math.isfinite(value) and value > 0.0
