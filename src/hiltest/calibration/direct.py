"""`direct`: the thesis' algebraic ellipsoid fit with its equations corrected, in float64."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike

from hiltest.calibration.fit import (
    ELLIPSOID_UNKNOWNS,
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
from hiltest.calibration.sphere import fit_sphere

# Simulated on the mid-range anchor at 0.4 uT: at most 1.7 for a full sphere, 6 to 30 for
# half of one, 31 to 158 for 30 % of one, where the fit follows the noise.
COVERAGE_LIMIT = 30.0


def fit_direct(points_counts: ArrayLike) -> MagnetometerFit:
    """Fit the quadric of unit trace by linear least squares, and calibrate by it.

    Parameters
    ----------
    points_counts : shape (n, 3)
        Raw points [counts], body frame; at least 9, spread over more than about half
        of the sphere.

    Returns
    -------
    MagnetometerFit
        Status ELLIPSOID, or NOT_AN_ELLIPSOID or POOR_COVERAGE with the sphere fit, or
        TOO_FEW_POINTS or SINGULAR without a fit.

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
    return fit_about(points, mid_range(points))


def fit_about(points: Array, anchor: Array) -> MagnetometerFit:
    """Fit as `fit_direct` does, coordinates relative to an anchor [counts] near the middle of at least 9 points."""
    unit = half_range(points)
    if not unit > 0.0:
        return fit_sphere(points, FitStatus.POOR_COVERAGE, coverage=1e6)
    rows, target = design((points - anchor) / unit)
    normal = rows.T @ rows
    coverage = largest_pivot_ratio(normal)
    if coverage > COVERAGE_LIMIT:
        return fit_sphere(points, FitStatus.POOR_COVERAGE, coverage=coverage)
    a, b, *rest = np.linalg.solve(normal, rows.T @ target)
    quadric = quadric_from_coefficients(np.array([a, b, 1.0 - a - b, *rest]), unit=unit)
    calibration = None if quadric is None else calibration_from_quadric(quadric)
    if calibration is None:
        return fit_sphere(points, FitStatus.NOT_AN_ELLIPSOID, coverage=coverage)
    soft_iron, centre = calibration
    return MagnetometerFit(FitStatus.ELLIPSOID, False, 0, soft_iron, anchor + centre, coverage)


def design(points: Array) -> tuple[Array, Array]:
    """Return rows, shape (n, 9), and target, shape (n,), of the quadric of unit trace through points, shape (n, 3)."""
    x, y, z = points.T
    rows = np.column_stack([x * x - z * z, y * y - z * z, x * y, x * z, y * z, x, y, z, np.ones(len(x))])
    return rows, -z * z
