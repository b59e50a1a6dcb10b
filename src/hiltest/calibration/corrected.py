"""`corrected`: the fit of `direct` with the bias of noise taken out (adjusted least squares), in float64.

Notes
-----
Noise in the points is noise in the rows of the equations too, so least squares of a quadric is biased: its ellipsoid
shrinks, and where part of the sphere is missing it also leans. Adjusted least squares (Kukush, Markovsky and Van
Huffel, Consistent estimation in an implicit quadratic measurement error model, 2004) replaces each sum of a monomial
by one whose expectation is the sum over the true points. For ``x = x0 + n``, n normal with variance s, these are the
Hermite polynomials of variance s::

    [1] = 1    [x] = x    [x^2] = x^2 - s    [x^3] = x^3 - 3 s x    [x^4] = x^4 - 6 s x^2 + 3 s^2

and with independent noise on the axes ``[x^i y^j z^k] = [x^i] [y^j] [z^k]``. All are linear in the 34 moments, so the
correction costs nothing per point.

s itself is unknown. Over the true points the smallest sum of squares of ``D(p) = p' A p + g . p + j``, ``tr A = 1``,
is zero: s is the root of ``J(s) = min over (A, g, j) of [sum D^2]``. Since ``d[m]/ds = -1/2 [laplacian m]``, and D's
laplacian is 2 and [sum D] zero at the minimum, ``J'(s) = -[sum |grad D|^2]``, and Newton's step from the quadric
fitted at s is::

    s <- s + [sum D^2] / [sum |grad D|^2],    |grad D|^2 = 4 p' A^2 p + 4 g' A p + |g|^2

From s = 0, the fit of `direct`, the first step is the mean square of the algebraic distance over that of its slope.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from hiltest.calibration.direct import direction_variance, fit_about, fit_direct, inverse_factors
from hiltest.calibration.fit import (
    BIAS_LEFT,
    COVERAGE_LIMIT,
    COVERAGE_SINGULAR,
    LARGEST_DIRECTION_ERROR_DEG,
    Array,
    FitStatus,
    MagnetometerFit,
    half_range,
    largest_pivot_ratio,
    mid_range,
    points_array,
)
from hiltest.calibration.quadric import Quadric, calibration_from_quadric, quadric_from_coefficients

# Simulated at 2.5 uT and 1000 points: median error 1.03 degrees without a step, 0.496 after one, 0.489 after two,
# and the same after any more.
NEWTON_STEPS = 2
# With fewer points the added variance outweighs the removed bias.
FEWEST_POINTS = 50
# Noise in calibrated readings, rms of an axis, relative to their norm of 1, from which the sums without it are so much
# smaller that the error is predicted again from them. Of 15 conditions (50 to 1000 points, 4 to 8 uT), prediction over
# error is 0.8 to 1.2 in the median then; from the sums with noise it lets 41 of 75 fits by that err by more than 5 deg.
LARGE_NOISE = 0.1
# A variance that leaves no ellipsoid is too large. These steps together shrink it to 6 %, which would correct nothing.
SHRINK = 0.7
SHRINKS = 8

# Points whose powers are in memory at once: 10 MB.
_AT_ONCE = 50_000
# Exponents of x, y, z in the monomials of a quadric, in the order of `quadric_from_coefficients`.
_EXPONENTS = np.array(
    [(2, 0, 0), (0, 2, 0), (0, 0, 2), (1, 1, 0), (1, 0, 1), (0, 1, 1), (1, 0, 0), (0, 1, 0), (0, 0, 1), (0, 0, 0)]
)
_PRODUCTS = tuple(np.moveaxis(_EXPONENTS[:, None] + _EXPONENTS, -1, 0))
# From the monomials to the rows of `direct`, (x^2 - z^2, y^2 - z^2, xy, xz, yz, x, y, z, 1), followed by z^2.
_UNIT_TRACE = np.eye(10)[[0, 1, 3, 4, 5, 6, 7, 8, 9, 2]] - np.outer([1, 1, *[0] * 8], np.eye(10)[2])


def fit_corrected(
    points_counts: ArrayLike, *, largest_error_deg: float = LARGEST_DIRECTION_ERROR_DEG
) -> MagnetometerFit:
    """Fit the quadric of unit trace without the bias that noise makes, and calibrate by it.

    Parameters
    ----------
    points_counts : shape (n, 3)
        Raw points [counts], body frame, with noise of one variance on all axes.
    largest_error_deg
        See `fit_direct`.

    Returns
    -------
    MagnetometerFit
        Fit with `iterations` Newton steps on the noise's variance. With 0 it is the fit of `direct`: if the points have
        no ellipsoid, cover less than about half of the sphere, or have too large a predicted error with a quarter of
        its bias; for fewer than 50 points, if the corrected sums have no ellipsoid, and if for noise of a tenth of the
        field or more the error predicted from these sums is too large. Its coverage is always that of `direct`.
    """
    points = points_array(points_counts)
    if len(points) < FEWEST_POINTS:
        return fit_direct(points, largest_error_deg=largest_error_deg)
    anchor, unit = mid_range(points), half_range(points)
    least_squares = fit_about(points, anchor, bias_share=BIAS_LEFT, largest_error_deg=largest_error_deg)
    if not least_squares.has_fit:
        return least_squares  # `direct`, which counts all of its bias, refuses these points too
    adjusted = None
    if least_squares.coverage <= COVERAGE_LIMIT:
        adjusted = _newton(power_sums((points - anchor) / unit))
    if adjusted is None or not adjusted.is_accurate(largest_error_deg):
        return fit_direct(points, largest_error_deg=largest_error_deg)
    return MagnetometerFit(
        FitStatus.ELLIPSOID,
        False,
        NEWTON_STEPS,
        adjusted.soft_iron / unit,
        anchor + unit * adjusted.centre,
        least_squares.coverage,
    )


@dataclass(frozen=True, slots=True, eq=False)
class _Adjusted:
    """Calibration for a variance of the noise, and the next Newton step; in half ranges."""

    variance: float
    newton_step: float
    quadric: Quadric
    scatter: Array
    """Shape (10, 10). Corrected sums of the products of the quadric's monomials."""
    soft_iron: Array
    centre: Array

    @property
    def relative_noise(self) -> float:
        """Noise of calibrated readings, rms of an axis [1]."""
        return math.sqrt(self.variance * float((self.soft_iron**2).sum()) / 3.0)

    @property
    def predicted_error_deg(self) -> float:
        """Prediction of the rms error of directions from the corrected sums [deg].

        Noise of variance s adds ``s [sum |grad D|^2]`` to a sum of D^2 that is zero without it.
        """
        level = float(self.centre @ self.quadric.shape @ self.centre) - self.quadric.constant
        predicted = direction_variance(
            self.scatter[9, 9],
            self.scatter[6:9, 9],
            self.variance * _squared_slopes(self.quadric, self.scatter),
            self.centre,
            level,
            *inverse_factors(_normal_equations(self.scatter)[:9, :9]),
            bias_share=BIAS_LEFT,
        )
        return math.degrees(math.sqrt(float(predicted)))

    def is_accurate(self, largest_error_deg: float) -> bool:
        """Return whether the noise is small, so that the prediction of `direct` holds, or the predicted error is."""
        return self.relative_noise < LARGE_NOISE or self.predicted_error_deg <= largest_error_deg


def calibration_from_sums(sums: Array, *, unbiased: bool) -> tuple[Array, Array] | None:
    """Return the fit of `corrected`, or of `direct` if not unbiased, from power sums of points.

    Parameters
    ----------
    sums : shape (5, 5, 5)
        `power_sums` of points about their middle, of size 1. Those of parts of a log add up to those of the whole.

    Returns
    -------
    soft_iron : ndarray, shape (3, 3)
    centre : ndarray, shape (3,)
        Both are None without an ellipsoid.
    """
    adjusted = _newton(sums) if unbiased else None
    if adjusted is None:
        adjusted = _solve(sums, 0.0)
    return None if adjusted is None else (adjusted.soft_iron, adjusted.centre)


def _newton(sums: Array) -> _Adjusted | None:
    """Apply Newton steps from zero noise; return None without an ellipsoid."""
    adjusted = _solve(sums, 0.0)
    for _ in range(NEWTON_STEPS):
        if adjusted is not None:
            adjusted = _largest_ellipsoid(sums, max(0.0, adjusted.variance + adjusted.newton_step))
    return adjusted


def power_sums(points: Array) -> Array:
    """Return the sums of ``x^i y^j z^k`` over points, shape (n, 3), at [i, j, k], shape (5, 5, 5)."""
    sums = np.zeros((25, 5))
    for start in range(0, len(points), _AT_ONCE):
        x, y, z = (points[start : start + _AT_ONCE].T[:, :, None] ** np.arange(5)).astype(np.float64)
        sums += (x[:, :, None] * y[:, None, :]).reshape(-1, 25).T @ z
    return sums.reshape(5, 5, 5)


def _denoised_sums(sums: Array, variance: float) -> Array:
    """Return the expected power sums without noise, by the Hermite polynomials."""
    hermite = np.eye(5)
    hermite[2, 0], hermite[3, 1], hermite[4, 2] = -variance, -3.0 * variance, -6.0 * variance
    hermite[4, 0] = 3.0 * variance**2
    corrected: Array = np.einsum("ai,bj,ck,ijk->abc", hermite, hermite, hermite, sums, optimize=True)
    return corrected


def _largest_ellipsoid(sums: Array, variance: float) -> _Adjusted | None:
    """Solve at a variance, or at the largest reduced one that gives an ellipsoid."""
    for shrinks in range(SHRINKS + 1):
        adjusted = _solve(sums, variance * SHRINK**shrinks)
        if adjusted is not None:
            return adjusted
    return None


def _solve(sums: Array, variance: float) -> _Adjusted | None:
    """Fit the quadric to sums corrected for a variance; return None if it is not an ellipsoid."""
    scatter = _denoised_sums(sums, variance)[_PRODUCTS]
    rows = _normal_equations(scatter)
    normal = rows[:9, :9]
    if not largest_pivot_ratio(normal) < COVERAGE_SINGULAR:
        return None
    coefficients = np.append(np.linalg.solve(normal, -rows[:9, 9]), 1.0) @ _UNIT_TRACE
    quadric = quadric_from_coefficients(coefficients, unit=1.0)
    calibration = None if quadric is None else calibration_from_quadric(quadric)
    if quadric is None or calibration is None:
        return None
    squares = float(coefficients @ scatter @ coefficients)
    return _Adjusted(variance, squares / _squared_slopes(quadric, scatter), quadric, scatter, *calibration)


def _normal_equations(scatter: Array) -> Array:
    """Return the products of the nine rows of `direct`, and of the target's negative, shape (10, 10)."""
    rows: Array = _UNIT_TRACE @ scatter @ _UNIT_TRACE.T
    return rows


def _squared_slopes(quadric: Quadric, scatter: Array) -> float:
    """Return the sum of ``|grad D|^2`` over the points of a scatter matrix."""
    second, first, count = scatter[6:9, 6:9], scatter[6:9, 9], scatter[9, 9]
    by_shape = quadric.shape @ (second @ quadric.shape + np.outer(first, quadric.linear))
    return float(4.0 * np.trace(by_shape) + count * quadric.linear @ quadric.linear)
