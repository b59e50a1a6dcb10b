"""Interface to firmware that prints lines: plausible values in the fields of each, in their quantity's unit."""

from __future__ import annotations

import math
import re
from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from hiltest.interfaces.quantities import Moment, Observation, Quantity
from hiltest.interfaces.text_forms import LineForm
from hiltest.interfaces.text_lines import LONGEST_LINE, LineSplitter, Pattern, is_intact
from hiltest.measurement.units import Conversion
from hiltest.text import format_count, legible

_LONGEST_ERROR = 200
_DAMAGED = "a line has a wrong check sum"
_READY = np.ones(1)
# float() would also accept nan, infinity, 1_000 and digits of other scripts.
_NUMBER = re.compile(r"[-+]?(?:\d+(?:\.\d*)?|\.\d+)(?:[eE][-+]?\d+)?", re.ASCII)
# Magnitudes that no sensor measures, by unit: two turns; a tenth of a tesla; above the sensors for the largest shocks
# and rates.
_LARGEST = {"deg": 720.0, "uT": 1e5, "g": 1e3, "dps": 1e5, "degC": 1e3, "%": 1e5, "": 1e6}
_WORDS = {**dict.fromkeys(("true", "yes", "on"), 1.0), **dict.fromkeys(("false", "no", "off"), 0.0)}
_AXES = {
    1: ("",),
    3: ("_x", "_y", "_z"),
    4: ("_w", "_x", "_y", "_z"),
    9: tuple(f"_{row}{column}" for row in "xyz" for column in "xyz"),
}


def component_names(quantity: Quantity) -> tuple[str, ...]:
    """Return the names of a quantity's numbers.

    Examples
    --------
    >>> component_names(Quantity.HEADING), component_names(Quantity.HARD_IRON)
    (('heading',), ('hard_iron_x', 'hard_iron_y', 'hard_iron_z'))
    """
    return tuple(quantity.key + axis for axis in _AXES[quantity.size])


@dataclass(frozen=True, slots=True)
class ValueSource:
    """Source of a quantity in printed fields."""

    quantity: Quantity
    fields: tuple[str, ...]
    """Fields that hold its numbers, in order."""
    conversion: Conversion
    """Conversion from the printed unit to the quantity's, scale included."""

    def value(self, fields: Mapping[str, Sequence[str]]) -> NDArray[np.float64] | str | None:
        """Return the value in the fields of a line, or the reason why it is invalid; None if a field is missing."""
        if any(name not in fields for name in self.fields):
            return None
        texts = [text for name in self.fields for text in fields[name]]
        if len(texts) != self.quantity.size:
            return f"{len(texts)} numbers, not {self.quantity.size}"
        numbers = []
        for text in texts:
            number = self._number(text)
            if isinstance(number, str):
                return number
            numbers.append(number)
        return np.array(numbers)

    def _number(self, text: str) -> float | str:
        """Return a number in the quantity's unit, or the reason why it is invalid."""
        word = _WORDS.get(text.lower()) if self.quantity is Quantity.CALIBRATED else None
        if word is not None:
            return word
        number = float(text) if _NUMBER.fullmatch(text) else math.nan
        converted = self.conversion.factor * number + self.conversion.offset
        if math.isnan(converted):
            return f"{text[:20]!r} is not a number"
        largest = _LARGEST[self.quantity.unit]
        if not abs(converted) <= largest:
            return f"{converted:g} {self.quantity.unit} is beyond {largest:g}; check its unit and scale"
        return converted


@dataclass(frozen=True, slots=True)
class LineReading:
    """Interpretation of a line."""

    line: str
    """Text of the line."""
    values: Mapping[Quantity, NDArray[np.float64]] = field(default_factory=dict)
    error: str = ""
    """Error that the firmware reports."""
    remark: str = ""
    """Description of a line without a value, or of the uninterpreted part."""
    understood: bool = False
    """True if the line has a meaning, even without a value; also true for the first line, which may be incomplete."""
    checked: bool = False
    """True if it has a checksum, which is correct."""


class TextInterface:
    """A `StreamInterface` for lines of text.

    The first line may be incomplete, so its values are ignored; an error in it counts. A line with a wrong checksum
    (NMEA 0183) is ignored and counts as an error.

    Parameters
    ----------
    form
        Form of the lines, which locates fields.
    sources
        Fields of each quantity.
    patterns
        Patterns of the form.
    ready, error
        Patterns of lines that report a calibrated magnetometer, and an error: the group ``error``, or the whole line.
    commands
        Bytes to send at each moment.

    Attributes
    ----------
    offers : frozenset of Quantity
    not_understood : int
        Number of lines that could not be interpreted, without the first one.
    """

    def __init__(
        self,
        form: LineForm,
        sources: Sequence[ValueSource],
        *,
        patterns: Sequence[Pattern] = (),
        ready: Pattern | None = None,
        error: Pattern | None = None,
        commands: Mapping[Moment, bytes] | None = None,
    ) -> None:
        self.offers = frozenset({source.quantity for source in sources} | ({Quantity.CALIBRATED} if ready else set()))
        self.not_understood = 0
        self._patterns = [*patterns, *(pattern for pattern in (ready, error) if pattern is not None)]
        self._form = form
        self._sources = sources
        self._ready = ready
        self._error = error
        self._commands = commands or {}
        self._splitter = LineSplitter()
        self._begun = False
        self._refused: Counter[Quantity] = Counter()
        self._why_refused: dict[Quantity, str] = {}

    @property
    def given_up(self) -> tuple[str, ...]:
        """Regular expressions that were disabled because they took too long on a line."""
        return tuple(pattern.text for pattern in self._patterns if pattern.given_up)

    def remarks(self) -> tuple[str, ...]:
        """Return remarks on the values; empty without any."""
        slow = (f"disabled, since it took more than a second on a line: {text}" for text in self.given_up)
        refused = (
            f"{quantity.key} ignored {format_count(times, 'time')}: {self._why_refused[quantity]}"
            for quantity, times in self._refused.most_common()
        )
        return (*slow, *refused)

    def commands(self, moment: Moment) -> bytes:
        """Return the bytes to send at a moment; may be empty."""
        return self._commands.get(moment, b"")

    def feed(self, data: bytes, time_s: float) -> list[Observation]:
        """Decode bytes that have arrived by a time, in any segmentation; return the observations of their lines."""
        readings = [reading for reading in self.readings(data) if reading.values or reading.error]
        return [Observation(time_s, reading.values, reading.error, reading.checked) for reading in readings]

    def readings(self, data: bytes) -> list[LineReading]:
        """Decode bytes; return every line that they complete, interpreted or not."""
        readings = [self._read(line) for line in self._splitter.feed(data)]
        self.not_understood += sum(not reading.understood for reading in readings)
        return readings

    def _read(self, line: str | None) -> LineReading:
        if line is None:
            self._begun = True
            return LineReading("", remark=f"longer than {LONGEST_LINE} bytes")
        is_first, self._begun = not self._begun, True
        intact = is_intact(line)
        if intact is False and not is_first:
            return LineReading(line, error=_DAMAGED)
        match = self._form.find(line)
        values, refused = self._values(match.fields)
        complaints = [f"{quantity.key}: {why}" for quantity, why in refused.items()]
        if is_first:
            values, complaints = {}, ["the first line may have lost its beginning"]
        else:
            self._refused.update(refused.keys())
            self._why_refused = refused | self._why_refused
        if self._ready is not None and self._ready.search(line):
            values[Quantity.CALIBRATED] = _READY
        error = self._error_in(line)
        understood = bool(values or error or match.is_header or is_first)
        remarks = complaints or ([] if values or error else [match.remark])
        return LineReading(line, values, error, "; ".join(remarks), understood, checked=intact is True)

    def _values(
        self, fields: Mapping[str, Sequence[str]]
    ) -> tuple[dict[Quantity, NDArray[np.float64]], dict[Quantity, str]]:
        """Return the valid values in the fields of a line, and the reasons for invalid ones."""
        values: dict[Quantity, NDArray[np.float64]] = {}
        refused: dict[Quantity, str] = {}
        for source in self._sources:
            value = source.value(fields)
            if isinstance(value, str):
                refused[source.quantity] = value
            elif value is not None:
                values[source.quantity] = value
        return values, refused

    def _error_in(self, line: str) -> str:
        match = self._error.search(line) if self._error else None
        if match is None:
            return ""
        text = match.groupdict().get("error") or line
        return legible(text.strip())[:_LONGEST_ERROR] or "an empty line"
