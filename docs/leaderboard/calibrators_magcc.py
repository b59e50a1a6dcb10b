"""Calibrators of the package magcc, as `hiltest judge` calls them; docs/leaderboard.md has the rules.

The first line of a docstring is the entry's name in the table.
"""

from __future__ import annotations

import numpy as np
from magcc.magcc import RLSSphereEstimator, calibrate_lm, calibrate_lse
from numpy.typing import NDArray

Reals = NDArray[np.float64]
Calibration = tuple[Reals, Reals]
# A fact that the package asks for: the strength of the default rig's field.
FIELD_UT = 48.5


def magcc_sphere(samples: Reals) -> Calibration:
    """magcc RLSSphereEstimator"""
    estimator = RLSSphereEstimator()
    for sample in samples:
        estimator.update(*sample)
    return estimator.get_hard_soft(FIELD_UT)


def magcc_lse(samples: Reals) -> Calibration:
    """magcc calibrate_lse"""
    return calibrate_lse(samples, FIELD_UT)[:2]


def magcc_lm(samples: Reals) -> Calibration:
    """magcc calibrate_lm"""
    return calibrate_lm(samples, FIELD_UT)[:2]
