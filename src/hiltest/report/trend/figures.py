"""A small plot for each measurement over the runs of a folder."""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping, Sequence
from itertools import groupby

from hiltest.measurement import Limit
from hiltest.report.marks import KeyEntry, Mark, series
from hiltest.report.svg import Figure, Point, Sheet, nice_ticks
from hiltest.report.trend.series import MeasurementTrend, Series
from hiltest.report.trend.series import Point as At
from hiltest.run_record.comparison import Change
from hiltest.text import format_number

_HEIGHT = 170.0
_NAMED = 2  # change points whose run is named in the plot, the newest ones
_FEW = 60  # largest number of points whose marks can be distinguished
_STEPS = {
    Change.BETTER: ("better", Mark.PLUS),
    Change.WORSE: ("worse", Mark.CROSS),
    Change.CHANGED: ("moved", Mark.DIAMOND),
}
_MARGIN = 0.08  # of the range, above and below
# The axis writes six digits: in a smaller range every tick would have the same number.
_LEAST_RANGE = 2e-3
# A limit farther from zero than this multiple of the values, or from changed values than this multiple of their
# change, would flatten the plot; the caption names it instead.
_NEAR = 2.5


def figure(measured: MeasurementTrend, names: Sequence[str], *, more: str = "", width: float = 340.0) -> Figure:
    """Draw a measurement over entries that are numbered from 1, with one line per set of conditions.

    Parameters
    ----------
    names
        Names of all entries.
    more
        Text of the caption after name and unit.
    width
        Width of the drawing.
    """
    scale, unit = _scale(measured)
    drawn = Figure(
        title=f"{measured.name}{unit and f' [{unit}]'}{more}",
        description=_plot_description(measured),
        x_label="",
        y_label="",
        x_range=(0.5, len(names) + 0.5),
        y_range=_y_range(measured, scale),
        x_ticks=_run_ticks(len(names)),
        width=width,
        height=_HEIGHT,
    )
    rows = {point: row for row, point in enumerate(_points(measured))}
    for line_series in measured.series:
        _draw(drawn, line_series, scale, rows, names)
    for step in measured.change_points[-_NAMED:]:
        grows = (step.difference.new or 0.0) > (step.difference.base or 0.0)
        drawn.upright(step.after + 1.0, names[step.after].rpartition(", ")[2], "thesis", right=True, low=grows)
    for change, (style, mark) in _STEPS.items():
        at = [
            (step.after + 1.0, point.value / scale)
            for line_series in measured.series
            for step in line_series.change_points
            for point in line_series.points
            if point.entry == step.after and step.difference.change is change
        ]
        drawn.marks(at, f"step {style}", mark, radius=6.0)
    drawn.sheet = _sheet(measured, names)
    return drawn


def _sheet(measured: MeasurementTrend, names: Sequence[str]) -> Sheet:
    """Return the value of each run; for several seeds also the lowest and the highest."""
    points = _points(measured)
    spread = ("lowest", "highest") if any(point.low < point.high for point in points) else ()
    numbers = [(point.value, point.low, point.high)[: 1 + len(spread)] for point in points]
    return Sheet(
        measured.name,
        ("run", measured.unit or "value", *spread),
        [[names[point.entry], *map(format_number, values)] for point, values in zip(points, numbers, strict=True)],
    )


def _points(measured: MeasurementTrend) -> list[At]:
    """Return the points in the order of the runs, which is that of the rows of the sheet."""
    points = (point for line_series in measured.series for point in line_series.points)
    return sorted(points, key=lambda point: point.entry)


def change_point_key() -> list[KeyEntry]:
    """Return the key of the marks of change points."""
    return [
        KeyEntry(f"change point: {change}", mark=mark, mark_style=f"step {style}")
        for change, (style, mark) in _STEPS.items()
    ]


def _draw(drawn: Figure, measured: Series, scale: float, rows: Mapping[At, int], names: Sequence[str]) -> None:
    for side in ("min", "max"):
        for limit_line in _limit_lines(measured.points, side, scale, drawn.y_range):
            drawn.line(limit_line, "limit")
    style, mark = series(measured.line)
    low, high = drawn.y_range
    if not any(low <= point.value / scale <= high for point in measured.points):
        return
    for point in measured.points:
        if point.low < point.high:
            drawn.line([(point.entry + 1.0, side / scale) for side in (point.low, point.high)], f"{style} spread")
    points = [(point.entry + 1.0, point.value / scale) for point in measured.points]
    drawn.line(_drop_level_points(points), style)
    if len(points) <= _FEW:
        words = [(rows[point], f"{names[point.entry]}: {format_number(point.value)}") for point in measured.points]
        drawn.marks(points, f"{style} filled", mark, radius=2.5, rows=words)


def _limit_lines(points: Sequence[At], side: str, scale: float, y_range: tuple[float, float]) -> Iterator[list[Point]]:
    """Yield a level line for each stretch of runs with the same limit, if it lies within the plot."""
    for value, stretch in groupby(points, key=lambda point: point.limit and getattr(point.limit, side)):
        if value is not None and y_range[0] <= value / scale <= y_range[1]:
            entries = [point.entry for point in stretch]
            yield [(entries[0] + 0.5, value / scale), (entries[-1] + 1.5, value / scale)]


def _drop_level_points(points: Sequence[Point]) -> list[Point]:
    """Omit points on a level line between their neighbours, since exact numbers hardly ever move."""
    inner = zip(points, points[1:], points[2:], strict=False)
    corners = [point for before, point, after in inner if not before[1] == point[1] == after[1]]
    return [points[0], *corners, points[-1]]


def _y_range(measured: MeasurementTrend, scale: float) -> tuple[float, float]:
    # With a change point the axis is that of the changed values: those of other conditions would flatten the change.
    changed = [line_series for line_series in measured.series if line_series.change_points]
    points = [point for line_series in changed or measured.series for point in line_series.points]
    low, high = min(point.low for point in points), max(point.high for point in points)
    furthest = max(abs(low), abs(high))
    around = (_NEAR * (high - low), low, high) if changed else (_NEAR * furthest, 0.0)
    sides = [side for point in points for side in _sides(point.limit) if _distance(side, *around[1:]) <= around[0]]
    low, high = min([low, *sides]), max([high, *sides])
    least = max(_LEAST_RANGE * furthest, 1e-12) or 1.0
    if furthest == 0.0 and not sides:
        least = 1.0
    pad = max(_MARGIN * (high - low), (least - (high - low)) / 2.0)
    return (low - pad) / scale, (high + pad) / scale


def _distance(side: float, *ends: float) -> float:
    return min(abs(side - end) for end in ends)


def _sides(limit: Limit | None) -> list[float]:
    return [] if limit is None else [side for side in (limit.min, limit.max) if side is not None]


def _scale(measured: MeasurementTrend) -> tuple[float, str]:
    """Return a divisor that makes the values' digits fit beside the axis, and the unit with it."""
    points = [point for line_series in measured.series for point in line_series.points]
    largest = max(abs(value) for point in points for value in (point.low, point.high))
    power = 3 * max(0, math.floor(math.log10(largest) / 3.0)) if largest >= 1e5 else 0
    return 10.0**power, f"1e{power} {measured.unit}".strip() if power else measured.unit


def _run_ticks(entries: int) -> Sequence[float]:
    """Return whole numbers of runs."""
    if entries <= 6:
        return [float(number) for number in range(1, entries + 1)]
    return [tick for tick in nice_ticks(1.0, float(entries)) if tick == int(tick)]


def _plot_description(measured: MeasurementTrend) -> str:
    """Return a description of the plot, for readers who do not see it."""
    first = min((line_series.points[0] for line_series in measured.series), key=lambda point: point.entry)
    last = max((line_series.points[-1] for line_series in measured.series), key=lambda point: point.entry)
    words = (
        f"From {format_number(first.value)} in run {first.entry + 1} to "
        + f"{format_number(last.value)} {measured.unit}".rstrip()
        + f" in run {last.entry + 1}"
    )
    words += f", limit {measured.limit}" if measured.limit else ""
    if len(measured.series) > 1:
        words += f"; {len(measured.series)} conditions that are not comparable"
    steps = [f"run {step.after + 1} {step.difference.change}" for step in measured.change_points]
    return f"{words}. " + (f"Change points: {', '.join(steps)}." if steps else "No change point.")
