"""Heading error over time while a board was moved: the filter and its two halves, from a table of the record."""

from __future__ import annotations

import math
from typing import TypeGuard

from hiltest.report.record import Run, Table
from hiltest.report.svg import Figure, Point

MOTION_TABLE = "fusion.motion"
# Of what was found, in the order in which it is drawn: the noisiest first, so that the others lie on it.
_LINES = (
    ("accelerometer_magnetometer", "without gyroscope", "series-2"),
    ("gyroscope", "gyroscope alone", "series-1"),
    ("fused", "fused", "series-0"),
)


def fusion_figures(run: Run) -> list[Figure]:
    """Draw the heading errors of a motion; nothing when the run has none."""
    table = run.table(MOTION_TABLE)
    lines = {} if table is None else {name: _points(table, name) for name, _, _ in _LINES}
    if not any(lines.values()):
        return []
    ends_s = max(time_s for points in lines.values() for time_s, _ in points)
    largest = max(abs(error) for points in lines.values() for _, error in points)
    figure = Figure(
        title="Heading error during a motion",
        description="; ".join(f"{words}: at most {_largest(lines[name]):.2f} degrees" for name, words, _ in _LINES),
        x_label="time [s]", y_label="error [deg]", x_range=(0.0, ends_s), y_range=(-1.05 * largest, 1.05 * largest),
        headroom=16.0 * math.ceil(len(_LINES) / 2),
    )
    for name, _, style in _LINES:
        if lines[name]:
            figure.line(lines[name], style)
    figure.key((words, style) for _, words, style in _LINES)
    return [figure]


def _points(table: Table, name: str) -> list[Point]:
    """Return time and error of every record that has one."""
    pairs = zip(table.column("time"), table.column_if_any(name), strict=True)
    return [(time_s, error) for time_s, error in pairs if _is_number(time_s) and _is_number(error)]


def _is_number(cell: object) -> TypeGuard[float]:
    return isinstance(cell, int | float) and math.isfinite(cell)


def _largest(points: list[Point]) -> float:
    return max((abs(error) for _, error in points), default=math.nan)
