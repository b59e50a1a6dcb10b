"""Noise settings of the fusion filter."""

from __future__ import annotations

import math
from dataclasses import dataclass


@dataclass(frozen=True, slots=True)
class FusionNoise:
    """Assumed noise of the sensors in the filter."""

    rate_dps_rthz: float
    """Density of the rate's noise [deg/s per root hertz], including an allowance for the gyroscope's other errors."""
    tilt_deg: float
    heading_deg: float
    """Standard deviation of one TRIAD attitude about a level axis, and about the vertical."""
    gate_g: float = 0.1
    """Largest deviation of gravity's norm from 1 g at which it is used."""


def heading_sigma_deg(*, field_sigma: float, tilt_deg: float, dip_deg: float) -> float:
    """Return the standard deviation of one TRIAD heading [deg].

    Parameters
    ----------
    field_sigma
        rms noise of one axis of the field, relative to the field's strength.
    tilt_deg
        rms error of the accelerometer's tilt about one axis.
    dip_deg
        Dip of the field.

    Notes
    -----
    Noise of the field acts relative to its horizontal part; an error of tilt moves the vertical part into the
    horizontal plane: ``(field_sigma / cos(dip))^2 + (tilt tan(dip))^2``.
    """
    dip = math.radians(dip_deg)
    return math.hypot(math.degrees(field_sigma) / math.cos(dip), tilt_deg * math.tan(dip))
