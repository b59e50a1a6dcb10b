"""What is understood of a line's bytes, and read of variables, for people: piece by piece, and summed up."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from types import MappingProxyType

import numpy as np
from numpy.typing import NDArray

from hiltest.device.memory import MemoryInterface
from hiltest.device.quantities import Quantity, StreamInterface
from hiltest.device.text import Reading, TextInterface
from hiltest.text import format_count, format_number, legible

_MOST_REASONS = 5


@dataclass(frozen=True, slots=True)
class Heard:
    """One thing that came."""

    line: str
    """As it came, legible; the paths of variables; empty for what is neither."""
    meaning: str
    """What was understood of it, or why nothing was."""
    understood: bool


class Trial:
    """Counts what interfaces understand.

    Parameters
    ----------
    interfaces
        By their kind.
    memory
        What reads variables.
    paths
        Those of each quantity that it reads, by its name.

    Attributes
    ----------
    values : Counter of Quantity
        How often each was said.
    understood : int
        How many lines, packets or readings meant something.
    """

    def __init__(
        self, interfaces: Mapping[str, StreamInterface], memory: MemoryInterface | None = None,
        paths: Mapping[str, Sequence[str]] = MappingProxyType({}),
    ) -> None:  # fmt: skip
        self._interfaces, self._memory, self._paths = interfaces, memory, paths
        self.understood = 0
        self._reasons: Counter[str] = Counter()
        self.values: Counter[Quantity] = Counter()
        self._first_s: dict[Quantity, float] = {}
        self._last_s: dict[Quantity, float] = {}

    def take(self, data: bytes, time_s: float) -> Iterator[Heard]:
        """Yield what bytes complete."""
        for interface in self._interfaces.values():
            for reading in _readings(interface, data, time_s):
                self._count(reading.values, time_s)
                self.understood += reading.understood
                if not reading.understood:
                    self._reasons[reading.remark] += 1
                said = [_in_words(reading.values), reading.error and f"error: {reading.error}", reading.remark]
                yield Heard(legible(reading.line), "; ".join(filter(None, said)), reading.understood)

    def look(self, time_s: float) -> Iterator[Heard]:
        """Yield what the variables hold now, one by one."""
        if self._memory is None:
            return
        values = self._memory.read(time_s).values
        self._count(values, time_s)
        self.understood += 1
        said = {each.key: _in_words({each: value}) for each, value in values.items()}
        absent = {each.key: f"{each.key} has no value: {why}" for each, why in self._memory.absent.items()}
        for name, paths in self._paths.items():
            yield Heard(", ".join(paths), said.get(name) or absent[name], name in said)

    def _count(self, values: Mapping[Quantity, NDArray[np.float64]], time_s: float) -> None:
        self.values.update(values.keys())
        self._last_s.update(dict.fromkeys(values, time_s))
        self._first_s = dict.fromkeys(values, time_s) | self._first_s

    @property
    def not_understood(self) -> int:
        """How many lines or packets meant nothing."""
        return sum(interface.not_understood for interface in self._interfaces.values())

    def rate_hz(self, quantity: Quantity) -> float | None:
        """Return how often a quantity was said in a second; None where it was said once, or at one time."""
        over_s = self._last_s[quantity] - self._first_s[quantity]
        return (self.values[quantity] - 1) / over_s if over_s > 0.0 else None

    def summary(self, seconds: float) -> list[str]:
        """Return lines that sum up what came in a time."""
        rows = [f"{'quantity':<24}{'values':>8}{'per second':>13}"]
        for quantity, count in sorted(self.values.items(), key=lambda item: list(Quantity).index(item[0])):
            rate_hz = self.rate_hz(quantity)
            rate = "-" if rate_hz is None else f"{rate_hz:.1f}"
            rows.append(f"{quantity.key:<24}{format_number(count):>8}{rate:>13}")
        unseen = [each.key for each in Quantity if each not in self.values and self._offered(each)]
        return [
            f"{format_number(self.understood)} understood, {format_number(self.not_understood)} not, "
            f"in {seconds:.1f} s",
            *(rows if self.values else []),
            *([f"not seen: {', '.join(unseen)}"] if unseen else []),
            *(f"not understood, {format_count(count, 'time')}: {reason}"
              for reason, count in self._reasons.most_common(_MOST_REASONS)),
            *(said for interface in (*self._interfaces.values(), self._memory)
              if isinstance(interface, TextInterface | MemoryInterface) for said in interface.remarks()),
        ]  # fmt: skip

    def _offered(self, quantity: Quantity) -> bool:
        is_said = any(quantity in interface.offers for interface in self._interfaces.values())
        return is_said or (self._memory is not None and quantity in self._memory.offers)


def _readings(interface: StreamInterface, data: bytes, time_s: float) -> Sequence[Reading]:
    """Return what bytes complete; what is not sent as lines, without them."""
    if isinstance(interface, TextInterface):
        return interface.readings(data)
    return [Reading("", each.values, each.error, understood=True) for each in interface.feed(data, time_s)]


def _in_words(values: Mapping[Quantity, NDArray[np.float64]]) -> str:
    """Return values with names and units."""
    return ", ".join(
        f"{quantity.key} {' '.join(format_number(float(each), 5) for each in value)} {quantity.unit}".rstrip()
        for quantity, value in values.items()
    )
