"""Units of angular rates and accelerations, as headers of tables and options of commands name them."""

from __future__ import annotations

import math
from enum import StrEnum


class RateUnit(StrEnum):
    """Unit of gyroscope samples; the scale of counts is unknown."""

    DPS = "deg/s"
    MDPS = "mdps"
    RAD_S = "rad/s"
    DEG_H = "deg/h"
    COUNTS = "counts"


#: What one of a unit is in deg/s; None where that is unknown.
DEGREES_PER_SECOND: dict[RateUnit, float | None] = {
    RateUnit.DPS: 1.0, RateUnit.MDPS: 1e-3, RateUnit.RAD_S: math.degrees(1.0), RateUnit.DEG_H: 1.0 / 3600.0,
    RateUnit.COUNTS: None,
}  # fmt: skip

#: In lower case.
RATE_WORDS = {
    **dict.fromkeys(("deg/s", "dps", "°/s", "degs", "deg"), RateUnit.DPS),
    "mdps": RateUnit.MDPS,
    **dict.fromkeys(("rad/s", "rads", "rad", "si"), RateUnit.RAD_S),
    "deg/h": RateUnit.DEG_H,
    **dict.fromkeys(("counts", "count", "lsb"), RateUnit.COUNTS),
}


class AccelerationUnit(StrEnum):
    """Unit of accelerometer samples; scale and zero of counts are unknown."""

    G = "g"
    MG = "mg"
    MS2 = "m/s2"
    COUNTS = "counts"


#: What one of a unit is in g; None where that is unknown.
GRAVITIES: dict[AccelerationUnit, float | None] = {
    AccelerationUnit.G: 1.0, AccelerationUnit.MG: 1e-3, AccelerationUnit.MS2: 1.0 / 9.80665,
    AccelerationUnit.COUNTS: None,
}  # fmt: skip

ACCELERATION_WORDS = {
    "g": AccelerationUnit.G, "mg": AccelerationUnit.MG,
    **dict.fromkeys(("m/s2", "m/s^2", "m/s²", "ms2", "si"), AccelerationUnit.MS2),
    **dict.fromkeys(("counts", "count", "lsb"), AccelerationUnit.COUNTS),
}  # fmt: skip
