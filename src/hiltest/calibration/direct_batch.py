"""The quadrics of `direct` over many instances at once, along leading axes."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from hiltest.calibration.fit import Array, clouds_array

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

    @property
    def is_ellipsoid(self) -> NDArray[np.bool_]:
        """Mask of positive definite shapes with positive level, shape (...), without a margin.

        Sylvester's criterion: all leading minors are positive.
        """
        a, second, determinant = _leading_minors(self.shape)
        return np.asarray((a > 0.0) & (second > 0.0) & (determinant > 0.0) & (self.level > 0.0))


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
    shape, centre, level = (np.concatenate(part) for part in zip(*parts, strict=True))
    return QuadricBatch(shape.reshape(*leading, 3, 3), centre.reshape(*leading, 3), level.reshape(leading))


def _fit_chunk(points: Array) -> tuple[Array, Array, Array]:
    """Return shape, centre and level of instances, points of shape (m, n, 3)."""
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
        a, b, d, e, f, g, h, i, j = _solve(rows @ np.swapaxes(rows, -1, -2))
        c = 1.0 - a - b
        shape = np.array([[a, d / 2, e / 2], [d / 2, b, f / 2], [e / 2, f / 2, c]])
        linear = np.array([g, h, i])
        centre = -0.5 * np.einsum("ijm,jm->im", _inverse(shape), linear)
        level = -0.5 * (centre * linear).sum(axis=0) - j
    return np.moveaxis(shape, -1, 0), (anchor + centre * unit).T, level * unit**2


def _solve(products: Array) -> Array:
    """Solve ``M theta = w`` by L D L^T; return theta, shape (9, m), from ``[[M, w], [w', .]]``, shape (m, 10, 10)."""
    rest = np.ascontiguousarray(np.moveaxis(products, 0, -1))  # instances last, so that steps process all
    unknowns = len(rest) - 1
    for i in range(unknowns):
        factors = rest[i, i + 1 :] / rest[i, i]
        for k in range(i + 1, unknowns):  # only above the diagonal
            rest[k, k:] -= factors[k - i - 1] * rest[i, k:]
        rest[i, i + 1 :] = factors  # its last is w / d
    theta: Array = rest[:unknowns, unknowns].copy()
    for i in reversed(range(unknowns - 1)):
        theta[i] -= (rest[i, i + 1 : unknowns] * theta[i + 1 :]).sum(axis=0)
    return theta


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
