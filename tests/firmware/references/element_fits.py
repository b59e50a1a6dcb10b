"""The fits of 4, 7 and 10 elements that the public sensor-fusion libraries go through, in float64."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from hiltest.calibration.fit import Array, mid_range, points_array
from hiltest.calibration.iterative import SECOND_SMALLEST
from hiltest.calibration.quadric import calibration_from_quadric, quadric_from_coefficients

# Coordinates are divided by what 50 uT are in counts, whatever the field is.
UNIT_COUNTS = 500.0
WEAKEST_COUNTS = 100.0
STRONGEST_COUNTS = 900.0


@dataclass(frozen=True, slots=True, eq=False)
class Trial:
    """A calibration that may be taken over.

    Attributes
    ----------
    soft_iron : ndarray, shape (3, 3)
        [1/count].
    hard_iron : ndarray, shape (3,)
        [counts].
    fit_error_percent : float
        About the relative rms deviation of the points from the surface.
    """

    soft_iron: Array
    hard_iron: Array
    fit_error_percent: float


def fit_elements(points_counts: ArrayLike, elements: int) -> Trial | None:
    """Fit a sphere (4 elements), an ellipsoid along the axes (7) or any ellipsoid (10).

    Parameters
    ----------
    points_counts : array_like, shape (n, 3)
        Raw points [counts].
    elements : {4, 7, 10}

    Returns
    -------
    Trial or None
        None when it is no ellipsoid, or its field is not 10 to 90 uT.

    Notes
    -----
    4: least squares of ``|p|^2 = beta . (x, y, z, 1)``, fit error ``100 sqrt(E / n) / (2 B^2)`` with E the
    sum of squared residuals. 7 and 10: the unit eigenvector of the smallest eigenvalue lambda of the scatter
    matrix, fit error ``50 sqrt(|lambda| / n) / B^2`` with B^2 in that vector's scale.
    """
    points = points_array(points_counts)
    anchor = mid_range(points)
    relative = (points - anchor) / UNIT_COUNTS
    trial = _sphere(relative) if elements == 4 else _ellipsoid(relative, elements)
    if trial is None:
        return None
    field_counts = np.linalg.det(trial.soft_iron) ** (-1.0 / 3.0) * UNIT_COUNTS
    if not WEAKEST_COUNTS <= field_counts <= STRONGEST_COUNTS:
        return None
    return Trial(trial.soft_iron / UNIT_COUNTS, anchor + trial.hard_iron * UNIT_COUNTS, trial.fit_error_percent)


def _sphere(points: Array) -> Trial | None:
    rows = np.column_stack([points, np.ones(len(points))])
    target = (points**2).sum(axis=1)
    beta, _, rank, _ = np.linalg.lstsq(rows, target, rcond=None)
    centre = beta[:3] / 2.0
    square = float(beta[3] + centre @ centre)
    if rank < 4 or not square > 0.0:
        return None
    error = float(((target - rows @ beta) ** 2).mean())
    return Trial(np.eye(3) / np.sqrt(square), centre, 50.0 * np.sqrt(error) / square)


def _ellipsoid(points: Array, elements: int) -> Trial | None:
    x, y, z = points.T
    one = np.ones(len(points))
    cross = [2 * x * y, 2 * x * z, 2 * y * z] if elements == 10 else []
    rows = np.column_stack([x * x, y * y, z * z, *cross, x, y, z, one])
    eigenvalues, vectors = np.linalg.eigh(rows.T @ rows)
    if not eigenvalues[1] > SECOND_SMALLEST * eigenvalues.sum():
        return None
    vector = vectors[:, 0]
    mixed = 2.0 * vector[3:-4] if elements == 10 else np.zeros(3)
    quadric = quadric_from_coefficients(np.array([*vector[:3], *mixed, *vector[-4:]]), unit=1.0)
    calibration = None if quadric is None else calibration_from_quadric(quadric)
    if quadric is None or calibration is None:
        return None
    soft_iron, centre = calibration
    level = float(centre @ quadric.shape @ centre) - quadric.constant
    square = level * abs(float(vector[:3].sum()))
    return Trial(soft_iron, centre, 50.0 * float(np.sqrt(abs(eigenvalues[0]) / len(points))) / square)
