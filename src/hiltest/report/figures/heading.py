"""Heading error against the known angle, one figure a calibrator."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

from hiltest.record.run import Run, Table
from hiltest.report.figures.columns import names_after, numbers, upper_limit, written
from hiltest.report.figures.group import FigureGroup, Sheet
from hiltest.report.marks import KeyEntry, Mark
from hiltest.report.svg import Figure
from hiltest.verdict.calibrators import UNCALIBRATED
from hiltest.verdict.verdict import POSES_TABLE

_COMPASS = (0, 45, 90, 135, 180, 225, 270, 315, 360)
_KEY = (
    KeyEntry("level poses", "level", Mark.DOT, "level filled"), KeyEntry("tilted poses", "", Mark.DOT, "tilted hollow"),
    KeyEntry("beyond the limit", "", Mark.CROSS, "over"), KeyEntry("limit", "limit"),
)


@dataclass(frozen=True, slots=True)
class _Pose:
    heading_deg: float
    error_deg: float
    level: bool


def heading_group(run: Run) -> FigureGroup | None:
    """Return the section, None when no heading was judged; all figures have the same scale."""
    table = run.table(POSES_TABLE)
    if table is None or not table.rows:
        return None
    names = [name for name in names_after(table, "error.") if name != UNCALIBRATED]
    errors = {name: numbers(table, f"error.{name}") for name in names}
    limits = {name: upper_limit(run.measurement(f"heading.{name}.max")) for name in names}
    sizes = [abs(error) for each in errors.values() for error in each if math.isfinite(error)]
    top = 1.15 * max([*sizes, *filter(None, limits.values()), 0.1])
    return FigureGroup(
        "heading", "Heading error at known angles",
        "What the board answered, less the angle that the turntable was set to. The mounting that the rig declares is "
        "subtracted, and nothing else.",
        [_figure(name, _poses(table, errors[name]), limits[name], top) for name in names], key=_KEY,
        numbers=_sheet(table, errors), short="Heading error",
    )


def _poses(table: Table, errors: Sequence[float]) -> list[_Pose]:
    rows = zip(numbers(table, "heading"), errors, table.column_if_any("level"), strict=True)
    return [_Pose(at, error, bool(level)) for at, error, level in rows if math.isfinite(at) and math.isfinite(error)]


def _figure(name: str, poses: Sequence[_Pose], limit: float | None, top: float) -> Figure:
    figure = Figure(
        title=f"{name}: heading error", description=_in_words(poses, limit),
        x_label="heading [deg]", y_label="error [deg]", x_range=(0, 360), y_range=(-top, top), x_ticks=_COMPASS,
    )
    if limit is not None:
        figure.band(-limit, limit, "allowed")
        figure.level(limit, "limit")
        figure.level(-limit, "limit")
    figure.level(0, "zero")
    level = sorted((each.heading_deg, each.error_deg) for each in poses if each.level)
    figure.line(level, "level")
    held = [each for each in poses if limit is None or abs(each.error_deg) <= limit]
    for flat, style in ((False, "tilted hollow"), (True, "level filled")):
        points = [(each.heading_deg, each.error_deg) for each in held if each.level is flat]
        figure.marks(points, style, radius=3.5 if flat else 3.0)
    figure.marks([(each.heading_deg, each.error_deg) for each in poses if each not in held], "over", Mark.CROSS)
    if poses:
        worst = _worst(poses)
        words = f"worst {worst.error_deg:+.2f}° at {worst.heading_deg:.0f}°"
        figure.note((worst.heading_deg, worst.error_deg), words)
    return figure


def _worst(poses: Sequence[_Pose]) -> _Pose:
    return max(poses, key=lambda each: abs(each.error_deg))


def _in_words(poses: Sequence[_Pose], limit: float | None) -> str:
    if not poses:
        return "No pose was answered"
    worst = _worst(poses)
    judged = "no limit" if limit is None else f"limit {limit:g} degrees"
    return f"{len(poses)} poses, worst {worst.error_deg:+.2f} degrees at heading {worst.heading_deg:.0f}, {judged}"


def _signed(error: float) -> str:
    return f"{error:+.2f}" if math.isfinite(error) else ""


def _sheet(table: Table, errors: dict[str, list[float]]) -> Sheet:
    where = (table.column_if_any(name) for name in ("heading", "pitch", "roll"))
    poses = [written(pose) for pose in zip(*where, strict=True)]
    cells = [[_signed(each[index]) for each in errors.values()] for index in range(len(poses))]
    return Sheet(
        "Heading error at each pose [deg]", ["heading", "pitch", "roll", *errors],
        [[*pose, *row] for pose, row in zip(poses, cells, strict=True)],
    )
