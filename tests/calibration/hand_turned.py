"""Logs of a magnetometer that is turned in the hand, with noise that lasts."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from scipy.signal import lfilter
from scipy.spatial.transform import Rotation

from hiltest.calibration import FitStatus, MagnetometerFit

_SOFT_IRON = np.array([[1.04, 0.02, -0.01], [0.02, 0.97, 0.03], [-0.01, 0.03, 1.0]])
_FIELD_UT = np.array([20.0, 0.0, 43.0])
_RATE_HZ = 20.0
#: What a perfect calibrator makes of `hand_turned`.
TRUTH = MagnetometerFit(
    FitStatus.ELLIPSOID, False, 0, np.linalg.inv(_SOFT_IRON) / np.linalg.norm(_FIELD_UT), np.array([10.0, -20.0, 5.0])
)


def hand_turned(seed: int, count: int) -> NDArray[np.float64]:
    """Return readings at 20 Hz [uT], shape (count, 3): 0.3 uT of white noise, and 0.3 uT that lasts for a second."""
    random = np.random.default_rng(seed)
    # 1.5 rad/s about an axis that changes within two seconds.
    rates = lasting(random, count, 2.0) * 1.5
    pose, field = Rotation.random(random_state=seed), np.empty((count, 3))
    for i, step in enumerate(Rotation.from_rotvec(rates / _RATE_HZ)):
        pose = pose * step
        field[i] = pose.inv().apply(_FIELD_UT)
    noise = 0.3 * lasting(random, count, 1.0) + random.normal(0.0, 0.3, (count, 3))
    return field @ _SOFT_IRON + TRUTH.hard_iron + noise


def lasting(random: np.random.Generator, count: int, lasting_s: float) -> NDArray[np.float64]:
    """Return noise of variance 1 at 20 Hz, shape (count, 3), that is correlated over a time, an AR(1)."""
    remainder = np.exp(-1.0 / (_RATE_HZ * lasting_s))
    noise: NDArray[np.float64] = lfilter(
        [np.sqrt(1.0 - remainder**2)], [1.0, -remainder], random.normal(size=(count, 3)), axis=0
    )
    return noise
