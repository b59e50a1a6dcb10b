"""`levenberg-marquardt`: the least squares of the calibrated norm by MINPACK's algorithm, in float64.

Notes
-----
Minimises ``sum (|C (p - o)| - 1)^2`` from the sphere. The sum has no smallest value: it falls towards 0 as the surface
grows and goes away, and with much noise over part of a sphere that is where every step leads (NOT_CONVERGED).
"""

from __future__ import annotations

import numpy as np

from hiltest.calibration.fit import Array, FitStatus
from hiltest.calibration.norm_residuals import calibrated_norms, one_by_one, sphere_parameters

# Of the error and of the parameters: where float64 ends.
_TOLERANCE = 1e-15
# A minimum took 32 at most, with a fifth of the field for noise; a surface that runs away takes any number.
_MOST_EVALUATIONS = 200


def _search(points: Array, _: Array) -> Array | FitStatus:
    from scipy.optimize import least_squares  # 0.3 s, which the closed forms need not wait for

    start = sphere_parameters(points)
    if start is None:
        return FitStatus.NOT_CONVERGED
    found = least_squares(
        lambda parameters: calibrated_norms(parameters, points)[0], start,
        lambda parameters: calibrated_norms(parameters, points)[1],
        method="lm", xtol=_TOLERANCE, ftol=_TOLERANCE, gtol=_TOLERANCE, max_nfev=_MOST_EVALUATIONS,
    )  # fmt: skip
    settled = found.success and np.isfinite(found.x).all()
    return np.asarray(found.x) if settled else FitStatus.NOT_CONVERGED


fit_levenberg_marquardt = one_by_one(_search)
