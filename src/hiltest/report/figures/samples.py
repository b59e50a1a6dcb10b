"""The magnetometer's samples before and after calibration, and their coverage of the sphere."""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from hiltest.calibration.solid_angle import SPHERE, Hole, covered_directions, largest_hole
from hiltest.report.figures.section import FigureGroup, numbers, panel_width, written
from hiltest.report.marks import KeyEntry, Mark
from hiltest.report.svg import Figure, Point, Sheet
from hiltest.run_record.run import Run, Table

POINTS_TABLE = "tumble.points"
CALIBRATIONS_TABLE = "calibration.results"
_MOST = 6
_UNIT = KeyEntry("unit circle: ideal place of calibrated samples", "unit")

Array = NDArray[np.float64]
SAMPLE = KeyEntry("a sample", "", Mark.DOT, "level filled")


@dataclass(frozen=True, slots=True)
class _Calibration:
    name: str
    soft_iron: Array
    hard_iron: Array


def samples_group(run: Run) -> FigureGroup | None:
    """Return the section; None if no sample was collected."""
    points, results = run.table(POINTS_TABLE), run.table(CALIBRATIONS_TABLE)
    samples = None if points is None else np.array([numbers(points, axis) for axis in "xyz"]).T
    if samples is None or not len(samples := samples[np.isfinite(samples).all(axis=1)]):
        return None
    calibrations = [] if results is None else list(_calibrations(results))
    corrected = {
        calibration.name: (samples - calibration.hard_iron) @ calibration.soft_iron.T for calibration in calibrations
    }
    width = panel_width(1 + len(corrected) + bool(corrected), _MOST)
    panels = [_plot_along_z("before calibration", "raw counts", samples, width)]
    for name, calibrated in corrected.items():
        panels.append(_plot_along_z(f"after {name}", "with the unit circle", calibrated, width))
        panels[-1].circle((0, 0), 1.0, "unit")
        panels[-1].key.append(_UNIT)
    panels += [
        largest_cap_map(calibrated, width=width, height=panels[0].height) for calibrated in list(corrected.values())[:1]
    ]
    sheets = [_calibration_sheet(results)] if results and corrected else []
    return FigureGroup(
        "samples",
        "Magnetometer samples",
        "Samples that the board collected while it was tumbled, raw and corrected by each calibrator. Samples on a "
        f"sphere do not prove that the heading is right.{_coverage_in_words(run)}",
        panels,
        most=_MOST,
        caption="y over x: raw in counts, calibrated in units of the field's magnitude",
        numbers=[*sheets, Sheet("Raw samples [count]", "xyz", [written(row) for row in samples.tolist()])],
        short="Samples",
    )


def _coverage_in_words(run: Run) -> str:
    covered = run.measurement("tumble.coverage")
    if covered is None or covered.value is None:
        return ""
    return f" {covered.value:.0f} % of the sphere lies outside the largest uncovered cap."


def _calibrations(results: Table) -> Iterator[_Calibration]:
    """Yield the calibrations that have a matrix and an offset."""
    soft_iron = np.array([[numbers(results, f"soft_iron_{row}{column}") for column in "xyz"] for row in "xyz"])
    hard_iron = np.array([numbers(results, f"hard_iron_{row}") for row in "xyz"])
    for index, name in enumerate(results.column_if_any("calibrator")):
        calibration = _Calibration(str(name), soft_iron[:, :, index], hard_iron[:, index])
        if np.isfinite(calibration.soft_iron).all() and np.isfinite(calibration.hard_iron).all():
            yield calibration


def _plot_along_z(title: str, words: str, samples: Array, width: float) -> Figure:
    reach = 1.15 * max(1.0, float(np.abs(samples[:, :2]).max()))
    figure = Figure(
        title=title,
        description=f"{len(samples)} samples seen along z, {words}",
        x_label="",
        y_label="",
        x_range=(-reach, reach),
        y_range=(-reach, reach),
        width=width,
        equal_axes=True,
        key=[SAMPLE],
    )
    figure.dots(samples[:, :2].tolist(), "samples")
    return figure


def _calibration_sheet(results: Table) -> Sheet:
    """Return one column per calibrator: three of them and sixteen numbers are higher than wide."""
    columns = [(column.name.replace("_", " "), column.unit, results.column(column.name)) for column in results.columns]
    (_, _, names), *others = columns
    rows = [[f"{name} [{unit}]" if unit else name, *written(cells)] for name, unit, cells in others]
    return Sheet("Calibrations that the board fitted", ["quantity", *map(str, names)], rows)


def _cap(hole: Hole) -> Array:
    cap: Array = SPHERE[SPHERE @ np.array(hole.direction) >= math.cos(math.radians(hole.radius_deg))]
    return cap


def coverage_map(corrected: Array, shown: Array, hole: Hole | None) -> Figure:
    """Draw the part of the sphere that samples cover, by the rule that accepts calibrations of recorded samples.

    Parameters
    ----------
    corrected, shown : shape (n, 3)
        All calibrated samples, and those that are drawn.
    hole
        Largest hole; named if it is part of the uncovered area.
    """
    covered = covered_directions(corrected)
    named = hole if hole is not None and not covered.all() else None
    words = "" if named is None else f"; largest hole about {named.axes}, radius {named.radius_deg:.0f}°"
    figure = _sphere_map(
        f"coverage: {100.0 * covered.mean():.0f} % of the sphere{words}",
        "Directions of the calibrated samples on an equal-area map, with the largest hole marked",
        KeyEntry("no sample near", "uncovered"),
        SPHERE[~covered],
        shown,
        460.0,
        260.0,
    )
    if named is not None:
        figure.marks(_map_points(np.array([named.direction])), "series-3 hollow", Mark.CROSS, radius=6.0)
        figure.key.append(KeyEntry("middle of the largest hole", "", Mark.CROSS, "series-3 hollow"))
    return figure


def largest_cap_map(corrected: Array, *, width: float, height: float) -> Figure:
    """Draw the samples of a tumble, and the largest cap of the sphere without one.

    Parameters
    ----------
    corrected : shape (n, 3)
    width, height
        Size of the drawing.
    """
    hole = largest_hole(corrected)
    radius_deg, cap = hole.radius_deg, _cap(hole)
    return _sphere_map(
        f"largest uncovered cap: {radius_deg:.0f}° radius",
        f"Directions of {len(corrected)} calibrated samples on an equal-area map: sine of the elevation over azimuth; "
        "the largest uncovered cap is marked",
        KeyEntry("largest uncovered cap", "uncovered"),
        cap,
        corrected,
        width,
        height,
        labelled=False,
    )


def _sphere_map(
    title: str,
    description: str,
    entry: KeyEntry,
    marked: Array,
    shown: Array,
    width: float,
    height: float,
    *,
    labelled: bool = True,
) -> Figure:
    labels = ("azimuth in the sensor's axes [deg]", "sine of the elevation") if labelled else ("", "")
    figure = Figure(
        title,
        description,
        *labels,
        x_range=(-180, 180),
        y_range=(-1, 1),
        x_ticks=(-180, -90, 0, 90, 180),
        width=width,
        height=height,
        key=[SAMPLE, entry],
    )
    figure.dots(_map_points(marked), "uncovered")
    figure.dots(_map_points(shown), "samples")
    return figure


def _map_points(directions: Array) -> list[Point]:
    lengths = np.linalg.norm(directions, axis=1)
    directions = directions[lengths > 0.0] / lengths[lengths > 0.0, None]
    azimuths = np.degrees(np.arctan2(directions[:, 1], directions[:, 0]))
    return list(zip(azimuths.tolist(), directions[:, 2].tolist(), strict=True))
