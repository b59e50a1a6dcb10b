"""Pivots of normal equations: how well points determine what is fitted to them."""

from __future__ import annotations

from hiltest.calibration.fit import COVERAGE_SINGULAR, Array


def largest_pivot_ratio(normal: Array) -> float:
    """Return the largest ``M_ii / d_i`` over the pivots of an L D L^T factorisation.

    Parameters
    ----------
    normal : ndarray, shape (n, n)
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
