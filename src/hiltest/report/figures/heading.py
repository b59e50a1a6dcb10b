"""Heading error against the known angle: one panel per calibrator, and the picture of the error that failed a run."""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from itertools import groupby, pairwise

from hiltest.measurement import Section, identify
from hiltest.report.figures.section import FigureGroup, numbers, panel_width, upper_limit, written
from hiltest.report.marks import KeyEntry, Mark, series
from hiltest.report.svg import Figure, Point, Sheet
from hiltest.run_record.comparison import Change
from hiltest.run_record.run import Run, Table
from hiltest.verdict.calibrators import UNCALIBRATED
from hiltest.verdict.evidence import BASE_POSES_TABLE, ERROR_COLUMN, POSES_TABLE
from hiltest.verdict.summary import Summary
from hiltest.verdict.verdict import worst_failure

_MOST = 4
_HALF_TURN = 180.0
_PREDICTED = "predicted by the likely cause"


@dataclass(frozen=True, slots=True)
class _Pose:
    heading_deg: float
    error_deg: float
    level: bool
    tilt: str = ""
    """Pitch and roll in words."""
    base_deg: float = math.nan
    """Error in the base."""
    predicted_deg: float = math.nan
    """Error that the likely cause predicts."""


@dataclass(frozen=True, slots=True)
class FailedHeading:
    """Heading errors that failed a run, beside those of the base and those that the likely cause predicts."""

    name: str
    """Calibrator."""
    limit: float | None
    poses: Sequence[_Pose]
    """Poses, by tilt and heading."""

    @property
    def figure(self) -> Figure:
        """Error over heading: a colour for each tilt, with a curve for the prediction, and the base in grey."""
        errors = [error for pose in self.poses for error in (pose.error_deg, pose.base_deg, pose.predicted_deg)]
        top = 1.15 * max(abs(error) for error in (*errors, self.limit or 0.1) if math.isfinite(error))
        figure = _axes(self.name, self.poses, self.limit, top, 500.0, "heading [deg]", "error [deg]")
        if base := [(pose.heading_deg, pose.base_deg) for pose in self.poses if math.isfinite(pose.base_deg)]:
            figure.series("base", base, mark=Mark.DOT, mark_style="neutral filled", radius=2.5)
        curves = []
        for index, (tilt, poses) in enumerate(self._tilt_groups()):
            style, mark = series(index)
            points = [(pose.heading_deg, pose.error_deg) for pose in poses]
            figure.series(tilt, points, mark=mark, mark_style=f"{style} filled")
            curves += [(style, part) for part in _without_jumps(poses)]
        for style, part in curves:
            figure.line(part, style)
        if curves:
            figure.key.append(KeyEntry(_PREDICTED, curves[0][0]))
        rows = [
            [f"{pose.heading_deg:g}", pose.tilt, *map(_signed, (pose.error_deg, pose.base_deg, pose.predicted_deg))]
            for pose in self.poses
        ]
        figure.sheet = Sheet(
            f"Errors of {self.name} at each pose [deg]", ["heading", "tilt", "this run", "base", _PREDICTED], rows
        )
        return figure

    def mermaid(self) -> Iterator[str]:
        """Yield the chart of the tilt with the largest error as a Mermaid block, which GitHub draws in comments.

        GitHub removes inline SVG and addresses of data from Markdown.
        """
        tilt, poses = max(self._tilt_groups(), key=lambda group: max(abs(pose.error_deg) for pose in group[1]))
        bounds = [] if self.limit is None else [self.limit, -self.limit]
        candidates = (
            *(("green", "limit", [bound] * len(poses)) for bound in bounds),
            ("gray", "base", [pose.base_deg for pose in poses]),
            ("orange", _PREDICTED, [pose.predicted_deg for pose in poses]),
            ("blue", "this run", [pose.error_deg for pose in poses]),
        )
        lines = [candidate for candidate in candidates if all(map(math.isfinite, candidate[2]))]
        top = 1.15 * max(abs(value) for _, _, values in lines for value in values)
        palette = ", ".join(colour for colour, _, _ in lines)
        headings = ", ".join(f'"{pose.heading_deg:g}"' for pose in poses)
        yield from ("", "```mermaid")
        yield f'%%{{init: {{"themeVariables": {{"xyChart": {{"plotColorPalette": "{palette}"}}}}}}}}%%'
        yield from (
            "xychart-beta",
            f'x-axis "heading [deg]" [{headings}]',
            f'y-axis "error [deg]" {-top:.2f} --> {top:.2f}',
        )
        for _, _, values in lines:
            yield f"line [{', '.join(f'{value:.2f}' for value in values)}]"
        meanings = dict.fromkeys(f"{colour}: {name}" for colour, name, _ in reversed(lines))
        yield from ("```", "", f"Heading error, {tilt}. {'; '.join(meanings).capitalize()}.")

    def _tilt_groups(self) -> list[tuple[str, list[_Pose]]]:
        return [(tilt, list(poses)) for tilt, poses in groupby(self.poses, key=lambda pose: pose.tilt)]


def failed_heading(run: Run, summary: Summary) -> FailedHeading | None:
    """Return the heading errors that failed a run or got worse; None if others decide, or the record lacks them."""
    table = run.table(POSES_TABLE)
    worse = run.comparison.differences_with(Change.WORSE) if run.comparison and run.comparison.regression else ()
    first = worst_failure(summary).measurement.name if summary.failures else worse[0].name if worse else ""
    name = identify(first).subject if identify(first).section is Section.HEADING else ""
    if table is None or not any(column.name == f"{ERROR_COLUMN}{name}" for column in table.columns):
        return None
    count = len(table.rows)
    predicted = summary.predicted_deg.get(name, ())
    base = run.table(BASE_POSES_TABLE)
    base_errors = [] if base is None else numbers(base, f"{ERROR_COLUMN}{name}")
    poses = _poses(
        table,
        numbers(table, f"{ERROR_COLUMN}{name}"),
        base_errors if len(base_errors) == count else [math.nan] * count,
        predicted if len(predicted) == count else [math.nan] * count,
    )
    in_order = sorted(poses, key=lambda pose: (not pose.level, pose.tilt, pose.heading_deg))
    return FailedHeading(name, upper_limit(run.measurement(f"heading.{name}.max")), in_order) if poses else None


def heading_group(run: Run, *, drawn: str = "") -> FigureGroup | None:
    """Return the section; None if no heading was measured. All panels have the same axes.

    Parameters
    ----------
    drawn
        Calibrator that the page has already drawn.
    """
    table = run.table(POSES_TABLE)
    if table is None or not table.rows:
        return None
    columns = [
        column.name.removeprefix(ERROR_COLUMN) for column in table.columns if column.name.startswith(ERROR_COLUMN)
    ]
    errors = {name: numbers(table, f"{ERROR_COLUMN}{name}") for name in columns if name not in (UNCALIBRATED, drawn)}
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


def _poses(table: Table, errors: Sequence[float], *more: Sequence[float]) -> list[_Pose]:
    """Return the poses with a heading; `more` are the errors in the base, and those that a cause predicts."""
    tilts = zip(numbers(table, "pitch"), numbers(table, "roll"), strict=True)
    words = [f"pitch {pitch:g}°, roll {roll:g}°" if pitch or roll else "level" for pitch, roll in tilts]
    rows = zip(numbers(table, "heading"), errors, map(bool, table.column_if_any("level")), words, *more, strict=True)
    return [_Pose(*row) for row in rows if math.isfinite(row[0]) and math.isfinite(row[1])]


def _without_jumps(poses: Sequence[_Pose]) -> Iterator[list[Point]]:
    """Yield the predicted curve in parts: it does not join errors on both sides of half a turn."""
    points = [(pose.heading_deg, pose.predicted_deg) for pose in poses if math.isfinite(pose.predicted_deg)]
    ends = [index for index, (one, other) in enumerate(pairwise(points), 1) if abs(other[1] - one[1]) > _HALF_TURN]
    for first, last in pairwise([0, *ends, len(points)]):
        if last > first:
            yield points[first:last]


def _axes(name: str, poses: Sequence[_Pose], limit: float | None, top: float, width: float, *labels: str) -> Figure:
    """Return the axes of heading errors, with the limit and the largest error in the title."""
    worst = max(poses, key=lambda pose: abs(pose.error_deg), default=None)
    words = f"worst {worst.error_deg:+.2f}° at {worst.heading_deg:.0f}°" if worst else "no pose was answered"
    figure = Figure(
        title=f"{name}: {words}",
        description=f"{len(poses)} poses, {'no limit' if limit is None else f'limit {limit:g} degrees'}",
        x_label=labels[0] if labels else "",
        y_label=labels[1] if labels else "",
        x_range=(0, 360),
        y_range=(-top, top),
        x_ticks=(0, 90, 180, 270, 360),
        width=width,
        height=250.0 if labels else 170.0,
    )
    figure.limit(limit)
    figure.level(0, "zero")
    return figure


def _panel(name: str, poses: Sequence[_Pose], limit: float | None, top: float, width: float) -> Figure:
    figure = _axes(name, poses, limit, top, width)
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


def _signed(error: float) -> str:
    return f"{error:+.2f}" if math.isfinite(error) else ""


def _sheet(table: Table, errors: dict[str, list[float]]) -> Sheet:
    poses = zip(*(written(table.column_if_any(name)) for name in ("heading", "pitch", "roll")), strict=True)
    signed = (map(_signed, series) for series in errors.values())
    return Sheet(
        "Heading error at each pose [deg]",
        ["heading", "pitch", "roll", *errors],
        [[*pose, *cells] for pose, cells in zip(poses, zip(*signed, strict=True), strict=True)],
    )
