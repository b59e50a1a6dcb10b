"""The accelerometer: tilt at the known angles, the six faces, and how much of its limits it uses."""

from __future__ import annotations

import math

from hiltest.record.run import Run
from hiltest.report.figures.columns import numbers, upper_limit
from hiltest.report.figures.group import Drawing, FigureGroup
from hiltest.report.figures.limits import limit_figure
from hiltest.report.figures.rows import Row, RowFigure
from hiltest.report.marks import KeyEntry, Mark
from hiltest.report.svg import Figure, Point
from hiltest.verdict.verdict import POSES_TABLE

FACES_TABLE = "accelerometer.six_position.poses"
_AXES = "xyz"


def accelerometer_group(run: Run) -> FigureGroup | None:
    """Return the section, None when nothing was measured of it."""
    figures: list[Drawing | None] = [
        limit_figure(run.measurements, "accelerometer", "Limits"), _tilt_figure(run), _faces_figure(run),
    ]
    drawn = [figure for figure in figures if figure]
    return FigureGroup(
        "accelerometer", "Accelerometer",
        "A heading rests on the direction of gravity: what is wrong here is wrong in every heading. Tilt is what the "
        "board answered at the known angles, less what the turntable was set to.",
        drawn, tall_first=len(drawn) == 3,
    ) if drawn else None


def _tilt_figure(run: Run) -> Figure | None:
    table = run.table(POSES_TABLE)
    if table is None:
        return None
    heading = numbers(table, "heading")
    errors = {
        name: [(h, answered - set_to) for h, answered, set_to in zip(
            heading, numbers(table, f"answered_{name}"), numbers(table, name), strict=True,
        ) if math.isfinite(h + answered - set_to)] for name in ("pitch", "roll")
    }
    sizes = [abs(error) for points in errors.values() for _, error in points]
    if not sizes:
        return None
    limit = upper_limit(run.measurement("accelerometer.tilt_error"))
    top = 1.15 * max(*sizes, limit or 0.0, 0.01)
    figure = Figure(
        title="Tilt error at the known angles",
        description="; ".join(f"{name}: at most {_largest(points):.2f} degrees" for name, points in errors.items()),
        x_label="heading [deg]", y_label="error [deg]", x_range=(0, 360), y_range=(-top, top),
        x_ticks=(0, 45, 90, 135, 180, 225, 270, 315, 360),
        key=[KeyEntry("pitch", "", Mark.DOT, "level filled"), KeyEntry("roll", "", Mark.DIAMOND, "tilted hollow")],
    )
    if limit is not None:
        figure.band(-limit, limit, "allowed")
        figure.level(limit, "limit")
        figure.level(-limit, "limit")
        figure.key.append(KeyEntry("limit", "limit"))
    figure.level(0, "zero")
    figure.marks(errors["pitch"], "level filled", radius=3.0)
    figure.marks(errors["roll"], "tilted hollow", Mark.DIAMOND)
    return figure


def _faces_figure(run: Run) -> RowFigure | None:
    """Draw the length of gravity on each face, as the sensor gave it: offsets and scales are seen before they go."""
    table = run.table(FACES_TABLE)
    if table is None:
        return None
    faces = [face for face in zip(*(numbers(table, axis) for axis in _AXES), strict=True) if math.isfinite(sum(face))]
    lengths = [math.hypot(*face) for face in faces]
    if not any(lengths):
        return None
    mean = sum(lengths) / len(lengths)
    off_mg = [1000.0 * (length / mean - 1.0) for length in lengths]
    reach = 2.1 * max(0.1, *map(abs, off_mg))
    rows = [
        Row(_face_up(face), f"{off:+.2f} mg", 0.5 + off / reach, Mark.DOT, "level filled", start=0.5)
        for face, off in zip(faces, off_mg, strict=True)
    ]
    in_words = "; ".join(f"{row.name} {row.number}" for row in rows)
    return RowFigure("Gravity on each face, off the mean, before calibration", in_words, rows)


def _face_up(counts: tuple[float, ...]) -> str:
    axis = max(range(3), key=lambda each: abs(counts[each]))
    return f"{'+' if counts[axis] > 0 else '−'}{_AXES[axis]}"


def _largest(points: list[Point]) -> float:
    return max((abs(error) for _, error in points), default=0.0)
