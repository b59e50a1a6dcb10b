"""Injected faults of a virtual board: its sensors, its I2C buses, its supply."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Literal

from hiltest.rig.toml_tables import StrictTable, check_span


@dataclass(frozen=True, slots=True)
class SensorFault(StrictTable):
    """A fault of one part from `after_s` on, for `for_s` or for good."""

    part: str
    """Name of the part in ``world.fitted`` or ``[[sensors.parts]]``."""
    fault: Literal["absent", "other part", "frozen", "saturated"]
    """Kind of fault: the part does not answer; another part answers at its address; it repeats the same sample; its
    first axis is at the end of its range. An absent part returns in its power-on state."""
    after_s: float = 0.0
    for_s: float | None = None

    def __post_init__(self) -> None:
        check_span(self.after_s, self.for_s)

    def __str__(self) -> str:
        """Return it in words."""
        return f"{self.part}: {self.fault} {_when(self)}"


@dataclass(frozen=True, slots=True)
class HeldLine(StrictTable):
    """SCL or SDA of an I2C bus, 0 or 1, is pulled low from `after_s` on, for `for_s` or for good."""

    bus: Literal[0, 1]
    line: Literal["scl", "sda"]
    after_s: float = 0.0
    for_s: float | None = None

    def __post_init__(self) -> None:
        check_span(self.after_s, self.for_s)

    def __str__(self) -> str:
        """Return it in words."""
        return f"{self.line.upper()} of I2C{self.bus} held low {_when(self)}"


@dataclass(frozen=True, slots=True)
class BoardReset(StrictTable):
    """The board is reset at `after_s`: by its button, or by its supply, which the sensors lose too."""

    by: Literal["button", "brown-out"]
    after_s: float

    def __post_init__(self) -> None:
        check_span(self.after_s)

    def __str__(self) -> str:
        """Return it in words."""
        return f"{'reset by its button' if self.by == 'button' else 'a brown-out'} after {self.after_s:g} s"


def span_of(fault: SensorFault | HeldLine, began_s: float) -> tuple[float, float]:
    """Return the start and end of a fault, given that times count from `began_s`."""
    begin_s = began_s + fault.after_s
    return begin_s, math.inf if fault.for_s is None else begin_s + fault.for_s


def _when(fault: SensorFault | HeldLine) -> str:
    return f"after {fault.after_s:g} s" + ("" if fault.for_s is None else f" for {fault.for_s:g} s")
