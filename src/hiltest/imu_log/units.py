"""Units of accelerometer and gyroscope readings, as headers and options name them."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from enum import StrEnum
from typing import TypeVar

from hiltest.cloud.columns import name_and_unit
from hiltest.cloud.rate_units import RateUnit
from hiltest.errors import ConfigError


class AccelerationUnit(StrEnum):
    """What accelerometer readings are given in; counts have a scale and a zero that nobody knows."""

    G = "g"
    MG = "mg"
    MS2 = "m/s2"
    COUNTS = "counts"


#: What one of a unit is in g; None where nobody knows.
GRAVITIES: dict[AccelerationUnit, float | None] = {
    AccelerationUnit.G: 1.0, AccelerationUnit.MG: 1e-3, AccelerationUnit.MS2: 1.0 / 9.80665,
    AccelerationUnit.COUNTS: None,
}  # fmt: skip

ACCELERATION_WORDS = {
    "g": AccelerationUnit.G, "mg": AccelerationUnit.MG,
    **dict.fromkeys(("m/s2", "m/s^2", "m/s²", "ms2", "si"), AccelerationUnit.MS2),
    **dict.fromkeys(("counts", "count", "lsb"), AccelerationUnit.COUNTS),
}  # fmt: skip
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
