"""A magnetometer without iron that is carried, nearly level, through a house whose field varies by a tenth."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import gaussian_filter1d
from scipy.spatial.transform import Rotation

_COUNT, _RATE_HZ = 4000, 100.0
_FIELD_UT = (20.0, 0.0, -40.0)


def indoor_walk(seed: int) -> NDArray[np.float64]:
    """Return readings of 40 s [uT], shape (4000, 3): 0.3 uT of noise, and a field that varies within seconds."""
    random = np.random.default_rng(seed)
    time_s = np.arange(_COUNT) / _RATE_HZ
    turns = np.cumsum(random.choice([-90.0, 90.0, 90.0], 9))
    yaw_deg = np.interp(time_s, np.linspace(0.0, 40.0, 9), turns) + np.cumsum(random.normal(0.0, 1.0, _COUNT))
    pitch_deg = 9.0 * np.sin(2.0 * np.pi * 0.9 * time_s) + 6.0 * random.normal() * np.sin(0.3 * time_s)
    roll_deg = 6.0 * np.sin(2.0 * np.pi * 0.45 * time_s + 1.0)
    varying = gaussian_filter1d(random.normal(size=(_COUNT, 3)), 250.0, axis=0)
    varying_ut = varying / varying.std(axis=0) * (4.0, 4.0, 5.0)
    pose = Rotation.from_euler("ZYX", np.column_stack([yaw_deg, pitch_deg, roll_deg]), degrees=True)
    readings: NDArray[np.float64] = pose.inv().apply(_FIELD_UT + varying_ut) + random.normal(0.0, 0.3, (_COUNT, 3))
    return readings
