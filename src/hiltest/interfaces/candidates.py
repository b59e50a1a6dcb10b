"""Candidates: possible meanings of names and labels in firmware, all guessed from words."""

from __future__ import annotations

import re
from collections.abc import Iterable, Sequence
from dataclasses import dataclass

from hiltest.interfaces.quantities import Quantity
from hiltest.measurement.units import conversion

ANGLES = frozenset({Quantity.HEADING, Quantity.PITCH, Quantity.ROLL})
# Boundaries between the words of a name: heading_deg, headingDeg, HDGDeg, fRho, v2.
_WORD = re.compile(r"[A-Z]+(?![a-z])|[A-Z]?[a-z]+|[0-9]+")
_UNITS = {"degrees": "deg", "radians": "rad", "percent": "%", "pc": "%", "celsius": "degC", "utesla": "uT"}
_PREFIXES = frozenset("bfgimps")  # prefixes of a type, a member, a global: fRho, bIsValid, m_heading

# Words in lower case that mean a quantity; the longest match counts. The letters are those of NXP and textbooks.
_MAG, _RAW = r"(?:mag|magnetometer|magnetic|compass)", r"(?: raw| data| field)*"
_MEANINGS = {
    Quantity.HEADING: r"heading|hdg|azimuth|bearing|yaw|psi(?: l?pl)?|rho(?: l?pl)?",
    Quantity.PITCH: r"pitch|pit|theta|the(?: l?pl)?",
    Quantity.ROLL: r"roll|rol|phi(?: l?pl)?",
    Quantity.MAGNETOMETER: rf"(?:raw )?{_MAG}{_RAW}|raw",
    Quantity.MAGNETOMETER_CALIBRATED: rf"{_MAG} (?:cal|calibrated|corrected|bc)|(?:cal|calibrated|corrected) {_MAG}",
    Quantity.ACCELEROMETER: rf"(?:raw )?(?:acc|accel|accelerometer|acceleration){_RAW}",
    Quantity.ACCELEROMETER_CALIBRATED: r"(?:acc|accel|accelerometer) (?:cal|calibrated|corrected|gc)",
    Quantity.GYROSCOPE: rf"(?:raw )?(?:gyr|gyro|gyroscope|omega){_RAW}",
    Quantity.TEMPERATURE: r"temp|temperature",
    Quantity.HARD_IRON: rf"hard(?: iron)?|(?:{_MAG}|iron)(?: cal)? (?:offsets?|bias|v)",
    Quantity.INVERSE_SOFT_IRON: rf"soft(?: iron)?|(?:f?inv )?soft(?: iron)?(?: inv)?|{_MAG} cal f?inv w",
    Quantity.FIELD_STRENGTH: rf"field(?: strength)?|(?:{_MAG}|iron)(?: cal)? (?:strength|b)",
    Quantity.DIP: r"dip|inclination",
    Quantity.FIT_ERROR: r"fit error(?:pc)?|residual|iron error",
    Quantity.GYROSCOPE_BIAS: r"(?:gyr|gyro|gyroscope) (?:bias|offsets?)|kalman fb pl",
    Quantity.CALIBRATED: rf"(?:is )?(?:{_MAG} )?(?:calibrated|cal(?: valid| ok| done| ready)?)|valid {_MAG} cal",
}
# Words that, next to those, give the name another meaning.
_OTHER = re.compile(
    r"\b(?:target|desired|set ?point|ref|reference|goal|old|prev|previous|init|initial|rate|delta|count|index|size|max"
    r"|min|limit|threshold|gain|scale|buffer|buf|time|cov\w*|var|noise|declination|isr|flag|packet)\b"
)


@dataclass(frozen=True, slots=True)
class Meaning:
    """Possible meaning of words."""

    quantity: Quantity
    unit: str
    """Unit that the words name; empty if they name none, or the quantity has none."""
    is_sure: bool
    """True if the words have no other meaning."""


@dataclass(frozen=True, slots=True)
class Candidate:
    """A variable or text that may hold a quantity."""

    meaning: Meaning
    written: str
    """Path of a variable, or regular expression of a line."""
    reason: str
    """Name or label that it was recognised by."""
    example: str
    """Path of a variable, or a line with one number: ``HDG=123.4``."""
    stated_type: str = ""
    """Type, guessed from the size without debug information; otherwise empty."""

    @property
    def needs_unit(self) -> bool:
        """True if its quantity has a unit and the candidate's is unknown."""
        return bool(self.meaning.quantity.unit) and not self.meaning.unit


def words_of(name: str) -> list[str]:
    """Return the words of a name in lower case, without a type prefix.

    Examples
    --------
    >>> words_of("fRho"), words_of("heading_deg"), words_of("isMagCalibrated")
    (['rho'], ['heading', 'deg'], ['is', 'mag', 'calibrated'])
    """
    words = [word.lower() for word in _WORD.findall(name)]
    return words[1:] if len(words) > 1 and words[0] in _PREFIXES else words


def meaning_of(names: Sequence[str], size: int | None, *, is_whole: bool = False) -> Meaning | None:
    """Return the meaning of names: of the enclosing structs, and last of the value.

    Parameters
    ----------
    size
        Number of its numbers; None if unknown.
    is_whole
        True if they are integers.
    """
    around = " ".join(word for name in names[:-1] for word in words_of(name))
    meaning = _match_with_unit(around, names[-1], size) or _longest_match(around, words_of(names[-1]), size)
    if meaning is not None and meaning.quantity is Quantity.CALIBRATED and not (meaning.is_sure and is_whole):
        return None
    return meaning


def unit_of(quantity: Quantity, word: str) -> str:
    """Return the unit that a word names for a quantity; empty if it names none."""
    unit = _UNITS.get(word, word)
    return unit if len(word) > 1 and quantity.unit and conversion(unit, quantity.unit) is not None else ""


def _match_with_unit(around: str, name: str, size: int | None) -> Meaning | None:
    """Return the meaning of a name that ends with its unit: heading_deg, headingDeg, mag_uT, Mag (nT)."""
    *words, last_word = words_of(name) or [""]
    *parts, last_part = re.findall(r"[A-Za-z0-9%]+", name) or [""]
    for own, unit in ((words_of(" ".join(parts)), last_part), (words, last_word)):
        meaning = _longest_match(around, own, size) if own else None
        if meaning is not None and (unit_name := unit_of(meaning.quantity, unit)):
            return Meaning(meaning.quantity, unit_name, meaning.is_sure)
    return None


def _longest_match(around: str, own: list[str], size: int | None) -> Meaning | None:
    """Return the longest match with all of a name's own words and those around it; for angles, with some of its own.

    A name that only starts like a vector is mostly another quantity: a derivative, an estimate, a part of a filter.
    """
    last = " ".join(own)
    text = f"{around} {last}".strip()
    if _OTHER.search(last):
        return None
    matches: list[tuple[bool, int, Quantity]] = []
    for quantity, pattern in _MEANINGS.items():
        if size in (None, quantity.size):
            whole = re.search(rf"\b(?:{pattern})$", text)
            if whole is not None and len(whole[0]) >= len(last):
                matches.append((True, len(whole[0]), quantity))
            elif quantity in ANGLES and (part := re.search(rf"\b(?:{pattern})\b", last)):
                matches.append((False, len(part[0]), quantity))
    if not matches:
        return None
    is_sure, _, quantity = max(matches, key=lambda match: match[:2])
    return Meaning(quantity, "", is_sure)


def _rank(candidate: Candidate) -> tuple[bool, bool, int]:
    return not candidate.meaning.is_sure, candidate.needs_unit, len(candidate.written)


def best_first(candidates: Iterable[Candidate]) -> dict[Quantity, list[Candidate]]:
    """Return candidates by quantity: sure ones first, then those with a unit, then the shortest."""
    by_quantity: dict[Quantity, dict[str, Candidate]] = {quantity: {} for quantity in Quantity}
    for candidate in sorted(candidates, key=_rank):
        by_quantity[candidate.meaning.quantity].setdefault(candidate.written, candidate)
    return {quantity: [*several.values()] for quantity, several in by_quantity.items() if several}
