"""Core clock of calls without boot, which converts cycles into seconds."""

from __future__ import annotations

import re
from fractions import Fraction

from hiltest.errors import ConfigError

#: Default [Hz]: the fastest clock of the MK64FN1M0.
CALL_HZ = 120_000_000
_SLOWEST_HZ, _FASTEST_HZ = 1_000, 1_000_000_000
_UNITS = {"": 1, "k": 1_000, "m": 1_000_000, "g": 1_000_000_000}
_CLOCK = re.compile(r"([0-9][0-9_]*(?:\.[0-9]+)?(?:e[0-9]{1,2})?) ?([kmg]?)(?:hz)?", re.IGNORECASE)


def check_clock(hz: float) -> int:
    """Return a core clock [Hz] as an integer.

    Raises
    ------
    ConfigError
        If it is not a whole number of hertz from 1 kHz to 1 GHz.
    """
    if not (_SLOWEST_HZ <= hz <= _FASTEST_HZ and hz == int(hz)):
        raise ConfigError(f"a core clock of {hz} Hz: use a whole number of Hz from 1 kHz to 1 GHz, such as 48_000_000")
    return int(hz)


def parse_clock(text: str) -> int:
    """Parse a core clock: ``48MHz``, ``32.768 kHz`` or ``48_000_000`` [Hz].

    Raises
    ------
    ConfigError
        If the text is not a valid core clock.
    """
    match = _CLOCK.fullmatch(text.strip())
    try:
        number = Fraction(match[1]) if match else Fraction(0)
    except ValueError:  # underscores that are not between two digits
        number = Fraction(0)
    hz = number * _UNITS[match[2].lower()] if match else number
    if not (_SLOWEST_HZ <= hz <= _FASTEST_HZ and hz.denominator == 1):
        raise ConfigError(f"--clock: {text!r} is not a core clock from 1 kHz to 1 GHz; write 48MHz or 48_000_000")
    return int(hz)
