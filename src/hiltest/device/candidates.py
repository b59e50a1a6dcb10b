"""Candidates: what a name or a label in firmware may mean. All of it is a guess from words."""

from __future__ import annotations

import re
from collections.abc import Iterable, Sequence
from dataclasses import dataclass

from hiltest.device.quantities import Quantity
from hiltest.units import conversion

ANGLES = frozenset({Quantity.HEADING, Quantity.PITCH, Quantity.ROLL})
# Where a name changes from one word to the next: heading_deg, headingDeg, HDGDeg, fRho, v2.
_WORD = re.compile(r"[A-Z]+(?![a-z])|[A-Z]?[a-z]+|[0-9]+")
_UNITS = {"degrees": "deg", "radians": "rad", "percent": "%", "pc": "%", "celsius": "degC", "utesla": "uT"}
_PREFIXES = frozenset("bfgimps")  # of a type, a member, a global: fRho, bIsValid, m_heading

# Words in lower case that mean a quantity; the longest that is found counts. The letters are NXP's and the textbooks'.
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
# Beside them, these make it something else.
_OTHER = re.compile(
    r"\b(?:target|desired|set ?point|ref|reference|goal|old|prev|previous|init|initial|rate|delta|count|index|size|max"
    r"|min|limit|threshold|gain|scale|buffer|buf|time|cov\w*|var|noise|declination|isr|flag|packet)\b"
)  # fmt: skip


@dataclass(frozen=True, slots=True)
class Meaning:
    """What words may mean."""

    quantity: Quantity
    unit: str
    """What they say of it; empty where they do not, and where there is none."""
    is_sure: bool
    """Whether they say this and no more."""


@dataclass(frozen=True, slots=True)
class Candidate:
    """What may hold a quantity."""

    meaning: Meaning
    written: str
    """Path of a variable, or regular expression of a line."""
    reason: str
    """What it was recognised by."""
    stated_type: str = ""
    """Guessed by its size, where no debug information says it; else empty."""

    @property
    def needs_unit(self) -> bool:
        """Whether it has a unit, and nobody knows which."""
        return bool(self.meaning.quantity.unit) and not self.meaning.unit


def words_of(name: str) -> list[str]:
    """Return the words of a name in lower case, without the letter of a type before them.

    Examples
    --------
    >>> words_of("fRho"), words_of("heading_deg"), words_of("isMagCalibrated")
    (['rho'], ['heading', 'deg'], ['is', 'mag', 'calibrated'])
    """
    words = [each.lower() for each in _WORD.findall(name)]
    return words[1:] if len(words) > 1 and words[0] in _PREFIXES else words


def meaning_of(names: Sequence[str], size: int | None, *, is_whole: bool = False) -> Meaning | None:
    """Return what names mean: of structs and at last of the value in them.

    Parameters
    ----------
    size
        How many numbers it is; None where that is not known.
    is_whole
        Whether these are integers.
    """
    around = " ".join(word for name in names[:-1] for word in words_of(name))
    said = _with_unit(around, names[-1], size) or _found(around, words_of(names[-1]), size)
    if said is not None and said.quantity is Quantity.CALIBRATED and not (said.is_sure and is_whole):
        return None
    return said


def unit_of(quantity: Quantity, word: str) -> str:
    """Return the unit that a word names for a quantity; empty where it names none."""
    unit = _UNITS.get(word, word)
    return unit if len(word) > 1 and quantity.unit and conversion(unit, quantity.unit) is not None else ""


def _with_unit(around: str, name: str, size: int | None) -> Meaning | None:
    """Return what a name means that ends with its unit: heading_deg, headingDeg, mag_uT, Mag (nT)."""
    *words, last_word = words_of(name) or [""]
    *parts, last_part = re.findall(r"[A-Za-z0-9%]+", name) or [""]
    for own, unit in ((words_of(" ".join(parts)), last_part), (words, last_word)):
        found = _found(around, own, size) if own else None
        if found is not None and (known := unit_of(found.quantity, unit)):
            return Meaning(found.quantity, known, found.is_sure)
    return None


def _found(around: str, own: list[str], size: int | None) -> Meaning | None:
    """Return the longest meaning: of all of a name's own words, and of those around it; an angle's of some of its own.

    What only begins like a vector is mostly another one: a derivative, an estimate, a part of a filter.
    """
    last = " ".join(own)
    text = f"{around} {last}".strip()
    if _OTHER.search(last):
        return None
    found: list[tuple[bool, int, Quantity]] = []
    for quantity, pattern in _MEANINGS.items():
        if size in (None, quantity.size):
            whole = re.search(rf"\b(?:{pattern})$", text)
            if whole is not None and len(whole[0]) >= len(last):
                found.append((True, len(whole[0]), quantity))
            elif quantity in ANGLES and (part := re.search(rf"\b(?:{pattern})\b", last)):
                found.append((False, len(part[0]), quantity))
    if not found:
        return None
    is_sure, _, quantity = max(found, key=lambda each: each[:2])
    return Meaning(quantity, "", is_sure)


def best_first(candidates: Iterable[Candidate]) -> dict[Quantity, list[Candidate]]:
    """Return candidates by quantity: sure ones first, among equals one with a unit, then the shortest."""
    found: dict[Quantity, dict[str, Candidate]] = {quantity: {} for quantity in Quantity}
    for each in sorted(candidates, key=lambda each: (not each.meaning.is_sure, each.needs_unit, len(each.written))):
        found[each.meaning.quantity].setdefault(each.written, each)
    return {quantity: [*several.values()] for quantity, several in found.items() if several}
