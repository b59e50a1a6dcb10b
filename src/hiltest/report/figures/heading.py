"""Heading error against the known angle, one panel per calibrator."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

from hiltest.report.figures.section import FigureGroup, numbers, panel_width, upper_limit, written
from hiltest.report.marks import Mark
from hiltest.report.svg import Figure, Sheet
from hiltest.run_record.run import Run, Table
from hiltest.verdict.calibrators import UNCALIBRATED
from hiltest.verdict.verdict import POSES_TABLE

_ERROR = "error."
_MOST = 4


@dataclass(frozen=True, slots=True)
class _Pose:
    heading_deg: float
    error_deg: float
    level: bool


def heading_group(run: Run) -> FigureGroup | None:
    """Return the section; None if no heading was measured. All panels have the same axes."""
    table = run.table(POSES_TABLE)
    if table is None or not table.rows:
        return None
    columns = [column.name.removeprefix(_ERROR) for column in table.columns if column.name.startswith(_ERROR)]
    errors = {name: numbers(table, f"{_ERROR}{name}") for name in columns if name != UNCALIBRATED}
    limits = {name: upper_limit(run.measurement(f"heading.{name}.max")) for name in errors}
    sizes = [abs(error) for series in errors.values() for error in series if math.isfinite(error)]
    top = 1.15 * max([*sizes, *filter(None, limits.values()), 0.1])
    return (
        FigureGroup(
            "heading",
            "Heading error at known angles",
            "The board's heading minus the turntable's angle and the declared mounting.",
            [
                _panel(name, _poses(table, series), limits[name], top, panel_width(len(errors), _MOST))
                for name, series in errors.items()
            ],
            most=_MOST,
            caption="Error [deg] over heading [deg], on the same axes for each calibrator",
            numbers=[_sheet(table, errors)],
            short="Heading error",
        )
        if errors
        else None
    )


def _poses(table: Table, errors: Sequence[float]) -> list[_Pose]:
    rows = zip(numbers(table, "heading"), errors, table.column_if_any("level"), strict=True)
    return [_Pose(at, error, bool(level)) for at, error, level in rows if math.isfinite(at) and math.isfinite(error)]


def _panel(name: str, poses: Sequence[_Pose], limit: float | None, top: float, width: float) -> Figure:
    worst = max(poses, key=lambda pose: abs(pose.error_deg), default=None)
    words = f"worst {worst.error_deg:+.2f}° at {worst.heading_deg:.0f}°" if worst else "no pose was answered"
    figure = Figure(
        title=f"{name}: {words}",
        description=f"{len(poses)} poses, {'no limit' if limit is None else f'limit {limit:g} degrees'}",
        x_label="",
        y_label="",
        x_range=(0, 360),
        y_range=(-top, top),
        x_ticks=(0, 90, 180, 270, 360),
        width=width,
        height=170.0,
    )
    figure.limit(limit)
    figure.level(0, "zero")
    beyond = [pose for pose in poses if limit is not None and abs(pose.error_deg) > limit]
    for words, style, mark, shown in (
        ("tilted poses", "tilted hollow", Mark.DOT, [pose for pose in poses if not pose.level and pose not in beyond]),
        ("level poses", "level filled", Mark.DOT, [pose for pose in poses if pose.level and pose not in beyond]),
        ("beyond the limit", "over", Mark.CROSS, beyond),
    ):
        if shown:
            points = [(pose.heading_deg, pose.error_deg) for pose in shown]
            figure.series(words, points, mark=mark, mark_style=style, radius=2.5)
    figure.line(sorted((pose.heading_deg, pose.error_deg) for pose in poses if pose.level), "level")
    return figure


def _sheet(table: Table, errors: dict[str, list[float]]) -> Sheet:
    poses = zip(*(written(table.column_if_any(name)) for name in ("heading", "pitch", "roll")), strict=True)
    signed = ([f"{error:+.2f}" if math.isfinite(error) else "" for error in series] for series in errors.values())
    return Sheet(
        "Heading error at each pose [deg]",
        ["heading", "pitch", "roll", *errors],
        [[*pose, *cells] for pose, cells in zip(poses, zip(*signed, strict=True), strict=True)],
    )
