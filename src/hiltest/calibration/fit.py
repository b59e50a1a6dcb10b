"""Result of a magnetometer calibrator, the same as the firmware's `magnetometer_fit_t`."""

from __future__ import annotations

from dataclasses import dataclass
from enum import IntEnum
from typing import Protocol, TypeAlias

import numpy as np
from numpy.typing import ArrayLike, NDArray

Array: TypeAlias = NDArray[np.float64]

# Limits that decide a status. The firmware has the same, for the same reasons.
ELLIPSOID_UNKNOWNS = 9
COVERAGE_SINGULAR = 1e6
SMALLEST_DETERMINANT = 1e-6
# Largest pivot ratio that packed sums and Newton steps can carry. Simulated on the mid-range anchor at 0.4 uT: at most
# 1.7 for a full sphere, 6 to 30 for half of one, 31 to 158 for 30 % of one.
COVERAGE_LIMIT = 30.0
#: A fit whose predicted rms error of directions is larger is refused.
LARGEST_DIRECTION_ERROR_DEG = 5.0
#: Part of the bias of least squares to count for calibrators that remove it, and for those of the literature.
BIAS_LEFT = 0.25


class FitStatus(IntEnum):
    """Status of a fit; the values from 0 are those of the link protocol."""

    REFUSED = -1
    """A package's calibrator returned None."""
    ELLIPSOID = 0
    NOT_AN_ELLIPSOID = 1
    POOR_COVERAGE = 2
    TOO_FEW_POINTS = 3
    SINGULAR = 4
    NOT_CONVERGED = 5
    HORIZONTAL_FIELD = 6
    MIRRORED = 7


_WITH_A_FIT = frozenset({FitStatus.ELLIPSOID, FitStatus.NOT_CONVERGED})


@dataclass(frozen=True, slots=True, eq=False)
class MagnetometerFit:
    """A magnetometer calibration and the status of its fit."""

    status: FitStatus
    is_sphere: bool
    """True if this is a sphere fit: it was asked for by name, or a stream calibrator has too few points for more."""
    iterations: int
    """Sweeps of the firmware's solver; 0 for a closed form and for a float64 reference."""
    soft_iron: Array
    """Shape (3, 3) [1/count]; ``soft_iron @ (counts - hard_iron)`` has norm 1 for a good point. Symmetric from a
    fit of norms."""
    hard_iron: Array
    """Shape (3,) [counts], body frame."""
    coverage: float = 0.0
    """Largest ``M_ii / d_i`` of the normal equations' pivots [1]; 0 for calibrators without it."""

    @property
    def has_fit(self) -> bool:
        """True if soft_iron and hard_iron were fitted to the points."""
        return self.is_sphere or self.status in _WITH_A_FIT

    @property
    def radius(self) -> float:
        """Radius of the sphere with the volume of the ellipsoid [counts]: the strength of the field."""
        return float(abs(np.linalg.det(self.soft_iron)) ** (-1.0 / 3.0))

    def corrected(self, points_counts: ArrayLike) -> Array:
        """Return the corrected points, shape (n, 3) [1], norm 1 for good points."""
        points = np.asarray(points_counts, dtype=np.float64)
        corrected: Array = (points - self.hard_iron) @ self.soft_iron.T
        return corrected


class Calibrator(Protocol):
    """A magnetometer calibrator."""

    def __call__(
        self, points_counts: ArrayLike, *, largest_error_deg: float = LARGEST_DIRECTION_ERROR_DEG
    ) -> MagnetometerFit:
        """Calibrate from points, shape (n, 3) [counts], and refuse a fit with a larger predicted error."""


def no_fit(status: FitStatus, *, coverage: float = 0.0) -> MagnetometerFit:
    """Return a status without a calibration: identity and zero."""
    return MagnetometerFit(status, False, 0, np.eye(3), np.zeros(3), coverage)


def points_array(points_counts: ArrayLike, *, axes: tuple[int, ...] = (3,), leading: str = "") -> Array:
    """Return points as float64, shape (n, 3), or with another number of axes that is allowed.

    Parameters
    ----------
    leading
        ``..., `` to allow leading axes, for the points of many instances.

    Raises
    ------
    ValueError
        When the shape is another, or a coordinate is not finite.
    """
    points = np.asarray(points_counts, dtype=np.float64)
    if points.ndim < 2 or (points.ndim > 2 and not leading) or points.shape[-1] not in axes:
        raise ValueError(f"points have shape {points.shape}, not ({leading}n, {' or '.join(map(str, axes))})")
    if not np.isfinite(points).all():
        raise ValueError("points are not finite")
    return points


def squared_lengths(vectors: Array) -> Array:
    """Return the squared lengths of vectors, shape (n, 2) or (n, 3): numpy's sum along rows is five times slower."""
    lengths: Array = sum(column * column for column in vectors.T)
    return lengths


def clouds_array(points_counts: ArrayLike, *, axes: tuple[int, ...] = (3,)) -> Array:
    """Return points of instances along leading axes as float64, shape (..., n, 3); see `points_array`."""
    return points_array(points_counts, axes=axes, leading="..., ")


def mid_range(points: Array) -> Array:
    """Return the middle of the points' range, halves truncated towards zero as in the firmware [counts]."""
    middle: Array = np.trunc((points.min(axis=0) + points.max(axis=0)) / 2.0)
    return middle


def half_range(points: Array) -> float:
    """Return half of the widest axis range [counts]."""
    return float(np.ptp(points, axis=0).max()) / 2.0


def largest_pivot_ratio(normal: Array) -> float:
    """Return the largest ``M_ii / d_i`` over the pivots of an L D L^T factorisation.

    Parameters
    ----------
    normal : shape (n, n)
        Symmetric, positive semidefinite; its order of rows matters.

    Returns
    -------
    float
        At least 1, which is reached when all columns are orthogonal;
        `COVERAGE_SINGULAR` when a pivot is not positive or smaller than 1/1e6 of its
        diagonal element.

    Notes
    -----
    ``d_i / M_ii`` is the part of column i that the columns before it do not explain.
    The ratio does not change when columns are scaled.
    """
    rest = normal.astype(float)
    worst = 1.0
    for i in range(len(rest)):
        pivot = float(rest[i, i])
        diagonal = float(normal[i, i])
        if not pivot * COVERAGE_SINGULAR > diagonal:
            return COVERAGE_SINGULAR
        worst = max(worst, diagonal / pivot)
        rest[i + 1 :, i + 1 :] -= rest[i + 1 :, i, None] * rest[None, i, i + 1 :] / pivot
    return worst
