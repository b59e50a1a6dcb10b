"""The picture of a motion: heading error over time, of the filter and of its halves."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import pytest

from hiltest.report.figures.fusion import fusion_group, motion_figure
from hiltest.report.render import html_report
from hiltest.run_record.run import Column, Findings, Run, Table
from hiltest.verdict.verdict import decide

UNITS = {"time": "s", "heading": "deg", "fused": "deg", "accelerometer_magnetometer": "deg", "gyroscope": "deg"}


def motion(*rows: tuple[float | None, ...]) -> Table:
    return Table("fusion.motion", tuple(Column(*unit) for unit in UNITS.items()), rows)


ROWS = ((0.0, 1.7, 0.1, -2.0, 0.1), (12.0, 270.0, 0.3, None, 0.2), (24.0, 181.7, -0.4, 1.5, 0.5))


@pytest.fixture
def run(findings: Callable[..., Findings]) -> Run:
    made = findings()
    return made.finish(decide(made, pytest_exit=0), "")


def test_the_three_are_drawn_and_told(run: Run) -> None:
    figure = motion_figure(replace(run, tables=(*run.tables, motion(*ROWS))))
    assert figure is not None
    drawing = str(figure.svg())
    assert "fused: at most 0.40 degrees" in drawing
    assert "without gyroscope: at most 2.00 degrees" in drawing
    assert "gyroscope alone: at most 0.50 degrees" in drawing
    start, end = figure.place(0.0, 0.1), figure.place(24.0, 0.5)
    assert f"M{start[0]:.1f} {start[1]:.1f}" in drawing
    assert f"{end[0]:.1f} {end[1]:.1f}" in drawing
    # A moment without an attitude is left out.
    assert drawing.count("L") == 2 + 1 + 2


def test_the_page_has_the_picture_where_there_was_a_motion(run: Run) -> None:
    moved = replace(run, tables=(*run.tables, motion(*ROWS)))
    assert "Fusion during a motion" in html_report(moved)
    assert "Fusion during a motion" not in html_report(run)
    assert fusion_group(replace(run, tables=(motion(),))) is None
