"""One line of G-code as Grbl 1.1 reads it: words, modal groups, and error numbers.

Only what turns a table is accepted: G0 and G1 on three axes, dwell, absolute and relative distances. Commands of a
sender's preamble that only confirm the table's fixed state (degrees for millimetres, no offsets) are accepted;
everything else is refused by number.
"""

from __future__ import annotations

import re
from collections.abc import Iterable
from dataclasses import dataclass, replace
from enum import IntEnum
from math import isfinite

AXES = "XYZ"

# Letter, then a number without an exponent; Grbl takes "X.5" and "X5.".
_WORD = re.compile(r"([A-Z])([+-]?(?:\d+\.?\d*|\.\d+))?")
_HIGHEST_LINE_NUMBER = 9_999_999
# Words that Grbl accepts as values of commands that this table does not offer.
_VALUES_OF_OTHERS = frozenset("IJKLRST")
# Modal groups of the G commands that are accepted; each may appear once in a line.
_GROUPS = {
    0: "motion",
    1: "motion",
    80: "motion",
    4: "dwell",
    17: "plane",
    21: "units",
    40: "compensation",
    49: "length",
    54: "coordinates",
    61: "path",
    90: "distance",
    91: "distance",
    94: "feed",
}


class Refusal(IntEnum):
    """Grbl's error numbers that this table uses."""

    EXPECTED_LETTER = 1
    BAD_NUMBER = 2
    UNKNOWN_SYSTEM_COMMAND = 3
    NEGATIVE_VALUE = 4
    NOT_IDLE = 8
    LOCKED = 9
    LINE_OVERFLOW = 11
    UNSUPPORTED_COMMAND = 20
    MODAL_GROUP_VIOLATION = 21
    NO_FEED_RATE = 22
    NOT_AN_INTEGER = 23
    WORD_REPEATED = 25
    LINE_NUMBER = 27
    VALUE_MISSING = 28
    AXES_WITHOUT_MOTION = 31
    INVALID_TARGET = 33
    WORDS_UNUSED = 36


class GcodeError(Exception):
    """A refused line; `number` is Grbl's error number."""

    def __init__(self, number: Refusal) -> None:
        self.number = number
        super().__init__(f"error:{number:d}")


@dataclass(frozen=True, slots=True)
class Modals:
    """Modal state, which persists from line to line."""

    motion: int = 0
    """0, 1 or 80 (none)."""
    relative: bool = False
    """Relative distances (G91)."""
    feed_dpm: float | None = None
    """Last F [deg/min]."""


@dataclass(frozen=True, slots=True)
class GcodeBlock:
    """Request of one line."""

    modals: Modals
    """Modal state from this line on."""
    axes: dict[str, float]
    """Axis words; empty when nothing is to move."""
    dwell_s: float | None
    """Dwell of G4, before any motion."""


def read_block(line: str, modals: Modals) -> GcodeBlock:
    """Parse a line.

    Parameters
    ----------
    line
        Upper case, without comments and spaces.
    modals
        Modal state before it.

    Raises
    ------
    GcodeError
        When Grbl would refuse the line, or this table has no use for it.
    """
    commands, values = _sort(_words(line))
    modals = _new_modals(modals, commands, values)
    axes = {axis: values.pop(axis) for axis in AXES if axis in values}
    dwell_s = None
    if "dwell" in commands:
        if "P" not in values:
            raise GcodeError(Refusal.VALUE_MISSING)
        dwell_s = values.pop("P")
    if values:
        raise GcodeError(Refusal.WORDS_UNUSED)
    if axes and modals.motion == 80:
        raise GcodeError(Refusal.AXES_WITHOUT_MOTION)
    if axes and modals.motion == 1 and not modals.feed_dpm:
        raise GcodeError(Refusal.NO_FEED_RATE)
    return GcodeBlock(modals, axes, dwell_s)


def _words(line: str) -> Iterable[tuple[str, float]]:
    at = 0
    while at < len(line):
        word = _WORD.match(line, at)
        if word is None:
            raise GcodeError(Refusal.EXPECTED_LETTER)
        if word[2] is None or not isfinite(number := float(word[2])):
            raise GcodeError(Refusal.BAD_NUMBER)
        yield word[1], number
        at = word.end()


def _sort(words: Iterable[tuple[str, float]]) -> tuple[dict[str, int], dict[str, float]]:
    """Return G commands by modal group, and values by letter."""
    commands: dict[str, int] = {}
    values: dict[str, float] = {}
    for letter, value in words:
        if letter == "G":
            group = _group(value)
            if group in commands:
                raise GcodeError(Refusal.MODAL_GROUP_VIOLATION)
            commands[group] = int(value)
            continue
        if letter not in "FNPXYZ" and letter not in _VALUES_OF_OTHERS:
            raise GcodeError(Refusal.UNSUPPORTED_COMMAND)
        if letter in values:
            raise GcodeError(Refusal.WORD_REPEATED)
        if letter in "FNP" and value < 0.0:
            raise GcodeError(Refusal.NEGATIVE_VALUE)
        values[letter] = value
    return commands, values


def _group(value: float) -> str:
    whole = int(value) if value >= 0.0 else -1
    if whole not in _GROUPS:
        raise GcodeError(Refusal.UNSUPPORTED_COMMAND)
    if value != whole:
        raise GcodeError(Refusal.NOT_AN_INTEGER)
    return _GROUPS[whole]


def _new_modals(modals: Modals, commands: dict[str, int], values: dict[str, float]) -> Modals:
    if values.pop("N", 0.0) > _HIGHEST_LINE_NUMBER:
        raise GcodeError(Refusal.LINE_NUMBER)
    return replace(
        modals,
        motion=commands.get("motion", modals.motion),
        relative=commands["distance"] == 91 if "distance" in commands else modals.relative,
        feed_dpm=values.pop("F", modals.feed_dpm),
    )
