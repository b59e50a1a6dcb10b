"""The sphere as the cylinder around it, which keeps areas: what a corrected cloud covers, and what it does not."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from hiltest.calibration.solid_angle import SPHERE, covered_directions
from hiltest.report.marks import KeyEntry, Mark
from hiltest.report.svg import Figure, Point

Array = NDArray[np.float64]

READING = KeyEntry("a reading", "", Mark.DOT, "level filled")


def coverage_map(corrected: Array, shown: Array) -> Figure:
    """Draw which part of the sphere a cloud covers, by the rule that calibrations of clouds are judged by.

    Parameters
    ----------
    corrected, shown : ndarray, shape (n, 3)
        All corrected points, and those that are drawn.
    """
    covered = covered_directions(corrected)
    return _sphere_map(
        f"coverage: {100.0 * covered.mean():.0f} % of the sphere",
        "Directions of the corrected points on an equal-area map; marked where none is near",
        "no reading near", SPHERE[~covered], shown, 460.0, 260.0,
    )


def hole_map(corrected: Array, *, width: float, height: float) -> Figure:
    """Draw where the points of a tumble lie, and the largest cap of the sphere that holds none of them.

    Parameters
    ----------
    corrected : ndarray, shape (n, 3)
    width, height : float
        Of the drawing.
    """
    lengths = np.linalg.norm(corrected, axis=1)
    directions = corrected[lengths > 0.0] / lengths[lengths > 0.0, None]
    nearest = (SPHERE @ directions.T).max(axis=1) if len(directions) else np.full(len(SPHERE), -1.0)
    middle = int(nearest.argmin())
    hole = SPHERE[SPHERE @ SPHERE[middle] >= nearest[middle]]
    radius_deg = float(np.degrees(np.arccos(np.clip(nearest[middle], -1.0, 1.0))))
    return _sphere_map(
        f"coverage: the largest hole is {radius_deg:.0f}° in radius",
        f"Directions of {len(corrected)} corrected points on an equal-area map; the largest cap without one is marked",
        "largest hole", hole, corrected, width, height,
    )


def _sphere_map(
    title: str, description: str, word: str, marked: Array, shown: Array, width: float, height: float
) -> Figure:
    figure = Figure(
        title=title, description=description, x_label="azimuth in the sensor's axes [deg]",
        y_label="sine of the elevation", x_range=(-180, 180), y_range=(-1, 1), x_ticks=(-180, -90, 0, 90, 180),
        width=width, height=height, key=[READING, KeyEntry(word, "hole")],
    )
    figure.dots(_on_map(marked), "hole")
    figure.dots(_on_map(shown), "cloud")
    return figure


def _on_map(directions: Array) -> list[Point]:
    lengths = np.linalg.norm(directions, axis=1)
    directions = directions[lengths > 0.0] / lengths[lengths > 0.0, None]
    azimuths = np.degrees(np.arctan2(directions[:, 1], directions[:, 0]))
    return list(zip(azimuths.tolist(), directions[:, 2].tolist(), strict=True))
