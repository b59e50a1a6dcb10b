"""`geometric`: least squares of the distances from the ellipsoid, the maximum likelihood fit, in float64.

Notes
-----
With noise of one variance on all axes, added after the distortion (Mucciaccia, eq. 1), the likelihood of points is that
of their distances from the surface (Gander, Golub and Strebel, Least-squares fitting of circles and ellipses, 1994), so
this fit is the standard for other calibrators. Mucciaccia's statement in 2.1.3 that the algebraic distance is
statistically better would apply to noise before the distortion.

The search is scipy's trust region with bounds from the ellipsoid of `taubin`, or the sphere. A surface that ends at a
bound has diverged: its centre is 3 rms distances of the points off their mean, or an axis is 20 or a tenth of them
long.
"""

from __future__ import annotations

import numpy as np

from hiltest.calibration.clouds import FURTHEST_CENTRE, Clouds
from hiltest.calibration.fit import Array, FitStatus
from hiltest.calibration.norm_residuals import geometric_distances, one_by_one, parameters_of, sphere_parameters
from hiltest.calibration.taubin import fit_taubin

# Bounds of the soft iron's elements, in 1 over the rms distance: largest, and smallest on the diagonal.
_LARGEST, _SMALLEST = 10.0, 0.05
_TOLERANCE = 1e-15


def _search(points: Array, _: Array) -> Array | FitStatus:
    from scipy.optimize import least_squares  # takes 0.3 s, which the closed forms do not need

    start, axes = _start(points), points.shape[1]
    if start is None:
        return FitStatus.NOT_AN_ELLIPSOID
    upper = np.concatenate([np.full(axes, FURTHEST_CENTRE), np.full(len(start) - axes, _LARGEST)])
    lower = -upper
    lower[axes:][_diagonal_mask(axes)] = _SMALLEST
    result = least_squares(
        lambda parameters: geometric_distances(parameters, points)[0],
        np.clip(start, 0.99 * lower, 0.99 * upper),
        lambda parameters: geometric_distances(parameters, points)[1],
        bounds=(lower, upper),
        xtol=_TOLERANCE,
        ftol=_TOLERANCE,
        gtol=_TOLERANCE,
    )
    if result.active_mask.any():
        return FitStatus.NOT_AN_ELLIPSOID
    return np.asarray(result.x) if result.success else FitStatus.NOT_CONVERGED


def _diagonal_mask(axes: int) -> Array:
    rows, columns = np.triu_indices(axes)
    return np.asarray(rows == columns)


def _start(points: Array) -> Array | None:
    """Return the parameters of the ellipsoid of `taubin`, or of the sphere."""
    sphere = fit_taubin.solve(Clouds(points, np.zeros(points.shape[1]), np.array(1.0)))
    if sphere.status == FitStatus.ELLIPSOID:
        return parameters_of(sphere.centre, sphere.soft_iron)
    return sphere_parameters(points)


fit_geometric = one_by_one(_search)
