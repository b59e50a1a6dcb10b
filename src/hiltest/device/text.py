"""Firmware that prints lines: what it says of itself."""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from hiltest.device.quantities import Moment, Observation, Quantity
from hiltest.device.text_forms import Form
from hiltest.device.text_lines import LONGEST_LINE, LineSplitter, Pattern, is_intact
from hiltest.device.text_values import ValueSource
from hiltest.text import format_count, legible

_LONGEST_ERROR = 200
_DAMAGED = "a line has another check sum than it says"
_READY = np.ones(1)


@dataclass(frozen=True, slots=True)
class Reading:
    """What was understood of a line."""

    line: str
    """As it came."""
    values: Mapping[Quantity, NDArray[np.float64]] = field(default_factory=dict)
    error: str = ""
    """What the firmware reports to be wrong."""
    remark: str = ""
    """What the line is instead, or what was not understood of it."""
    understood: bool = False
    """It has a meaning, be it without a value; or it is the first, of which that is not known."""
    checked: bool = False
    """It carries a check sum, which is right."""


class TextInterface:
    """A `StreamInterface` that understands lines.

    The first line may be the end of one, so its values are not taken; what it says of errors is. Of a line
    whose check sum (NMEA 0183) is wrong nothing is taken: it is an error.

    Parameters
    ----------
    form
        Where fields stand in a line.
    sources
        Which fields are which quantity.
    patterns
        Those of the form.
    ready, error
        Of lines that say that the magnetometer is calibrated, and that something is wrong: the group ``error``, or
        the whole line.
    commands
        What is sent when.

    Attributes
    ----------
    offers : frozenset of Quantity
    not_understood : int
        Lines without a meaning; the first one is not among them.
    """

    def __init__(
        self, form: Form, sources: Sequence[ValueSource], *, patterns: Sequence[Pattern] = (),
        ready: Pattern | None = None, error: Pattern | None = None, commands: Mapping[Moment, bytes] | None = None,
    ) -> None:  # fmt: skip
        self.offers = frozenset({source.quantity for source in sources} | ({Quantity.CALIBRATED} if ready else set()))
        self.not_understood = 0
        self._patterns = [*patterns, *(each for each in (ready, error) if each is not None)]
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
        """Regular expressions that took too long in a line, and find nothing any more."""
        return tuple(pattern.text for pattern in self._patterns if pattern.given_up)

    def remarks(self) -> tuple[str, ...]:
        """Return what a reader of the values should know; empty where all is plain."""
        slow = (f"given up, since it took more than a second in a line: {text}" for text in self.given_up)
        refused = (
            f"{quantity.key} not taken {format_count(times, 'time')}: {self._why_refused[quantity]}"
            for quantity, times in self._refused.most_common()
        )
        return (*slow, *refused)

    def commands(self, moment: Moment) -> bytes:
        """Return what is to be sent at a moment; may be empty."""
        return self._commands.get(moment, b"")

    def feed(self, data: bytes, time_s: float) -> list[Observation]:
        """Take bytes that have arrived by a time, however they are cut; return what their lines say."""
        said = [reading for reading in self.readings(data) if reading.values or reading.error]
        return [Observation(time_s, each.values, each.error, each.checked) for each in said]

    def readings(self, data: bytes) -> list[Reading]:
        """Take bytes; return every line that they complete, understood or not."""
        readings = [self._read(line) for line in self._splitter.feed(data)]
        self.not_understood += sum(not reading.understood for reading in readings)
        return readings

    def _read(self, line: str | None) -> Reading:
        if line is None:
            self._begun = True
            return Reading("", remark=f"longer than {LONGEST_LINE} bytes")
        is_first, self._begun = not self._begun, True
        intact = is_intact(line)
        if intact is False and not is_first:
            return Reading(line, error=_DAMAGED)
        found = self._form.find(line)
        values, refused = self._values(found.fields)
        complaints = [f"{quantity.key}: {why}" for quantity, why in refused.items()]
        if is_first:
            values, complaints = {}, ["the first line may have lost its beginning"]
        else:
            self._refused.update(refused.keys())
            self._why_refused = refused | self._why_refused
        if self._ready is not None and self._ready.search(line):
            values[Quantity.CALIBRATED] = _READY
        error = self._error_in(line)
        understood = bool(values or error or found.is_header or is_first)
        remarks = complaints or ([] if values or error else [found.remark])
        return Reading(line, values, error, "; ".join(remarks), understood, checked=intact is True)

    def _values(
        self, fields: Mapping[str, Sequence[str]]
    ) -> tuple[dict[Quantity, NDArray[np.float64]], dict[Quantity, str]]:
        """Return the values in the fields of a line, and what is wrong with others."""
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
