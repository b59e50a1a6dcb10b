"""Units of accelerometer and gyroscope readings, and of time, as headers and options name them."""

from __future__ import annotations

import math
import re
from collections.abc import Mapping, Sequence
from enum import StrEnum
from typing import TypeVar

from hiltest.cloud.columns import name_and_unit
from hiltest.errors import ConfigError


class AccelerationUnit(StrEnum):
    """What accelerometer readings are given in; counts have a scale and a zero that nobody knows."""

    G = "g"
    MG = "mg"
    MS2 = "m/s2"
    COUNTS = "counts"


class RateUnit(StrEnum):
    """What gyroscope readings are given in; counts have a scale that nobody knows."""

    DPS = "deg/s"
    RADPS = "rad/s"
    COUNTS = "counts"


#: What one of a unit is in g, or in deg/s; None where nobody knows.
GRAVITIES: dict[AccelerationUnit, float | None] = {
    AccelerationUnit.G: 1.0, AccelerationUnit.MG: 1e-3, AccelerationUnit.MS2: 1.0 / 9.80665,
    AccelerationUnit.COUNTS: None,
}  # fmt: skip
DEGREES_PER_SECOND: dict[RateUnit, float | None] = {
    RateUnit.DPS: 1.0, RateUnit.RADPS: math.degrees(1.0), RateUnit.COUNTS: None,
}  # fmt: skip

_COUNTS = ("counts", "count", "lsb")
ACCELERATION_WORDS = {
    "g": AccelerationUnit.G, "mg": AccelerationUnit.MG,
    **dict.fromkeys(("m/s2", "m/s^2", "m/s²", "ms2", "si"), AccelerationUnit.MS2),
    **dict.fromkeys(_COUNTS, AccelerationUnit.COUNTS),
}  # fmt: skip
RATE_WORDS = {
    **dict.fromkeys(("deg/s", "dps", "°/s", "deg"), RateUnit.DPS),
    **dict.fromkeys(("rad/s", "rads", "rad", "si"), RateUnit.RADPS),
    **dict.fromkeys(_COUNTS, RateUnit.COUNTS),
}  # fmt: skip

_TIME = re.compile(r"^(time|timestamp|seconds|t)\s*[_(\[]?\s*(?P<unit>s|sec|seconds|ms|us|µs|ns)?\s*[)\]]?$", re.I)
_SECONDS = {"ms": 1e-3, "us": 1e-6, "µs": 1e-6, "ns": 1e-9}
_U = TypeVar("_U", AccelerationUnit, RateUnit)


def unit_in_headers(headers: Sequence[str], words: Mapping[str, _U], option: str) -> _U | None:
    """Return the unit that three headers name, None when they name none.

    Raises
    ------
    ConfigError
        When they name different ones, or one that is not supported.
    """
    found = {name_and_unit(header)[1] for header in headers} - {""}
    units = {words.get(word) for word in found}
    if len(units) > 1 or None in units:
        raise ConfigError(f"the header says {', '.join(headers)}: {' and '.join(sorted(found))} is no unit that can be "
                          f"read here; say one with {option}")
    return next(iter(units), None)


def seconds_of(header: str) -> float | None:
    """Return what one of a column of time is in seconds; None when its name is not that of a time."""
    matched = _TIME.match(header.strip())
    return _SECONDS.get((matched["unit"] or "s").lower(), 1.0) if matched else None
