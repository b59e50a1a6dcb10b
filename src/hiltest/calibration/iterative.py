"""`iterative`: the 10-element fit of the public sensor-fusion libraries, in float64."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike

from hiltest.calibration.direct import fit_about
from hiltest.calibration.fit import (
    ELLIPSOID_UNKNOWNS,
    LARGEST_DIRECTION_ERROR_DEG,
    FitStatus,
    MagnetometerFit,
    half_range,
    mid_range,
    no_fit,
    points_array,
)
from hiltest.calibration.quadric import calibration_from_quadric, quadric_from_coefficients

# A second eigenvalue below this part of the trace is rounding in the firmware's float32:
# more than one quadric passes through the points.
SECOND_SMALLEST = 1e-6


def fit_iterative(
    points_counts: ArrayLike, *, largest_error_deg: float = LARGEST_DIRECTION_ERROR_DEG
) -> MagnetometerFit:
    """Fit the quadric of unit norm with the smallest algebraic error, and calibrate by it.

    Parameters
    ----------
    points_counts : shape (n, 3)
        Raw points [counts], body frame; at least 10.
    largest_error_deg
        See `fit_direct`.

    Returns
    -------
    MagnetometerFit
        Status ELLIPSOID; or without a fit that of `fit_direct` if it refuses the points, or NOT_AN_ELLIPSOID or
        POOR_COVERAGE. The firmware's can also end in NOT_CONVERGED; this one's eigenvalues come from LAPACK.

    Notes
    -----
    The eigenvector of the smallest eigenvalue of the scatter matrix of ``(x^2, 2xy, 2xz,
    y^2, 2yz, z^2, x, y, z, 1)``, coordinates relative to the middle of their range and
    divided by half of the widest range (the norm depends on both).
    """
    points = points_array(points_counts)
    if len(points) < ELLIPSOID_UNKNOWNS:
        return no_fit(FitStatus.TOO_FEW_POINTS)
    unit = half_range(points)
    if not unit > 0.0:
        return no_fit(FitStatus.SINGULAR)
    anchor = mid_range(points)
    least_squares = fit_about(points, anchor, largest_error_deg=largest_error_deg)
    if not least_squares.has_fit:
        return least_squares
    x, y, z = ((points - anchor) / unit).T
    one = np.ones(len(points))
    rows = np.column_stack([x * x, 2 * x * y, 2 * x * z, y * y, 2 * y * z, z * z, x, y, z, one])
    eigenvalues, vectors = np.linalg.eigh(rows.T @ rows)
    if not eigenvalues[1] > SECOND_SMALLEST * eigenvalues.sum():
        return no_fit(FitStatus.POOR_COVERAGE)
    xx, xy, xz, yy, yz, zz, *rest = vectors[:, 0]
    quadric = quadric_from_coefficients(np.array([xx, yy, zz, 2 * xy, 2 * xz, 2 * yz, *rest]), unit=unit)
    calibration = None if quadric is None else calibration_from_quadric(quadric)
    if calibration is None:
        return no_fit(FitStatus.NOT_AN_ELLIPSOID)
    soft_iron, centre = calibration
    return MagnetometerFit(FitStatus.ELLIPSOID, False, 0, soft_iron, anchor + centre, least_squares.coverage)
