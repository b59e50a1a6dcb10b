"""Heading error over time while a board was moved: the filter and its two halves."""

from __future__ import annotations

import math

from hiltest.measurement import Section
from hiltest.report.figures.rows import limit_figure
from hiltest.report.figures.section import FigureGroup, numbers, panel_width, written
from hiltest.report.svg import Figure, Point, Sheet
from hiltest.run_record.run import Run, Table

MOTION_TABLE = "fusion.motion"
# Drawing order: the noisiest line first and thinnest, so that the others are visible on top of it.
_LINES = (
    ("accelerometer_magnetometer", "without gyroscope", "thin"),
    ("gyroscope", "gyroscope alone", "dashed"),
    ("fused", "fused", "thick"),
)


def fusion_group(run: Run) -> FigureGroup | None:
    """Return the section; None if the run has no motion."""
    figure, table = motion_figure(run), run.table(MOTION_TABLE)
    if figure is None or table is None:
        return None
    headings = [f"{column.name.replace('_', ' ')} [{column.unit}]" for column in table.columns]
    limits = limit_figure(run.measurements, Section.FUSION, "Share of each fusion limit")
    return FigureGroup(
        "fusion",
        "Fusion during a motion",
        "Heading minus true heading while the board was turned and tilted; all three started at the same attitude.",
        [drawn_figure for drawn_figure in (figure, limits) if drawn_figure],
        numbers=[Sheet("Heading, and the errors", headings, [written(row) for row in table.rows])],
        short="Fusion",
    )


def motion_figure(run: Run) -> Figure | None:
    """Draw the heading errors of a motion; None without one."""
    table = run.table(MOTION_TABLE)
    lines = {} if table is None else {name: _points(table, name) for name, _, _ in _LINES}
    if not any(lines.values()):
        return None
    ends_s = max(time_s for points in lines.values() for time_s, _ in points)
    largest = max(abs(error) for points in lines.values() for _, error in points)
    shown = [(name, words, style) for name, words, style in _LINES if lines[name]]
    figure = Figure(
        title="Heading error over time",
        description="; ".join(f"{words}: at most {_largest(lines[name]):.2f} degrees" for name, words, _ in shown),
        x_label="time [s]",
        y_label="error [deg]",
        x_range=(0.0, max(ends_s, 0.1)),
        y_range=(-1.05 * (largest or 0.1), 1.05 * (largest or 0.1)),
        width=panel_width(2, 2),
    )
    for name, words, style in shown:
        figure.series(words, lines[name], style)
    figure.key.reverse()
    return figure


def _points(table: Table, name: str) -> list[Point]:
    """Return time and error of every record that has one."""
    pairs = zip(numbers(table, "time"), numbers(table, name), strict=True)
    return [(time_s, error) for time_s, error in pairs if math.isfinite(time_s) and math.isfinite(error)]


def _largest(points: list[Point]) -> float:
    return max(abs(error) for _, error in points)
