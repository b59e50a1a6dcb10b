"""The magnetometer's points before calibration and after it, and how much of the sphere they cover."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from hiltest.record.run import Run, Table
from hiltest.report.figures.columns import numbers, written
from hiltest.report.figures.coverage import READING, hole_map
from hiltest.report.figures.group import FigureGroup, Sheet
from hiltest.report.marks import KeyEntry
from hiltest.report.svg import Figure

POINTS_TABLE = "tumble.points"
CALIBRATIONS_TABLE = "calibration.results"
_SIZE = 300.0
_KEY = (READING, KeyEntry("where a calibrated one belongs", "unit"))

Array = NDArray[np.float64]


@dataclass(frozen=True, slots=True)
class _Calibration:
    name: str
    soft_iron: Array
    hard_iron: Array


def cloud_group(run: Run) -> FigureGroup | None:
    """Return the section, None when no point was collected."""
    points, results = run.table(POINTS_TABLE), run.table(CALIBRATIONS_TABLE)
    cloud = None if points is None else np.array([numbers(points, axis) for axis in "xyz"]).T
    if cloud is None or not len(cloud := cloud[np.isfinite(cloud).all(axis=1)]):
        return None
    calibrations = [] if results is None else list(_calibrations(results))
    corrected = [(each, (cloud - each.hard_iron) @ each.soft_iron.T) for each in calibrations]
    maps = [hole_map(corrected[0][1], width=_SIZE + 12, height=_SIZE)] if corrected else []
    return FigureGroup(
        "cloud", "The cloud",
        "Readings that the board collected while it was tumbled, seen from above: as the sensor gave them, and as each "
        f"calibrator corrects them. A round cloud does not say that the heading is right.{_covered(run)}",
        [_before(cloud), *(_after(each.name, points) for each, points in corrected), *maps], key=_KEY, small=True,
        numbers=_sheet(results) if results and corrected else None,
    )


def _covered(run: Run) -> str:
    covered = run.measurement("tumble.coverage")
    if covered is None or covered.value is None:
        return ""
    return f" {covered.value:.0f} % of the sphere lie outside the largest hole of the points calibrators were given."


def _calibrations(results: Table) -> Iterator[_Calibration]:
    """Yield those that have a matrix and an offset."""
    soft_iron = np.array([[numbers(results, f"soft_iron_{row}{column}") for column in "xyz"] for row in "xyz"])
    hard_iron = np.array([numbers(results, f"hard_iron_{row}") for row in "xyz"])
    for index, name in enumerate(results.column_if_any("calibrator")):
        found = _Calibration(str(name), soft_iron[:, :, index], hard_iron[:, index])
        if np.isfinite(found.soft_iron).all() and np.isfinite(found.hard_iron).all():
            yield found


def _before(cloud: Array) -> Figure:
    reach = 1.15 * max(1.0, float(np.abs(cloud[:, :2]).max()))
    figure = Figure(
        title="before calibration", description=f"{len(cloud)} points seen from above, raw counts",
        x_label="x [count]", y_label="y [count]", x_range=(-reach, reach), y_range=(-reach, reach),
        width=_SIZE + 12, height=_SIZE,
    )
    figure.level(0, "zero")
    figure.line([(0, -reach), (0, reach)], "zero")
    figure.dots(cloud[:, :2].tolist(), "cloud")
    return figure


def _after(name: str, points: Array) -> Figure:
    reach = 1.15 * max(1.0, float(np.abs(points[:, :2]).max()))
    figure = Figure(
        title=f"after {name}", description=f"{len(points)} points seen from above, with the unit circle",
        x_label="x", y_label="y", x_range=(-reach, reach), y_range=(-reach, reach), width=_SIZE + 12, height=_SIZE,
    )
    figure.dots(points[:, :2].tolist(), "cloud")
    figure.circle((0, 0), 1.0, "unit")
    return figure


def _sheet(results: Table) -> Sheet:
    """Return a column for each calibrator: three of them and sixteen numbers are higher than wide."""
    columns = [(each.name.replace("_", " "), each.unit, results.column(each.name)) for each in results.columns]
    (_, _, names), *others = columns
    rows = [[f"{name} [{unit}]" if unit else name, *written(cells)] for name, unit, cells in others]
    return Sheet("Calibrations that the board fitted", ["quantity", *map(str, names)], rows)
