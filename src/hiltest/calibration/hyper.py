"""`hyper`: hyper least squares, whose normalisation leaves no bias up to the second order of the noise, in float64.

Notes
-----
Noise of variance s in the points makes ``E[S] = S0 + s N0 + O(s^2)`` with ``N0 = mean of (1/2 laplacian m m')``, that
is ``mean of (V + e m' + m e')`` with ``V = grad m grad m'`` summed over the axes and e the half laplacian of m: 1 for
squares, else 0. ``N = N0`` would leave a bias that falls with the number of points n; Kanatani and Rangarajan (Hyper
least squares fitting of circles and ellipses, 2011, eq. 41) take it out as well::

    N = N0 - 1/n mean of ( tr(S^- V) m m' + (m' S^- m) V + V S^- m m' + m m' S^- V )

S^- is the pseudoinverse without the smallest eigenvalue, which depends on the weights of the monomials: with ``sqrt2
xy`` instead of the paper's 2 xy it rotates with the points, and so does the fit. `corrected` removes higher powers of s
from S, and estimates s itself.
"""

from __future__ import annotations

import numpy as np

from hiltest.calibration.algebraic import algebraic, derivatives, slope_products
from hiltest.calibration.clouds import Clouds, mean_products
from hiltest.calibration.fit import Array


def _constraint(clouds: Clouds) -> Array:
    scatter, rows, along = clouds.scatter, clouds.rows, derivatives(clouds.axes)
    half_laplacian = (along @ along).sum(axis=0) / 2.0 @ scatter
    inverse = _pseudoinverse(scatter, clouds.axes)
    weighted = rows @ inverse
    by_length = slope_products(mean_products(rows, (weighted * rows).sum(axis=-1)), clouds.axes)
    by_slope, mixed = np.zeros_like(scatter), np.zeros_like(scatter)
    for matrix in along:
        slopes = rows @ matrix.T
        by_slope += mean_products(rows, ((slopes @ inverse) * slopes).sum(axis=-1))
        mixed += matrix @ mean_products(rows, (slopes * weighted).sum(axis=-1))
    first = slope_products(scatter, clouds.axes) + _symmetric(half_laplacian)
    constraint: Array = first - (by_slope + by_length + _symmetric(mixed)) / rows.shape[-2]
    return constraint


def _pseudoinverse(scatter: Array, axes: int) -> Array:
    """Return the inverse without the smallest eigenvalue, for monomials that rotate with the points."""
    squares = axes * (axes + 1) // 2
    weights = np.ones(scatter.shape[-1])
    weights[axes:squares] = np.sqrt(2.0)
    values, vectors = np.linalg.eigh(scatter * np.outer(weights, weights))
    scaled = vectors[..., 1:] * weights[:, None]
    return np.asarray((scaled / values[..., None, 1:]) @ np.swapaxes(scaled, -1, -2))


def _symmetric(matrix: Array) -> Array:
    """Return the sum of a matrix and its transpose."""
    return np.asarray(matrix + np.swapaxes(matrix, -1, -2))


fit_hyper = algebraic(_constraint)
