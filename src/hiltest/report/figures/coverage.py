"""The sphere on an equal-area map (the cylinder around it): what calibrated samples cover, and what they do not."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from hiltest.calibration.solid_angle import SPHERE, covered_directions
from hiltest.report.marks import KeyEntry, Mark
from hiltest.report.svg import Figure, Point

Array = NDArray[np.float64]

SAMPLE = KeyEntry("a sample", "", Mark.DOT, "level filled")


def coverage_map(corrected: Array, shown: Array) -> Figure:
    """Draw which part of the sphere samples cover, by the rule that calibrations of recorded samples are accepted by.

    Parameters
    ----------
    corrected, shown : ndarray, shape (n, 3)
        All calibrated samples, and those that are drawn.
    """
    covered = covered_directions(corrected)
    return _sphere_map(
        f"coverage: {100.0 * covered.mean():.0f} % of the sphere",
        "Directions of the calibrated samples on an equal-area map; marked where none is near",
        KeyEntry("no sample near", "uncovered"), SPHERE[~covered], shown, 460.0, 260.0,
    )


def largest_cap_map(corrected: Array, *, width: float, height: float) -> Figure:
    """Draw where the samples of a tumble lie, and the largest cap of the sphere without one.

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
    cap = SPHERE[SPHERE @ SPHERE[middle] >= nearest[middle]]
    radius_deg = float(np.degrees(np.arccos(np.clip(nearest[middle], -1.0, 1.0))))
    return _sphere_map(
        f"largest uncovered cap: {radius_deg:.0f}° radius",
        f"Directions of {len(corrected)} calibrated samples on an equal-area map: sine of the elevation over azimuth; "
        "the largest cap without one is marked",
        KeyEntry("largest uncovered cap", "uncovered"), cap, corrected, width, height, labelled=False,
    )


def _sphere_map(
    title: str, description: str, entry: KeyEntry, marked: Array, shown: Array, width: float, height: float, *,
    labelled: bool = True,
) -> Figure:
    labels = ("azimuth in the sensor's axes [deg]", "sine of the elevation") if labelled else ("", "")
    figure = Figure(
        title, description, *labels, x_range=(-180, 180), y_range=(-1, 1), x_ticks=(-180, -90, 0, 90, 180),
        width=width, height=height, key=[SAMPLE, entry],
    )
    figure.dots(_on_map(marked), "uncovered")
    figure.dots(_on_map(shown), "samples")
    return figure


def _on_map(directions: Array) -> list[Point]:
    lengths = np.linalg.norm(directions, axis=1)
    directions = directions[lengths > 0.0] / lengths[lengths > 0.0, None]
    azimuths = np.degrees(np.arctan2(directions[:, 1], directions[:, 0]))
    return list(zip(azimuths.tolist(), directions[:, 2].tolist(), strict=True))
