"""Candidates: what a name or a label in firmware may mean. All of it is a guess from words."""

from __future__ import annotations

import re
from collections.abc import Iterable, Sequence
from dataclasses import dataclass

from hiltest.device.quantities import Quantity
from hiltest.units import conversion

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
    r"\b(?:target|desired|set ?point|ref|reference|goal|old|prev|previous|init|initial|rate|delta|count|index|size|max|min"
    r"|limit|threshold|gain|scale|buffer|buf|time|cov\w*|var|noise|declination|isr|flag|packet)\b"
)  # fmt: skip


@dataclass(frozen=True, slots=True)
class Meaning:
    """What words may mean.

    Attributes
    ----------
    unit : str
        What they say of it; empty where they do not, and where there is none.
    is_sure : bool
        Whether they say this and no more.
    """

    quantity: Quantity
    unit: str
    is_sure: bool


@dataclass(frozen=True, slots=True)
class Candidate:
    """What may hold a quantity.

    Attributes
    ----------
    written : str
        Path of a variable, or regular expression of a line.
    reason : str
        What it was recognised by.
    stated_type : str
        Guessed by its size, where no debug information says it; else empty.
    """

    meaning: Meaning
    written: str
    reason: str
    stated_type: str = ""

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
    names : sequence of str
    size : int or None
        How many numbers it is; None where that is not known.
    is_whole : bool
        Whether these are integers.
    """
    around, own = " ".join(word for name in names[:-1] for word in words_of(name)), words_of(names[-1])
    said = _without_unit(around, own, size)
    if said is not None and said.quantity is Quantity.CALIBRATED and not (said.is_sure and is_whole):
        return None
    return said


def unit_of(quantity: Quantity, word: str) -> str:
    """Return the unit that a word names for a quantity; empty where it names none."""
    unit = _UNITS.get(word, word)
    return unit if len(unit) > 1 and quantity.unit and conversion(unit, quantity.unit) is not None else ""


def _without_unit(around: str, own: list[str], size: int | None) -> Meaning | None:
    if len(own) > 1 and (found := _found(around, own[:-1], size)) and (unit := unit_of(found.quantity, own[-1])):
        return Meaning(found.quantity, unit, found.is_sure)
    return _found(around, own, size)


def _found(around: str, own: list[str], size: int | None) -> Meaning | None:
    """Return the longest meaning that reaches into a name's own words."""
    last = " ".join(own)
    text = f"{around} {last}".strip()
    begin = len(text) - len(last)
    matches = [
        (match.end() - match.start(), quantity, match)
        for quantity, pattern in _MEANINGS.items() if size in (None, quantity.size)
        for match in re.finditer(rf"\b(?:{pattern})\b", text) if match.end() > begin
    ]  # fmt: skip
    if not matches or _OTHER.search(last):
        return None
    _, quantity, match = max(matches, key=lambda each: each[0])
    return Meaning(quantity, "", match.start() <= begin and match.end() == len(text))


def best_first(candidates: Iterable[Candidate]) -> dict[Quantity, list[Candidate]]:
    """Return candidates by quantity: sure ones first, among equals one with a unit, then the shortest.

    One whose text no file could hold, as damaged debug information has them, is left out.
    """
    found: dict[Quantity, dict[str, Candidate]] = {quantity: {} for quantity in Quantity}
    for each in sorted(candidates, key=lambda each: (not each.meaning.is_sure, each.needs_unit, len(each.written))):
        if each.written.isascii() and each.written.isprintable():
            found[each.meaning.quantity].setdefault(each.written, each)
    return {quantity: [*several.values()] for quantity, several in found.items() if several}
