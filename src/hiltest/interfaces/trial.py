"""Interpretation of a line's bytes, and readings of variables, as text: piece by piece, and as a summary."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from types import MappingProxyType

import numpy as np
from numpy.typing import NDArray

from hiltest.interfaces.kinds import feed_decoder
from hiltest.interfaces.line_input import LineInput
from hiltest.interfaces.memory_interface import MemoryInterface
from hiltest.interfaces.quantities import Quantity, StreamInterface
from hiltest.interfaces.text_interface import LineReading, TextInterface
from hiltest.text import format_count, format_number, legible

_MOST_REASONS = 5


@dataclass(frozen=True, slots=True)
class Heard:
    """One received line, packet or value."""

    line: str
    """Received text, sanitised; or the paths of variables; otherwise empty."""
    meaning: str
    """Its interpretation, or the reason why there is none."""
    understood: bool


class Trial:
    """Counter of the values that interfaces decode.

    Parameters
    ----------
    interfaces
        Interfaces by their kind.
    memory
        Interface that reads variables.
    paths
        Paths of each quantity that it reads, by its name.

    Attributes
    ----------
    values : Counter of Quantity
        Number of values of each quantity.
    understood : int
        Number of interpreted lines, packets or readings.
    """

    def __init__(
        self,
        interfaces: Mapping[str, StreamInterface],
        memory: MemoryInterface | None = None,
        paths: Mapping[str, Sequence[str]] = MappingProxyType({}),
    ) -> None:
        self._interfaces, self._memory, self._paths = interfaces, memory, paths
        self.understood = 0
        self._input = LineInput()
        self._reasons: Counter[str] = Counter()
        self.values: Counter[Quantity] = Counter()
        self._first_s: dict[Quantity, float] = {}
        self._last_s: dict[Quantity, float] = {}

    def take(self, data: bytes, time_s: float) -> Iterator[Heard]:
        """Yield the lines or packets that bytes complete."""
        self._input.take(data)
        for kind, interface in self._interfaces.items():
            for reading in _readings(kind, interface, data, time_s):
                self._count(reading.values, time_s)
                self.understood += reading.understood
                if not reading.understood:
                    self._reasons[reading.remark] += 1
                texts = [_format_values(reading.values), reading.error and f"error: {reading.error}", reading.remark]
                yield Heard(legible(reading.line), "; ".join(filter(None, texts)), reading.understood)

    def look(self, time_s: float) -> Iterator[Heard]:
        """Yield the present values of the variables, one by one."""
        if self._memory is None:
            return
        values = self._memory.read(time_s).values
        self._count(values, time_s)
        self.understood += 1
        texts = {quantity.key: _format_values({quantity: value}) for quantity, value in values.items()}
        absent = {quantity.key: f"{quantity.key} has no value: {why}" for quantity, why in self._memory.absent.items()}
        for name, paths in self._paths.items():
            yield Heard(", ".join(paths), texts.get(name) or absent[name], name in texts)

    def _count(self, values: Mapping[Quantity, NDArray[np.float64]], time_s: float) -> None:
        self.values.update(values.keys())
        self._last_s.update(dict.fromkeys(values, time_s))
        self._first_s = dict.fromkeys(values, time_s) | self._first_s

    @property
    def not_understood(self) -> int:
        """Number of lines or packets that could not be interpreted."""
        return sum(interface.not_understood for interface in self._interfaces.values())

    def rate_hz(self, quantity: Quantity) -> float | None:
        """Return the rate of a quantity [Hz]; None if it came once, or at one time only."""
        over_s = self._last_s[quantity] - self._first_s[quantity]
        return (self.values[quantity] - 1) / over_s if over_s > 0.0 else None

    def remark(self, seconds: float, wrong_speed: str) -> str:
        """Return why nothing can be interpreted, see `LineInput.remark`; empty if something was, or without a line."""
        if self.values or not self._interfaces:
            return ""
        is_text = all(isinstance(interface, TextInterface) for interface in self._interfaces.values())
        return self._input.remark(seconds, wrong_speed=wrong_speed, is_text=is_text)

    def summary(self, seconds: float, wrong_speed: str = "") -> list[str]:
        """Return lines that summarise the values of an interval; for `wrong_speed` see `LineInput.remark`."""
        remark = self.remark(seconds, wrong_speed)
        rows = [f"{'quantity':<24}{'values':>8}{'per second':>13}"]
        for quantity, count in sorted(self.values.items(), key=lambda item: list(Quantity).index(item[0])):
            rate_hz = self.rate_hz(quantity)
            rate = "-" if rate_hz is None else f"{rate_hz:.1f}"
            rows.append(f"{quantity.key:<24}{format_number(count):>8}{rate:>13}")
        unseen = [quantity.key for quantity in Quantity if quantity not in self.values and self._is_offered(quantity)]
        return [
            f"{format_number(self.understood)} understood, {format_number(self.not_understood)} not, "
            f"in {seconds:.1f} s",
            *([remark] if remark else []),
            *(rows if self.values else []),
            *([f"not seen: {', '.join(unseen)}"] if unseen else []),
            *(
                f"not understood, {format_count(count, 'time')}: {reason}"
                for reason, count in self._reasons.most_common(_MOST_REASONS)
            ),
            *(
                remark
                for interface in (*self._interfaces.values(), self._memory)
                if isinstance(interface, TextInterface | MemoryInterface)
                for remark in interface.remarks()
            ),
        ]

    def _is_offered(self, quantity: Quantity) -> bool:
        is_said = any(quantity in interface.offers for interface in self._interfaces.values())
        return is_said or (self._memory is not None and quantity in self._memory.offers)


def _readings(kind: str, interface: StreamInterface, data: bytes, time_s: float) -> Sequence[LineReading]:
    """Return the readings that bytes complete; without text if the interface has no lines."""
    if isinstance(interface, TextInterface):
        return interface.readings(data)
    return [
        LineReading("", observation.values, observation.error, understood=True)
        for observation in feed_decoder(kind, interface, data, time_s)
    ]


def _format_values(values: Mapping[Quantity, NDArray[np.float64]]) -> str:
    """Format values with names and units."""
    return ", ".join(
        f"{quantity.key} {' '.join(format_number(float(number), 5) for number in value)} {quantity.unit}".rstrip()
        for quantity, value in values.items()
    )
