"""How far the fusion filter trusts its sensors."""

from __future__ import annotations

import math
from dataclasses import dataclass


@dataclass(frozen=True, slots=True)
class FusionNoise:
    """Noise of the sensors, as the filter assumes it."""

    rate_dps_rthz: float
    """Density of the rate's noise [deg/s per root hertz]; the gyroscope's other errors must find room in it."""
    tilt_deg: float
    heading_deg: float
    """Standard deviation of one TRIAD attitude about a level axis, and about the vertical."""
    gate_g: float = 0.1
    """Gravity is used when its norm is 1 g within this."""


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
    Noise of the field is seen over its horizontal part; an error of tilt moves the vertical part
    into the horizontal plane: ``(field_sigma / cos(dip))^2 + (tilt tan(dip))^2``.
    """
    dip = math.radians(dip_deg)
    return math.hypot(math.degrees(field_sigma) / math.cos(dip), tilt_deg * math.tan(dip))
