"""Wires from the interrupt pins of sensors."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from functools import partial
from typing import Protocol

from hiltest.state import Restorable
from hiltest.virtual.peripherals.i2c_bus import I2cDevice
from hiltest.virtual.peripherals.spi_bus import SpiDevice
from hiltest.virtual.processor.clock import PICOSECONDS, Clock
from hiltest.virtual.processor.schedule import Event

#: Called with the new level of a pin; True is high.
Wire = Callable[[bool], None]


class InterruptSource(I2cDevice, SpiDevice, Protocol):
    """A part on the bus with interrupt pins; times are virtual seconds since power-on."""

    @property
    def pins(self) -> tuple[str, ...]:
        """Names of the pins."""
        ...

    def interrupt_levels(self, time_s: float) -> tuple[bool, ...]:
        """Return the levels of the pins; True is high."""
        ...

    def next_interrupt_s(self, time_s: float) -> float:
        """Return the next time at which a level may change without an access; infinity if it cannot."""
        ...


class InterruptWires(Restorable):
    """Wires with the levels of a part's interrupt pins.

    The part is not polled, because it predicts when a level may change by itself. The caller
    calls `update` at the end of each access to the part.

    Parameters
    ----------
    wires
        Called for each pin in order; None is not connected.
    time
        Virtual time in picoseconds.
    """

    def __init__(self, source: InterruptSource, wires: Sequence[Wire | None], time: Clock) -> None:
        self._source = source
        self._wires = wires
        self._time = time
        self._levels: tuple[bool | None, ...] = (None,) * len(wires)
        self._event: Event | None = None
        self._planned_s = math.inf  # time of the event; infinity without one

    def update(self) -> None:
        """Pass on the present levels, and schedule the next update."""
        self._update_at(self._time.now())

    def _reach(self, ps: int) -> None:
        self._planned_s = math.inf
        self._update_at(ps)

    def _update_at(self, ps: int) -> None:
        time_s = ps / PICOSECONDS
        levels = self._source.interrupt_levels(time_s)
        before, self._levels = self._levels, levels
        for wire, level, old in zip(self._wires, levels, before, strict=True):
            if wire is not None and level is not old:
                wire(level)
        self._schedule_update(self._source.next_interrupt_s(time_s))

    def _schedule_update(self, time_s: float) -> None:
        if time_s == self._planned_s:
            return
        if self._event is not None:
            self._event.cancel()
            self._event = None
        self._planned_s = time_s
        if math.isfinite(time_s):
            ps = math.ceil(time_s * PICOSECONDS)
            self._event = self._time.call_at(ps, partial(self._reach, ps))
