"""The accelerometer and the gyroscope: the share of each limit that is used, tilt, gravity on six faces, rates."""

from __future__ import annotations

import math

from hiltest.measurement import Section
from hiltest.report.figures.rows import Row, RowFigure, bars, limit_figure
from hiltest.report.figures.section import Drawing, FigureGroup, numbers, panel_width, upper_limit
from hiltest.report.marks import Mark
from hiltest.report.svg import Figure
from hiltest.run_record.run import Run
from hiltest.verdict.evidence import POSES_TABLE

FACES_TABLE, NOISE_TABLE = "accelerometer.six_position.poses", "gyroscope.noise_density"
_AXES = "xyz"


def accelerometer_group(run: Run) -> FigureGroup | None:
    """Return the section; None without a measurement in it."""
    limits = limit_figure(run.measurements, Section.ACCELEROMETER, "Share of each accelerometer limit")
    return _group(
        "Accelerometer",
        "Every heading depends on the direction of gravity. Tilt error: the board's pitch and roll at the known "
        "angles, minus those of the turntable.",
        limits,
        _tilt_figure(run),
        _faces_figure(run),
    )


def gyroscope_group(run: Run) -> FigureGroup | None:
    """Return the section; None without a measurement in it."""
    limits = limit_figure(run.measurements, Section.GYROSCOPE, "Share of each gyroscope limit")
    return _group(
        "Gyroscope",
        "The bias was measured at an earlier rest than the checked one, scale and axes during full turns of the table.",
        limits,
        _rest_figure(run),
        _noise_figure(run),
    )


def _group(heading: str, legend: str, *panels: Drawing | None) -> FigureGroup | None:
    drawn = [panel for panel in panels if panel]
    return FigureGroup(heading.lower(), heading, legend, drawn) if drawn else None


def _tilt_figure(run: Run) -> Figure | None:
    table = run.table(POSES_TABLE)
    if table is None:
        return None
    heading = numbers(table, "heading")
    errors = {
        name: [
            (h, answered - set_to)
            for h, answered, set_to in zip(
                heading,
                numbers(table, f"answered_{name}"),
                numbers(table, name),
                strict=True,
            )
            if math.isfinite(h + answered - set_to)
        ]
        for name in ("pitch", "roll")
    }
    largest = {name: max((abs(error) for _, error in points), default=0.0) for name, points in errors.items()}
    if not any(errors.values()):
        return None
    limit = upper_limit(run.measurement("accelerometer.tilt_error"))
    top = 1.15 * max(*largest.values(), limit or 0.0, 0.01)
    figure = Figure(
        title="Tilt error at the known angles",
        description="; ".join(f"{name}: at most {error:.2f} degrees" for name, error in largest.items()),
        x_label="heading [deg]",
        y_label="error [deg]",
        x_range=(0, 360),
        y_range=(-top, top),
        x_ticks=(0, 90, 180, 270, 360),
        width=panel_width(3, 3),
    )
    figure.limit(limit)
    figure.level(0, "zero")
    figure.series("pitch", errors["pitch"], mark=Mark.DOT, mark_style="level filled", radius=3.0)
    figure.series("roll", errors["roll"], mark=Mark.DIAMOND, mark_style="tilted hollow")
    return figure


def _faces_figure(run: Run) -> RowFigure | None:
    """Draw the magnitude of gravity on each face before calibration, which shows offsets and scales."""
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
    return RowFigure(
        "Gravity magnitude per face before calibration, deviation from the mean",
        [
            Row(_face_up(face), f"{off:+.2f} mg", 0.5 + off / reach, Mark.DOT, "level filled", start=0.5)
            for face, off in zip(faces, off_mg, strict=True)
        ],
    )


def _face_up(counts: tuple[float, ...]) -> str:
    axis = max(range(3), key=lambda index: abs(counts[index]))
    return f"{'+' if counts[axis] > 0 else '−'}{_AXES[axis]}"


def _rest_figure(run: Run) -> RowFigure | None:
    """Draw the rate at rest before and after the bias was subtracted."""
    measured = {
        words: run.measurement(name)
        for words, name in (
            ("before calibration", "gyroscope.uncorrected_error"),
            ("bias subtracted", "gyroscope.bias_error"),
        )
    }
    values = {
        words: (abs(measurement.value), f"{abs(measurement.value):.3g} {measurement.unit}")
        for words, measurement in measured.items()
        if measurement is not None and measurement.value is not None
    }
    return bars("Rate at rest", values) if len(values) == len(measured) else None


def _noise_figure(run: Run) -> RowFigure | None:
    table = run.table(NOISE_TABLE)
    if table is None:
        return None
    (unit,) = [column.unit for column in table.columns if column.name == "density"] or [""]
    rows = zip(table.column_if_any("axis"), numbers(table, "density"), strict=True)
    values = {str(axis): (value, f"{value:.3g} {unit}") for axis, value in rows if math.isfinite(value)}
    return bars("Noise density of each axis", values) if values else None
