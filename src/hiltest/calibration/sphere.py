"""The least-squares sphere, the fallback for points that do not determine an ellipsoid."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike

from hiltest.calibration.fit import FitStatus, MagnetometerFit, half_range, mid_range, no_fit, points_array

SPHERE_UNKNOWNS = 4
# Product of the diagonal over the determinant. A plane leaves rounding in the firmware's
# float32, 1e6 or more; points as thin as 0.3 % of their width leave 1e5.
SPHERE_SINGULAR = 1e5


def fit_sphere(
    points_counts: ArrayLike, status: FitStatus = FitStatus.NOT_AN_ELLIPSOID, *, coverage: float = 0.0
) -> MagnetometerFit:
    """Fit centre and radius by linear least squares.

    Parameters
    ----------
    points_counts : shape (n, 3)
        Raw points [counts], body frame.
    status
        Reason why there is no ellipsoid, which becomes the status of the result.
    coverage
        Stored in the result.

    Returns
    -------
    MagnetometerFit
        ``soft_iron = I / radius``; status SINGULAR without a fit when the points lie
        in a plane, TOO_FEW_POINTS for fewer than four.

    Notes
    -----
    Solves ``|p|^2 = 2 centre . p + (radius^2 - |centre|^2)``, linear in the four unknowns.
    """
    points = points_array(points_counts)
    if len(points) < SPHERE_UNKNOWNS:
        return no_fit(FitStatus.TOO_FEW_POINTS, coverage=coverage)
    unit = half_range(points)
    if not unit > 0.0:
        return no_fit(FitStatus.SINGULAR, coverage=coverage)
    anchor = mid_range(points)
    p = (points - anchor) / unit
    rows = np.column_stack([np.ones(len(p)), p])
    normal = rows.T @ rows
    if not 0.0 < float(np.prod(np.diag(normal))) < SPHERE_SINGULAR * float(np.linalg.det(normal)):
        return no_fit(FitStatus.SINGULAR, coverage=coverage)
    solution = np.linalg.solve(normal, rows.T @ (p * p).sum(axis=1))
    centre = solution[1:] / 2.0
    square = float(solution[0] + centre @ centre)
    if not square > 0.0:
        return no_fit(FitStatus.SINGULAR, coverage=coverage)
    soft_iron = np.eye(3) / (unit * np.sqrt(square))
    return MagnetometerFit(status, True, 0, soft_iron, anchor + unit * centre, coverage)
