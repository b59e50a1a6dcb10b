"""Calibrators of the package navlib, as `hiltest judge` calls them; docs/leaderboard.md has the rules.

The first line of a docstring is the entry's name in the table.
"""

from __future__ import annotations

import math

import numpy as np
from navlib.cal import (
    cal_mag_ellipsoid_fit,
    cal_mag_ellipsoid_fit_fang,
    cal_mag_sphere_fit,
    cal_mag_twostep_hi,
    cal_mag_twostep_hsi,
)
from numpy.typing import NDArray

Reals = NDArray[np.float64]
Calibration = tuple[Reals, Reals]
# Facts that the package asks for: strength and noise of the default rig, with the resolution's.
FIELD_UT, NOISE_UT = 48.5, math.hypot(0.4, 0.1 / math.sqrt(12.0))


def navlib_sphere(samples: Reals) -> Calibration:
    """navlib cal_mag_sphere_fit"""
    return cal_mag_sphere_fit(samples)[0], np.eye(3)


def navlib_twostep_sphere(samples: Reals) -> Calibration:
    """navlib cal_mag_twostep_hi"""
    return cal_mag_twostep_hi(samples, _reference(), measurement_noise_std=NOISE_UT)[0], np.eye(3)


def navlib_twostep(samples: Reals) -> Calibration:
    """navlib cal_mag_twostep_hsi"""
    hard_iron, distortion, _ = cal_mag_twostep_hsi(samples, _reference(), measurement_noise_std=NOISE_UT)
    return hard_iron, np.linalg.inv(distortion)


def navlib_ellipsoid(samples: Reals) -> Calibration:
    """navlib cal_mag_ellipsoid_fit"""
    hard_iron, distortion, _ = cal_mag_ellipsoid_fit(samples)
    return hard_iron, np.linalg.inv(distortion)


def navlib_fang(samples: Reals) -> Calibration:
    """navlib cal_mag_ellipsoid_fit_fang"""
    hard_iron, distortion, _ = cal_mag_ellipsoid_fit_fang(samples)
    return hard_iron, np.linalg.inv(distortion)


def _reference() -> Reals:
    """Return a vector of the field's strength; TWOSTEP uses nothing else of it."""
    return np.array([FIELD_UT, 0.0, 0.0])
