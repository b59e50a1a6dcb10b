"""The plots of a run, each from a table of the record."""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence

from hiltest.measurement import Measurement
from hiltest.report.record import Run, Table
from hiltest.report.svg import Figure
from hiltest.report.verdict import POSES_TABLE, UNCALIBRATED, grouped

POINTS_TABLE = "tumble.points"
CALIBRATIONS_TABLE = "calibration.results"
SIZES_TABLE = "cycles.sizes"

_COMPASS = (0, 45, 90, 135, 180, 225, 270, 315, 360)
_CLOUD_SIZE = 300.0


def heading_figures(run: Run) -> list[Figure]:
    """Draw heading error against heading, one figure a calibrator, all on the same scale."""
    table = run.table(POSES_TABLE)
    if table is None or not table.rows:
        return []
    names = [column.name.removeprefix("error.") for column in table.columns if column.name.startswith("error.")]
    names = [name for name in names if name != UNCALIBRATED]
    errors = {name: _numbers(table, f"error.{name}") for name in names}
    limits = {name: _limit_of(run.measurement(f"heading.{name}.max")) for name in names}
    sizes = [abs(error) for each in errors.values() for error in each if math.isfinite(error)]
    top = 1.15 * max([*sizes, *filter(None, limits.values()), 0.1])
    return [_heading_figure(name, table, errors[name], limits[name], top) for name in names]


def _heading_figure(name: str, table: Table, errors: Sequence[float], limit: float | None, top: float) -> Figure:
    headings, level = _numbers(table, "heading"), table.column("level")
    points = [(h, e, bool(flat)) for h, e, flat in zip(headings, errors, level, strict=True) if math.isfinite(e)]
    figure = Figure(
        title=f"{name}: heading error at known angles", description=_heading_words(points, limit),
        x_label="heading [deg]", y_label="error [deg]", x_range=(0, 360), y_range=(-top, top), x_ticks=_COMPASS,
    )
    if limit is not None:
        figure.band(-limit, limit, "allowed")
        figure.level(limit, "limit")
        figure.level(-limit, "limit")
    figure.level(0, "zero")
    figure.rings([(h, e) for h, e, flat in points if not flat], "tilted", radius=3.0)
    flat_points = sorted((h, e) for h, e, flat in points if flat)
    figure.line(flat_points, "level")
    figure.rings(flat_points, "mark")
    if points:
        heading, error, _ = max(points, key=lambda point: abs(point[1]))
        figure.note((heading, error), f"worst {error:+.2f}° at {heading:.0f}°")
    return figure


def _heading_words(points: Sequence[tuple[float, float, bool]], limit: float | None) -> str:
    if not points:
        return "No pose was answered"
    worst = max(points, key=lambda point: abs(point[1]))
    judged = "no limit" if limit is None else f"limit {limit:g} degrees"
    return f"{len(points)} poses, worst {worst[1]:+.2f} degrees at heading {worst[0]:.0f}, {judged}"


def cloud_figures(run: Run) -> list[Figure]:
    """Draw the magnetometer points before calibration, and after it by each calibrator."""
    points, results = run.table(POINTS_TABLE), run.table(CALIBRATIONS_TABLE)
    if points is None or not points.rows:
        return []
    cloud = list(zip(*(_numbers(points, axis) for axis in "xyz"), strict=True))
    figures = [_before(cloud)]
    for name, soft_iron, hard_iron in _calibrations(results):
        corrected = [_correct(soft_iron, hard_iron, point) for point in cloud]
        reach = 1.15 * max(1.0, *(abs(value) for point in corrected for value in point[:2]))
        figure = Figure(
            title=f"after {name}", description=f"{len(cloud)} points seen from above, with the unit circle",
            x_label="x", y_label="y", x_range=(-reach, reach), y_range=(-reach, reach),
            width=_CLOUD_SIZE + 12, height=_CLOUD_SIZE,
        )
        figure.dots([(x, y) for x, y, _ in corrected], "cloud")
        figure.circle((0, 0), 1.0, "unit")
        figures.append(figure)
    return figures


def _before(cloud: Sequence[tuple[float, ...]]) -> Figure:
    xs, ys = [point[0] for point in cloud], [point[1] for point in cloud]
    reach = 1.15 * max(1.0, *(abs(value) for value in (*xs, *ys)))
    figure = Figure(
        title="before calibration", description=f"{len(cloud)} points seen from above, raw counts",
        x_label="x [count]", y_label="y [count]", x_range=(-reach, reach), y_range=(-reach, reach),
        width=_CLOUD_SIZE + 12, height=_CLOUD_SIZE,
    )
    figure.level(0, "zero")
    figure.line([(0, -reach), (0, reach)], "zero")
    figure.dots(zip(xs, ys, strict=True), "cloud")
    return figure


def cycle_figures(run: Run) -> list[Figure]:
    """Draw cycles against number of points, with the straight line through them."""
    table = run.table(SIZES_TABLE)
    if table is None or not table.rows:
        return []
    names = [column.name for column in table.columns if column.name != "n"]
    sizes = _numbers(table, "n")
    return [_cycle_figure(run, name, sizes, _numbers(table, name)) for name in names]


def _cycle_figure(run: Run, name: str, sizes: Sequence[float], cycles: Sequence[float]) -> Figure:
    per_point, fixed = run.measurement(f"cycles.{name}.per_point"), run.measurement(f"cycles.{name}.fixed")
    top, right = 1.1 * max(cycles), 1.05 * max(sizes)
    words = ""
    if per_point and fixed and per_point.value is not None and fixed.value is not None:
        words = f"{per_point.value:.1f} cycles per point and {grouped(fixed.value)} fixed"
    figure = Figure(
        title=f"{name}: {words}" if words else name, description=f"Cycles against points, {len(sizes)} sizes",
        x_label="points n", y_label="thousand cycles", x_range=(0, right), y_range=(0, top / 1000), height=210.0,
    )
    if words and per_point and fixed:
        slope, start = float(per_point.value or 0), float(fixed.value or 0)
        figure.line([(0, start / 1000), (right, (start + slope * right) / 1000)], "level")
    figure.rings([(n, count / 1000) for n, count in zip(sizes, cycles, strict=True)], "mark")
    return figure


def _calibrations(results: Table | None) -> Iterator[tuple[str, list[float], list[float]]]:
    """Yield name, soft iron (row by row) and hard iron of each calibrator that has them."""
    if results is None:
        return
    for index, name in enumerate(results.column("calibrator")):
        soft_iron = [_numbers(results, f"soft_iron_{row}{column}")[index] for row in "xyz" for column in "xyz"]
        hard_iron = [_numbers(results, f"hard_iron_{row}")[index] for row in "xyz"]
        if all(map(math.isfinite, (*soft_iron, *hard_iron))):
            yield str(name), soft_iron, hard_iron


def _correct(soft_iron: Sequence[float], hard_iron: Sequence[float], point: Sequence[float]) -> tuple[float, ...]:
    centred = [value - offset for value, offset in zip(point, hard_iron, strict=True)]
    return tuple(sum(soft_iron[3 * row + k] * centred[k] for k in range(3)) for row in range(3))


def _numbers(table: Table, column: str) -> list[float]:
    """Return a column as floats; what is no number is NaN and is not drawn."""
    return [float(cell) if isinstance(cell, int | float) else math.nan for cell in table.column(column)]


def _limit_of(measurement: Measurement | None) -> float | None:
    return None if measurement is None or measurement.limit is None else measurement.limit.max


__all__ = ["cloud_figures", "cycle_figures", "heading_figures"]
