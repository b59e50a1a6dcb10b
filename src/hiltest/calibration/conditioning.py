"""Conditioning of an ellipsoid fit: how well points determine it, however the sensor is turned."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Self

import numpy as np
from numpy.typing import ArrayLike

from hiltest.calibration.fit import ELLIPSOID_UNKNOWNS, Array, points_array, squared_lengths

_HALF, _SIXTH = np.sqrt(1.0 / 2.0), np.sqrt(1.0 / 6.0)

#: Orthonormal symmetric matrices without trace, shape (5, 3, 3): together with the identity they span every shape.
TRACELESS = np.array(
    [
        np.diag([_HALF, -_HALF, 0.0]),
        np.diag([_SIXTH, _SIXTH, -2.0 * _SIXTH]),
        [[0.0, _HALF, 0.0], [_HALF, 0.0, 0.0], [0.0, 0.0, 0.0]],
        [[0.0, 0.0, _HALF], [0.0, 0.0, 0.0], [_HALF, 0.0, 0.0]],
        [[0.0, 0.0, 0.0], [0.0, 0.0, _HALF], [0.0, _HALF, 0.0]],
    ]
)
#: The same of a plane, shape (2, 2, 2).
TRACELESS_IN_PLANE = _HALF * np.array([[[1.0, 0.0], [0.0, -1.0]], [[0.0, 1.0], [1.0, 0.0]]])
# Condition number of a singular matrix: beyond the resolution of float64, but finite for JSON.
CONDITION_SINGULAR = 1e15
#: Condition up to which points determine an ellipsoid at all; 30 % of the sphere has more (see `ellipsoid_condition`).
LARGEST_CONDITION = 300.0
#: Condition up to which an ellipsoid is determined in all directions.
WELL_CONDITIONED = 60.0


@dataclass(frozen=True, slots=True, eq=False)
class CentredPoints:
    """Points relative to their mean, divided by the rms of their distance from it."""

    points: Array
    """Shape (n, 3), or (n, 2) in a plane. [1]."""
    mean: Array
    """Shape (3,) or (2,)."""
    scale: float
    """Scale in the unit of the points, like the mean."""

    @classmethod
    def centre(cls, points: ArrayLike) -> Self | None:
        """Centre and scale points, shape (n, 3) or (n, 2); return None if there are none or all are equal."""
        stack = points_array(points, axes=(2, 3))
        if not len(stack):
            return None
        mean: Array = stack.mean(axis=0)
        centred = stack - mean
        scale = float(np.sqrt(squared_lengths(centred).mean()))
        return cls(centred / scale, mean, scale) if scale > 0.0 else None

    def rows(self) -> Array:
        """Return the design matrix of the quadric ``|p|^2 + row . parameters = 0``; see `quadric_rows`."""
        return quadric_rows(self.points)


def traceless(axes: int) -> Array:
    """Return the orthonormal symmetric matrices without trace of space, 3 axes, or of a plane, 2."""
    return TRACELESS if axes == TRACELESS.shape[1] else TRACELESS_IN_PLANE


def quadric_rows(points: Array) -> Array:
    """Return the rows d of ``|p|^2 + d . parameters = 0``, shape (n, 9), or (n, 5) for points in a plane.

    Notes
    -----
    ``((x^2 - y^2) / sqrt2, (x^2 + y^2 - 2 z^2) / sqrt6, sqrt2 xy, sqrt2 xz, sqrt2 yz, x, y, z, 1)``: the quadratic
    ones are ``p' B p`` for the `traceless` B. The trace is that of the identity, so the result is independent of the
    orientation of the axes.
    """
    columns, basis = np.ascontiguousarray(points.T), traceless(points.shape[1])
    rows = np.ones((len(points), len(basis) + len(columns) + 1))
    for place, matrix in enumerate(basis):
        # Term by term, as most are zero.
        rows[:, place] = sum(part * columns[i] * columns[j] for (i, j), part in np.ndenumerate(matrix) if part)
    rows[:, len(basis) : -1] = points
    return rows


def ellipsoid_condition(points: ArrayLike) -> float:
    """Return the condition number of the normal equations of an ellipsoid [1].

    Parameters
    ----------
    points : shape (n, 3)
        Points in any unit.

    Returns
    -------
    float
        7.5 for a whole sphere, less for a ball; `CONDITION_SINGULAR` at most, also for fewer than 9 points.

    Notes
    -----
    It depends only on the points, not on calibrator, unit, origin or rotation of the sensor. Simulated with 100 points,
    0.4 uT, soft iron of 3 % (p1, p50, p99 of 1000): whole sphere 9, 11, 14; 75 % of it 19, 26, 38; 60 % 40, 57, 84;
    half 74, 105, 156; 40 % 150, 214, 317; 30 % 349, 508, 753.
    """
    centred = CentredPoints.centre(points)
    if centred is None or len(centred.points) < ELLIPSOID_UNKNOWNS:
        return CONDITION_SINGULAR
    rows = centred.rows()
    return condition_of(rows.T @ rows)


def condition_of(normal: Array) -> float:
    """Return the condition number of normal equations, symmetric and positive semidefinite; see above."""
    eigenvalues = np.linalg.eigvalsh(normal)
    smallest, largest = float(eigenvalues[0]), float(eigenvalues[-1])
    return largest / smallest if smallest * CONDITION_SINGULAR > largest else CONDITION_SINGULAR
