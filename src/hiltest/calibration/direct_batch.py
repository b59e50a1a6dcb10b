"""`direct` over many instances at once, along leading axes."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from hiltest.calibration.batch import BatchFit
from hiltest.calibration.direct import direction_variance
from hiltest.calibration.fit import (
    COVERAGE_SINGULAR,
    ELLIPSOID_UNKNOWNS,
    LARGEST_DIRECTION_ERROR_DEG,
    SMALLEST_DETERMINANT,
    Array,
    FitStatus,
    clouds_array,
)

_AT_ONCE = 128  # instances whose rows and normal equations fit in the processor's cache: 1 MB at 100 points


@dataclass(frozen=True, slots=True, eq=False)
class QuadricBatch:
    """Least-squares quadrics of unit trace, ``(p - centre)' shape (p - centre) = level``, of any type."""

    shape: Array
    """Shape (..., 3, 3). Symmetric [1]."""
    centre: Array
    """Shape (..., 3) [counts]; not finite where `shape` is singular."""
    level: Array
    """Shape (...) [counts^2]."""
    coverage: Array
    """Shape (...). See `MagnetometerFit`."""
    direction_variance: Array
    """Shape (...). See `hiltest.calibration.direct.direction_variance` [rad^2]."""

    @property
    def is_ellipsoid(self) -> NDArray[np.bool_]:
        """Mask of positive definite shapes with positive level, shape (...), without a margin.

        Sylvester's criterion: all leading minors are positive.
        """
        a, second, determinant = _leading_minors(self.shape)
        return np.asarray((a > 0.0) & (second > 0.0) & (determinant > 0.0) & (self.level > 0.0))


def fit_direct_batch(points_counts: ArrayLike) -> BatchFit:
    """Fit each instance as `fit_direct` does.

    Parameters
    ----------
    points_counts : shape (..., n, 3)
        Raw points [counts], body frame.

    Returns
    -------
    BatchFit
        Fits with the status of the single fit.

    Raises
    ------
    ValueError
        When the shape is another, or a coordinate is not finite.
    """
    points = clouds_array(points_counts)
    if points.shape[-2] < ELLIPSOID_UNKNOWNS:
        status = np.full(points.shape[:-2], FitStatus.TOO_FEW_POINTS, dtype=np.int8)
        return BatchFit(status, np.full((*status.shape, 3, 3), np.nan), np.full((*status.shape, 3), np.nan))
    quadrics = fit_quadrics(points)
    with np.errstate(invalid="ignore"):
        regular = (quadrics.coverage < COVERAGE_SINGULAR) & np.isfinite(quadrics.level)
        is_ellipsoid = quadrics.is_ellipsoid & (_leading_minors(quadrics.shape)[2] > SMALLEST_DETERMINANT)
        accurate = quadrics.direction_variance <= math.radians(LARGEST_DIRECTION_ERROR_DEG) ** 2
    status = np.select(
        [~regular, ~is_ellipsoid, ~accurate],
        [FitStatus.SINGULAR, FitStatus.NOT_AN_ELLIPSOID, FitStatus.POOR_COVERAGE],
        FitStatus.ELLIPSOID,
    )
    good = status == FitStatus.ELLIPSOID
    soft_iron = np.full(quadrics.shape.shape, np.nan)
    eigenvalues, vectors = np.linalg.eigh(quadrics.shape[good])
    scaled = vectors * np.sqrt(eigenvalues / quadrics.level[good][:, None])[:, None, :]
    soft_iron[good] = scaled @ np.swapaxes(vectors, -1, -2)
    return BatchFit(status.astype(np.int8), soft_iron, np.where(good[..., None], quadrics.centre, np.nan))


def fit_quadrics(points_counts: ArrayLike) -> QuadricBatch:
    """Fit quadrics of unit trace by linear least squares, over leading axes.

    Parameters
    ----------
    points_counts : shape (..., n, 3)
        At least 9 points [counts] per instance.

    Notes
    -----
    The equations are those of `fit_direct`. One product of each instance's rows with themselves contains the normal
    equations, which are then solved for all instances at once, one unknown after the other.
    """
    points = clouds_array(points_counts)
    leading = points.shape[:-2]
    clouds = points.reshape(-1, *points.shape[-2:])
    parts = [_fit_chunk(clouds[first : first + _AT_ONCE]) for first in range(0, max(len(clouds), 1), _AT_ONCE)]
    shape, centre, *scalars = (np.concatenate(part) for part in zip(*parts, strict=True))
    level, coverage, variance = (scalar.reshape(leading) for scalar in scalars)
    return QuadricBatch(shape.reshape(*leading, 3, 3), centre.reshape(*leading, 3), level, coverage, variance)


def _fit_chunk(points: Array) -> tuple[Array, Array, Array, Array, Array]:
    """Return shape, centre, level, coverage and direction variance of instances, points of shape (m, n, 3)."""
    across = np.ascontiguousarray(np.moveaxis(points, -1, 0))  # one contiguous table per axis: (3, m, n)
    low, high = across.min(axis=-1), across.max(axis=-1)
    anchor = np.trunc((low + high) / 2.0)
    unit = (high - low).max(axis=0) / 2.0
    with np.errstate(divide="ignore", invalid="ignore", over="ignore"):
        x, y, z = (across - anchor[..., None]) / unit[:, None]
        rows = np.empty((len(points), 10, points.shape[1]))
        square = z * z
        for place, row in enumerate((x * x - square, y * y - square, x * y, x * z, y * z, x, y, z, 1.0, -square)):
            rows[:, place] = row
        theta, constant, pivots, residual, coverage = _solve(rows @ np.swapaxes(rows, -1, -2))
        a, b, d, e, f, g, h, i, j = theta
        c = 1.0 - a - b
        shape = np.array([[a, d / 2, e / 2], [d / 2, b, f / 2], [e / 2, f / 2, c]])
        linear = np.array([g, h, i])
        centre = -0.5 * np.einsum("ijm,jm->im", _inverse(shape), linear)
        level = -0.5 * (centre * linear).sum(axis=0) - j
        total = rows[:, 5:8].sum(axis=-1).T
        variance = direction_variance(points.shape[1], total, residual, centre, level, constant, pivots)
        coverage = np.where(unit > 0.0, coverage, COVERAGE_SINGULAR)
    return np.moveaxis(shape, -1, 0), (anchor + centre * unit).T, level * unit**2, coverage, variance


def _solve(products: Array) -> tuple[Array, Array, Array, Array, Array]:
    """Solve ``M theta = w`` by L D L^T.

    Parameters
    ----------
    products : shape (m, 10, 10)
        ``[[M, w], [w', .]]``.

    Returns
    -------
    theta, constant, pivots : ndarray, shape (9, m)
        Solution, the last column of the inverse of M, and the pivots.
    residual : ndarray, shape (m,)
        Sum of the squares that the solution leaves.
    coverage : ndarray, shape (m,)
        See `largest_pivot_ratio`.
    """
    rest = np.ascontiguousarray(np.moveaxis(products, 0, -1))  # instances last, so that steps process all
    unknowns = len(rest) - 1
    coverage = np.ones(rest.shape[-1])
    diagonal = rest[range(unknowns), range(unknowns)].copy()
    for i in range(unknowns):
        pivot = rest[i, i].copy()
        ratio = np.where(pivot * COVERAGE_SINGULAR > diagonal[i], diagonal[i] / pivot, COVERAGE_SINGULAR)
        coverage = np.maximum(coverage, ratio)
        factors = rest[i, i + 1 :] / pivot
        for k in range(i + 1, unknowns):  # only above the diagonal
            rest[k, k:] -= factors[k - i - 1] * rest[i, k:]
        rest[unknowns, unknowns] -= pivot * factors[-1] ** 2
        rest[i, i + 1 :] = factors  # its last is w / d
    theta, constant = rest[:unknowns, unknowns].copy(), np.zeros((unknowns, rest.shape[-1]))
    constant[-1] = 1.0 / rest[unknowns - 1, unknowns - 1]
    for i in reversed(range(unknowns - 1)):
        theta[i] -= (rest[i, i + 1 : unknowns] * theta[i + 1 :]).sum(axis=0)
        constant[i] -= (rest[i, i + 1 : unknowns] * constant[i + 1 :]).sum(axis=0)
    return theta, constant, rest[range(unknowns), range(unknowns)], rest[unknowns, unknowns], coverage


def _leading_minors(shape: Array) -> tuple[Array, Array, Array]:
    a, b, c = shape[..., 0, 0], shape[..., 1, 1], shape[..., 2, 2]
    d, e, f = shape[..., 0, 1], shape[..., 0, 2], shape[..., 1, 2]
    second = a * b - d * d
    return a, second, second * c - (a * f * f - 2.0 * d * e * f + b * e * e)


def _inverse(shape: Array) -> Array:
    """Return the inverses of symmetric matrices, shape (3, 3, m), by their cofactors."""
    (a, d, e), (_, b, f), (_, _, c) = shape
    cofactors = np.array(
        [
            [b * c - f * f, e * f - c * d, d * f - b * e],
            [e * f - c * d, a * c - e * e, d * e - a * f],
            [d * f - b * e, d * e - a * f, a * b - d * d],
        ]
    )
    determinant = a * cofactors[0, 0] + d * cofactors[0, 1] + e * cofactors[0, 2]
    inverse: Array = cofactors / determinant
    return inverse
