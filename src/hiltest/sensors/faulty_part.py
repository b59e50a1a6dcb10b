"""A part that is not there for a time, or another one in its place; then it is back, as after power-on."""

from __future__ import annotations

import math
from collections.abc import Callable

from hiltest.sensors.register_device import RegisterDevice
from hiltest.state import Restorable


class FaultyPart(Restorable):
    """What answers at the address of a part.

    Parameters
    ----------
    make
        Makes the part as it is at power-on.
    begin_s, end_s
        When it loses its supply and when it has it again, virtual time since power-on [s].
    stand_in
        What answers meanwhile, at the same address; nothing without it.
    """

    def __init__(
        self, make: Callable[[], RegisterDevice], begin_s: float, end_s: float, stand_in: RegisterDevice | None = None
    ) -> None:
        self._make, self._begin_s, self._end_s, self._stand_in = make, begin_s, end_s, stand_in
        self._part = make()
        self._is_back = False
        self.address = self._part.address

    def parts(self) -> tuple[RegisterDevice, ...]:
        """Return the part that is there, or was there last, and what stands in for it."""
        return (self._part,) if self._stand_in is None else (self._part, self._stand_in)

    def start(self, reading: bool, time_s: float) -> bool:
        """Answer the device address after START or repeated START; True is ACK."""
        there = self._there(time_s)
        return there is not None and there.start(reading, time_s)

    def write(self, value: int, time_s: float) -> bool:
        """Take a byte from the master; True is ACK."""
        there = self._there(time_s)
        return there is not None and there.write(value, time_s)

    def read(self, time_s: float) -> int:
        """Give the next byte to the master: ones, where nothing pulls the line low."""
        there = self._there(time_s)
        return 0xFF if there is None else there.read(time_s)

    def stop(self, time_s: float) -> None:
        """See a STOP."""
        if there := self._there(time_s):
            there.stop(time_s)

    def interrupt_levels(self, time_s: float) -> tuple[bool, bool]:
        """Return the levels of INT1 and INT2; nothing drives those of a part that is not there."""
        there = self._there(time_s)
        return (False, False) if there is None else there.interrupt_levels(time_s)

    def next_interrupt_s(self, time_s: float) -> float:
        """Return the next time at which time alone may change a level [s]: when it goes and comes, too."""
        there = self._there(time_s)
        changes_s = [each for each in (self._begin_s, self._end_s) if each > time_s]
        return min(math.inf if there is None else there.next_interrupt_s(time_s), *changes_s, math.inf)

    def _there(self, time_s: float) -> RegisterDevice | None:
        if self._begin_s <= time_s < self._end_s:
            return self._stand_in
        if time_s >= self._end_s and not self._is_back:
            self._is_back = True
            self._part = self._make()
            self._part.power_up(self._end_s)
        return self._part
