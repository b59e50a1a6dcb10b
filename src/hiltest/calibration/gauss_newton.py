"""`gauss-newton`: plain Gauss-Newton steps, on the calibrated norm or the geometric distance, in float64.

Notes
-----
Each step solves ``J step = -r`` by least squares (Mucciaccia, section 4.4, names the algorithm and both metrics). Steps
are neither damped nor bounded: from the sphere they reach the minimum soon, or never. On the calibrated norm ``|C (p -
o)| - 1`` the minimum is that of `levenberg-marquardt`, on the geometric distance that of `geometric`.
"""

from __future__ import annotations

import numpy as np

from hiltest.calibration.fit import Array, FitStatus
from hiltest.calibration.norm_residuals import (
    Residuals,
    calibrated_norms,
    geometric_distances,
    one_by_one,
    sphere_parameters,
)

# Noise of a twentieth of the field usually takes 10 steps, of a fifth 43 on the geometric distance; few fits take over
# 100.
MOST_STEPS = 100
# Smallest step of the parameters, which are of size 1: the next step would be below rounding.
SETTLED = 1e-11


def gauss_newton(residuals: Residuals, points: Array, start: Array) -> Array | FitStatus:
    """Return the parameters where the steps end, or NOT_CONVERGED."""
    parameters = start
    for _ in range(MOST_STEPS):
        off, slopes = residuals(parameters, points)
        if not (np.isfinite(off).all() and np.isfinite(slopes).all()):
            return FitStatus.NOT_CONVERGED
        step = np.linalg.lstsq(slopes, -off, rcond=None)[0]
        parameters = parameters + step
        if not float(np.abs(parameters).max()) < 1e6:
            return FitStatus.NOT_CONVERGED
        if float(np.abs(step).max()) < SETTLED:
            return parameters
    return FitStatus.NOT_CONVERGED


def _fit_from_sphere(residuals: Residuals, points: Array) -> Array | FitStatus:
    start = sphere_parameters(points)
    return FitStatus.NOT_CONVERGED if start is None else gauss_newton(residuals, points, start)


fit_gauss_newton = one_by_one(lambda points, _: _fit_from_sphere(calibrated_norms, points), bias_share=1.0)
fit_gauss_newton_geometric = one_by_one(lambda points, _: _fit_from_sphere(geometric_distances, points))
