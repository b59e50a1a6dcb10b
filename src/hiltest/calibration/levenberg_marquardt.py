"""`levenberg-marquardt`: the least squares of the calibrated norm by MINPACK's algorithm, in float64.

Notes
-----
The search minimises ``sum (|C (p - o)| - 1)^2`` from the sphere. The sum has no global minimum: it falls towards 0 as
the surface grows and recedes, and with much noise over part of a sphere every step leads there (NOT_CONVERGED).
"""

from __future__ import annotations

import numpy as np

from hiltest.calibration.fit import Array, FitStatus
from hiltest.calibration.norm_residuals import calibrated_norms, one_by_one, sphere_parameters

# Tolerance of the error and of the parameters: the precision of float64.
_TOLERANCE = 1e-15
# A minimum took 32 steps at most, with noise of a fifth of the field; a diverging surface takes any number.
_MOST_EVALUATIONS = 200


def _search(points: Array, _: Array) -> Array | FitStatus:
    from scipy.optimize import least_squares  # takes 0.3 s, which the closed forms do not need

    start = sphere_parameters(points)
    if start is None:
        return FitStatus.NOT_CONVERGED
    result = least_squares(
        lambda parameters: calibrated_norms(parameters, points)[0],
        start,
        lambda parameters: calibrated_norms(parameters, points)[1],
        method="lm",
        xtol=_TOLERANCE,
        ftol=_TOLERANCE,
        gtol=_TOLERANCE,
        max_nfev=_MOST_EVALUATIONS,
    )
    settled = result.success and np.isfinite(result.x).all()
    return np.asarray(result.x) if settled else FitStatus.NOT_CONVERGED


fit_levenberg_marquardt = one_by_one(_search)
