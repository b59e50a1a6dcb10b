"""Units in headers of tables, options of commands and rigs, and conversions between them."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from enum import StrEnum


class RateUnit(StrEnum):
    """Unit of gyroscope samples; the scale of counts is unknown."""

    DPS = "deg/s"
    MDPS = "mdps"
    RAD_S = "rad/s"
    DEG_H = "deg/h"
    COUNTS = "counts"


#: Size of a unit in deg/s; None if unknown.
DEGREES_PER_SECOND: dict[RateUnit, float | None] = {
    RateUnit.DPS: 1.0,
    RateUnit.MDPS: 1e-3,
    RateUnit.RAD_S: math.degrees(1.0),
    RateUnit.DEG_H: 1.0 / 3600.0,
    RateUnit.COUNTS: None,
}

#: Words for units of rates, in lower case.
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


#: Size of a unit in g; None if unknown.
GRAVITIES: dict[AccelerationUnit, float | None] = {
    AccelerationUnit.G: 1.0,
    AccelerationUnit.MG: 1e-3,
    AccelerationUnit.MS2: 1.0 / 9.80665,
    AccelerationUnit.COUNTS: None,
}

ACCELERATION_WORDS = {
    "g": AccelerationUnit.G,
    "mg": AccelerationUnit.MG,
    **dict.fromkeys(("m/s2", "m/s^2", "m/s²", "ms2", "si"), AccelerationUnit.MS2),
    **dict.fromkeys(("counts", "count", "lsb"), AccelerationUnit.COUNTS),
}


@dataclass(frozen=True, slots=True)
class Conversion:
    """Conversion of a number from one unit to another: ``factor * number + offset``."""

    factor: float = 1.0
    offset: float = 0.0


def _conversions_by_word(factors: Mapping[str, float | None]) -> dict[str, Conversion]:
    """Return conversions by word; a unit of unknown size has none."""
    return {word: Conversion(factor) for word, factor in factors.items() if factor is not None}


# Conversions by target unit. People write the words in upper or lower case, and Unicode has two micro signs.
_CONVERSIONS: dict[str, dict[str, Conversion]] = {
    "deg": _conversions_by_word(
        {"deg": 1.0, "°": 1.0, "degrees": 1.0, "rad": math.degrees(1.0), "mrad": math.degrees(1e-3)}
    ),
    "dps": _conversions_by_word({word: DEGREES_PER_SECOND[unit] for word, unit in RATE_WORDS.items()}),
    "g": _conversions_by_word({word: GRAVITIES[unit] for word, unit in ACCELERATION_WORDS.items()}),
    "uT": _conversions_by_word(
        {
            "uT": 1.0,
            "µT": 1.0,
            "μT": 1.0,
            "nT": 1e-3,
            "mT": 1e3,
            "T": 1e6,
            "gauss": 100.0,
            "Gs": 100.0,
            "mgauss": 0.1,
        }
    ),
    "degC": {
        "degC": Conversion(),
        "°C": Conversion(),
        "C": Conversion(),
        "K": Conversion(offset=-273.15),
        "degF": Conversion(5.0 / 9.0, -160.0 / 9.0),
    },
    "%": {"%": Conversion(), "1": Conversion(100.0)},
    "s": _conversions_by_word({"s": 1.0, "ms": 1e-3, "us": 1e-6}),
    "Hz": {"Hz": Conversion()},
    "": {"": Conversion(), "1": Conversion()},
}
_BY_LOWER = {unit: {word.lower(): factor for word, factor in words.items()} for unit, words in _CONVERSIONS.items()}
# Units of a field, with a capital; in lower case they are the g of accelerometers.
_GAUSS = {"G": "gauss", "mG": "mgauss"}


def conversion(word: str, unit: str) -> Conversion | None:
    """Return the conversion from a unit, as people write it, to one of deg, dps, g, uT, degC, s, Hz and %.

    The result is None if the units do not convert.

    Examples
    --------
    >>> conversion("mG", "uT"), conversion("K", "degC"), conversion("uT", "deg")
    (Conversion(factor=0.1, offset=0.0), Conversion(factor=1.0, offset=-273.15), None)
    """
    written = _GAUSS.get(word.strip(), word.strip()) if unit == "uT" else word.strip()
    return _BY_LOWER[unit].get(written.lower())


def unit_words(unit: str) -> list[str]:
    """Return the words that `conversion` can convert to a unit."""
    return [word for word in _CONVERSIONS[unit] if word.isascii() and word]
