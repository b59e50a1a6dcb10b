"""Units in headers of tables, options of commands and rigs, and conversions between them."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from enum import StrEnum


class FieldUnit(StrEnum):
    """Unit of magnetometer samples; the scale of counts is unknown."""

    UT = "uT"
    NT = "nT"
    MT = "mT"
    T = "T"
    GAUSS = "gauss"
    MG = "mG"
    COUNTS = "counts"


#: Size of a unit in microtesla; None if unknown.
MICROTESLA: dict[FieldUnit, float | None] = {
    FieldUnit.UT: 1.0,
    FieldUnit.NT: 1e-3,
    FieldUnit.MT: 1e3,
    FieldUnit.T: 1e6,
    FieldUnit.GAUSS: 100.0,
    FieldUnit.MG: 0.1,
    FieldUnit.COUNTS: None,
}

_COUNTS = ("counts", "count", "lsb", "raw", "adc")

#: Words for units of fields, as `unit_word` writes them.
FIELD_WORDS = {
    **dict.fromkeys(("ut", "microtesla", "utesla", "microt", "microteslas"), FieldUnit.UT),
    **dict.fromkeys(("nt", "nanotesla", "ntesla"), FieldUnit.NT),
    **dict.fromkeys(("mt", "millitesla", "mtesla"), FieldUnit.MT),
    **dict.fromkeys(("tesla", "teslas"), FieldUnit.T),
    **dict.fromkeys(("gauss", "gs", "ga"), FieldUnit.GAUSS),
    **dict.fromkeys(("mgauss", "milligauss", "mgs", "mga"), FieldUnit.MG),
    # Shimmer's calibrated field, relative to the local one.
    **dict.fromkeys((*_COUNTS, "local_flux", "local"), FieldUnit.COUNTS),
}


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

#: Words for units of rates, as `unit_word` writes them.
RATE_WORDS = {
    **dict.fromkeys(
        ("deg/s", "dps", "°/s", "degs", "deg", "deg/sec", "degree/s", "degrees/s", "degrees/sec"), RateUnit.DPS
    ),
    "mdps": RateUnit.MDPS,
    **dict.fromkeys(("rad/s", "rads", "rad", "rad/sec", "radians/s", "radpersec", "si"), RateUnit.RAD_S),
    "deg/h": RateUnit.DEG_H,
    **dict.fromkeys(_COUNTS, RateUnit.COUNTS),
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

#: Words for units of accelerations, as `unit_word` writes them.
ACCELERATION_WORDS = {
    "g": AccelerationUnit.G,
    "mg": AccelerationUnit.MG,
    **dict.fromkeys(("m/s2", "ms2", "m/s/s", "m/sec2", "mps2", "ms-2", "si"), AccelerationUnit.MS2),
    **dict.fromkeys(_COUNTS, AccelerationUnit.COUNTS),
}

# In lower case these are the g of accelerometers, and times or temperatures.
_CAPITALS = {"G": "gauss", "mG": "mgauss", "T": "tesla"}
# Unicode has two micro signs. Powers and products have several spellings.
_SPELLINGS = str.maketrans({"µ": "u", "μ": "u", "²": "2", "^": "", "*": "", "(": "", ")": "", " ": ""})


def unit_word(written: str) -> str:
    """Return a unit as the tables of words have it.

    Examples
    --------
    >>> unit_word("µT"), unit_word("mG"), unit_word("mg"), unit_word("m/(s^2)")
    ('ut', 'mgauss', 'mg', 'm/s2')
    """
    return _CAPITALS.get(written.strip(), written).lower().translate(_SPELLINGS)


@dataclass(frozen=True, slots=True)
class Conversion:
    """Conversion of a number from one unit to another: ``factor * number + offset``."""

    factor: float = 1.0
    offset: float = 0.0


def _conversions_by_word(factors: Mapping[str, float | None]) -> dict[str, Conversion]:
    """Return conversions by word; a unit of unknown size has none."""
    return {word: Conversion(factor) for word, factor in factors.items() if factor is not None}


# Conversions by target unit.
_CONVERSIONS: dict[str, dict[str, Conversion]] = {
    "deg": _conversions_by_word(
        {"deg": 1.0, "°": 1.0, "degrees": 1.0, "rad": math.degrees(1.0), "mrad": math.degrees(1e-3)}
    ),
    "dps": _conversions_by_word({word: DEGREES_PER_SECOND[unit] for word, unit in RATE_WORDS.items()}),
    "g": _conversions_by_word({word: GRAVITIES[unit] for word, unit in ACCELERATION_WORDS.items()}),
    "uT": _conversions_by_word({word: MICROTESLA[unit] for word, unit in FIELD_WORDS.items()}),
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
_BY_WORD = {unit: {unit_word(word): factor for word, factor in words.items()} for unit, words in _CONVERSIONS.items()}


def conversion(word: str, unit: str) -> Conversion | None:
    """Return the conversion from a unit, as people write it, to one of deg, dps, g, uT, degC, s, Hz and %.

    The result is None if the units do not convert.

    Examples
    --------
    >>> conversion("mG", "uT"), conversion("K", "degC"), conversion("uT", "deg")
    (Conversion(factor=0.1, offset=0.0), Conversion(factor=1.0, offset=-273.15), None)
    """
    return _BY_WORD[unit].get(unit_word(word if unit == "uT" else word.lower()))


def unit_words(unit: str) -> list[str]:
    """Return words that `conversion` can convert to a unit: one for each unit of a sensor."""
    units: dict[str, type[StrEnum]] = {"dps": RateUnit, "g": AccelerationUnit, "uT": FieldUnit}
    words = map(str, units.get(unit, _CONVERSIONS[unit]))
    return [word for word in words if word.isascii() and word not in ("", "counts")]
