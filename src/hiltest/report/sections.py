"""The sections of a run's page that are drawings, in their order; one without data is left out."""

from __future__ import annotations

from hiltest.record.run import Run
from hiltest.report.figures.accelerometer import accelerometer_group
from hiltest.report.figures.budget import budget_group
from hiltest.report.figures.cloud import cloud_group
from hiltest.report.figures.cycles import cycle_group
from hiltest.report.figures.fusion import fusion_group
from hiltest.report.figures.group import FigureGroup
from hiltest.report.figures.gyroscope import gyroscope_group
from hiltest.report.figures.heading import heading_group

_SECTIONS = (
    heading_group, budget_group, cloud_group, cycle_group, accelerometer_group, gyroscope_group, fusion_group,
)


def figure_groups(run: Run) -> list[FigureGroup]:
    """Return the drawings of a run."""
    return [group for section in _SECTIONS if (group := section(run))]
