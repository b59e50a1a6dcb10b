"""`frosio`: Gauss-Newton on the squared norm from the sensor's zero, in float64.

Notes
-----
Frosio, Pedersini and Borghese (Autocalibration of MEMS accelerometers, 2009) minimise ``sum (|C (p - o)|^2 - 1)^2`` for
an accelerometer, whose offset is small, from ``o = 0`` and the sensitivity of the data sheet, for which here the rms
distance of the points from their mean stands. Puc, Podobnik and Munih found that it never converged for a magnetometer
with a large offset, and did after subtracting the mean, as in `frosio-centred`: it starts from ``o = mean``. The
minimum is the same.
"""

from __future__ import annotations

import numpy as np

from hiltest.calibration.fit import Array, FitStatus
from hiltest.calibration.gauss_newton import gauss_newton
from hiltest.calibration.norm_residuals import one_by_one, parameters_of, squared_norms


def _frosio_from(start: Array, points: Array) -> Array | FitStatus:
    return gauss_newton(squared_norms, points, parameters_of(start, np.eye(len(start))))


fit_frosio = one_by_one(lambda points, zero: _frosio_from(zero, points))
fit_frosio_centred = one_by_one(lambda points, zero: _frosio_from(np.zeros(len(zero)), points))
