"""The wires from a part's interrupt pins."""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import Protocol

from hiltest.virtual.i2c_bus import I2cDevice
from hiltest.virtual.schedule import Event, Schedule

#: Told the new level of a pin, True is high.
Wire = Callable[[bool], None]


class InterruptSource(I2cDevice, Protocol):
    """A part on the bus with two interrupt pins; times are virtual seconds since power-on."""

    def interrupt_levels(self, time_s: float) -> tuple[bool, bool]:
        """Levels of INT1 and INT2, True is high."""
        ...

    def next_interrupt_s(self, time_s: float) -> float:
        """Next time at which time alone may change a level; infinity when an access must come first."""
        ...


class InterruptWires:
    """Keeps two wires at the levels of a part's pins.

    A part says when it may raise a pin by itself, so nothing is looked at while nothing
    can happen; what an access changes is seen at its end, by `look`.

    Parameters
    ----------
    source : InterruptSource
        The part.
    wires : (2,)
        Where INT1 and INT2 lead; None is not connected.
    schedule : Schedule
        The board's calendar.
    core_hz : float
        What a clock cycle of virtual time is worth [Hz].
    """

    def __init__(
        self, source: InterruptSource, wires: tuple[Wire | None, Wire | None], schedule: Schedule, *, core_hz: float
    ) -> None:
        self._source = source
        self._wires = wires
        self._schedule = schedule
        self._core_hz = core_hz
        self._levels: tuple[bool | None, bool | None] = (None, None)
        self._event: Event | None = None

    def look(self, cycle: float) -> None:
        """Take over the levels as they are at a cycle, and come back when they may change."""
        time_s = cycle / self._core_hz
        levels = self._source.interrupt_levels(time_s)
        before, self._levels = self._levels, levels
        for wire, level, old in zip(self._wires, levels, before, strict=True):
            if wire is not None and level is not old:
                wire(level)
        self._come_back(self._source.next_interrupt_s(time_s))

    def _come_back(self, time_s: float) -> None:
        if self._event is not None:
            self._event.cancel()
            self._event = None
        if math.isfinite(time_s):
            cycle = math.ceil(time_s * self._core_hz)
            self._event = self._schedule.at(cycle, lambda: self.look(cycle))
