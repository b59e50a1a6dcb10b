"""Calibrators of the package circuitpython-mag-cal, as `hiltest judge` calls them; docs/leaderboard.md has the rules.

The first line of a docstring is the entry's name in the table.
"""

from __future__ import annotations

import numpy as np
from mag_cal.sensor import Sensor
from numpy.typing import NDArray

Reals = NDArray[np.float64]
Calibration = tuple[Reals, Reals]


def mag_cal_ellipsoid(samples: Reals) -> Calibration:
    """circuitpython-mag-cal Sensor.fit_ellipsoid"""
    sensor = Sensor()
    sensor.fit_ellipsoid(samples)
    return sensor.centre, sensor.transform.T
