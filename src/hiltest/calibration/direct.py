"""`direct`: the thesis' algebraic ellipsoid fit with its equations corrected, in float64."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import ArrayLike

from hiltest.calibration.fit import (
    COVERAGE_SINGULAR,
    ELLIPSOID_UNKNOWNS,
    LARGEST_DIRECTION_ERROR_DEG,
    Array,
    FitStatus,
    MagnetometerFit,
    half_range,
    largest_pivot_ratio,
    mid_range,
    no_fit,
    points_array,
)
from hiltest.calibration.quadric import calibration_from_quadric, quadric_from_coefficients

# Of n level^2: the firmware's float32 resolves no smaller sum of squares.
SMALLEST_RESIDUAL = 1e-6


def fit_direct(points_counts: ArrayLike, *, largest_error_deg: float = LARGEST_DIRECTION_ERROR_DEG) -> MagnetometerFit:
    """Fit the quadric of unit trace by linear least squares, and calibrate by it.

    Parameters
    ----------
    points_counts : shape (n, 3)
        Raw points [counts], body frame; at least 10.
    largest_error_deg
        Fits with a larger predicted error are refused; infinity serves to compare estimators.

    Returns
    -------
    MagnetometerFit
        Status ELLIPSOID; or without a fit TOO_FEW_POINTS, SINGULAR, NOT_AN_ELLIPSOID, or POOR_COVERAGE if the
        predicted error of directions exceeds `largest_error_deg`.

    Notes
    -----
    Unknowns (a, b, d, e, f, g, h, i, j) of ``a x^2 + b y^2 + c z^2 + d xy + e xz + f yz + g x + h y + i z + j = 0``
    with ``c = 1 - a - b``; rows ``(x^2 - z^2, y^2 - z^2, xy, xz, yz, x, y, z, 1)``, target ``-z^2`` (Mucciaccia, eq. 36
    ff., with the factors of eq. 45 and 58 to 64 corrected). Coordinates are relative to the middle of their range,
    which makes the pivots a test of coverage.
    """
    points = points_array(points_counts)
    if len(points) < ELLIPSOID_UNKNOWNS:
        return no_fit(FitStatus.TOO_FEW_POINTS)
    return fit_about(points, mid_range(points), largest_error_deg=largest_error_deg)


def fit_about(
    points: Array,
    anchor: Array,
    *,
    bias_share: float = 1.0,
    largest_error_deg: float = LARGEST_DIRECTION_ERROR_DEG,
) -> MagnetometerFit:
    """Fit as `fit_direct` does, coordinates relative to an anchor [counts] near the middle of at least 9 points.

    Parameters
    ----------
    bias_share
        See `direction_variance`.
    """
    unit = half_range(points)
    if not unit > 0.0:
        return no_fit(FitStatus.SINGULAR)
    rows, target = design((points - anchor) / unit)
    normal = rows.T @ rows
    coverage = largest_pivot_ratio(normal)
    if coverage >= COVERAGE_SINGULAR:
        return no_fit(FitStatus.SINGULAR, coverage=coverage)
    solution = np.linalg.solve(normal, rows.T @ target)
    a, b, *rest = solution
    quadric = quadric_from_coefficients(np.array([a, b, 1.0 - a - b, *rest]), unit=unit)
    calibration = None if quadric is None else calibration_from_quadric(quadric)
    if quadric is None or calibration is None:
        return no_fit(FitStatus.NOT_AN_ELLIPSOID, coverage=coverage)
    soft_iron, centre = calibration
    level = float(centre @ quadric.shape @ centre) - quadric.constant
    residual = float(((rows @ solution - target) ** 2).sum())
    variance = direction_variance(
        len(points),
        rows[:, 5:8].sum(axis=0),
        residual,
        centre / unit,
        level / unit**2,
        *inverse_factors(normal),
        bias_share=bias_share,
    )
    if not variance <= math.radians(largest_error_deg) ** 2:
        return no_fit(FitStatus.POOR_COVERAGE, coverage=coverage)
    return MagnetometerFit(FitStatus.ELLIPSOID, False, 0, soft_iron, anchor + centre, coverage)


def direction_variance(
    n: float,
    total: Array,
    residual: Array | float,
    centre: Array,
    level: Array | float,
    constant: Array,
    pivots: Array,
    *,
    bias_share: float = 1.0,
) -> Array:
    """Predict the mean square of the angle between directions by the fitted ellipsoid and the true ones [rad^2].

    Parameters
    ----------
    n
        Number of points.
    total : shape (3, ...)
        Their sum.
    residual : shape (...)
        Sum of the squares of D, the algebraic distance.
    centre : shape (3, ...)
    level : shape (...)
        Ellipsoid ``(p - centre)' A (p - centre) = level``, in the points' coordinates.
    constant : shape (9, ...)
        Last column of the inverse of the normal matrix.
    pivots : shape (9, ...)
        Pivots of that matrix.
    bias_share
        Part of the bias of least squares that the fit has.

    Notes
    -----
    With A near a third of the identity, an error (dA, dg, dj) turns directions by the mean square
    ``9/20 |dA|^2 + |dg + 2 dA centre|^2 / (2 level)``. Its covariance is that of least squares, the inverse of the
    normal matrix times the variance of D, by generalised cross-validation (Golub, Heath and Wahba, Technometrics 21,
    1979) ``n sum D^2 / (n - 9)^2``. Of that inverse, whose factors are the pivots and the inverse of L, the last row is
    used whole, since it has the combination of unknowns that a part of the sphere determines worst, and of the others
    only the diagonal. The last row also has the bias that noise makes. In the thesis' worlds with up to half or 90 % of
    the sphere missing, 0.05 to 1 uT and 20 to 1000 points, prediction over error is 0.5 to 3 (p5, p95), and 1.0 to 1.2
    in the median.
    """
    x, y, z = centre
    a, b, d, e, f, g, h, i, variance = constant
    gx, gy, gz = g + 2.0 * x * a + y * d + z * e, h + 2.0 * y * b + x * d + z * f, i - 2.0 * z * (a + b) + x * e + y * f
    turned = (gx**2 + gy**2 + gz**2) / (2.0 * level) + 0.9 * (a * a + a * b + b * b) + 0.225 * (d * d + e * e + f * f)
    spread = total[0] * gx + total[1] * gy + total[2] * gz + n * (g * x + h * y + i * z + 2.0 * variance)
    with np.errstate(divide="ignore", invalid="ignore"):
        noise = np.maximum(residual, SMALLEST_RESIDUAL * n * level**2) * n / (n - ELLIPSOID_UNKNOWNS) ** 2
        bias = bias_share * noise * spread / (2.0 * level)
        shape = 0.9 * (1.0 / pivots[:2]).sum(axis=0) + 0.225 * (1.0 / pivots[2:5]).sum(axis=0)
        diagonal = shape + (1.0 / pivots[5:8]).sum(axis=0) / (2.0 * level)
        predicted: Array = noise * diagonal + turned * (noise + bias**2 / variance) / variance
    return predicted


def inverse_factors(normal: Array) -> tuple[Array, Array]:
    """Return the last column of the inverse of a normal matrix, and its pivots in L D L^T."""
    constant = np.linalg.solve(normal, np.eye(len(normal))[-1])
    return constant, np.diag(np.linalg.cholesky(normal)) ** 2


def design(points: Array) -> tuple[Array, Array]:
    """Return rows, shape (n, 9), and target, shape (n,), of the quadric of unit trace through points, shape (n, 3)."""
    x, y, z = points.T
    rows = np.column_stack([x * x - z * z, y * y - z * z, x * y, x * z, y * z, x, y, z, np.ones(len(x))])
    return rows, -z * z
