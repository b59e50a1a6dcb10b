"""WDOG: the watchdog, which resets the part if firmware neither refreshes nor disables it."""

from __future__ import annotations

import math
from collections.abc import Callable

from hiltest.virtual.part.chip import mk64f12
from hiltest.virtual.peripherals.bus import ALL_STEADY, StoredRegisters
from hiltest.virtual.peripherals.sim import ClockGates
from hiltest.virtual.processor.clock import Clock
from hiltest.virtual.processor.schedule import Event

_BASE = 0x40052000
_STCTRLH, _TOVALH, _TOVALL, _WINH, _WINL, _REFRESH, _UNLOCK = 0x00, 0x04, 0x06, 0x08, 0x0A, 0x0C, 0x0E
_TMROUTH, _TMROUTL, _RSTCNT, _PRESC = 0x10, 0x12, 0x14, 0x16
_WDOGEN, _CLKSRC, _WINEN, _TESTWDOG = 1, 2, 8, 0x400
_UNLOCKING, _REFRESHING = [0xC520, 0xD928], [0xA602, 0xB480]
_LOW_POWER_OSCILLATOR_HZ = 1000
_WINDOW_BUS_CLOCKS = 256  # WCT: time for the set-up of all registers before they take effect


class Watchdog(StoredRegisters):
    """The watchdog timer.

    It is less strict than the part: its windows for set-up and for the second word of a sequence are always open, a
    wrong word causes no reset, no interrupt precedes the reset (IRQRSTEN), and a byte test takes as long as the quick
    test.

    Parameters
    ----------
    clocks
        Source of the bus clock and of the low-power oscillator of 1 kHz.
    time_out
        Called to reset the part.
    """

    counters = frozenset(range(_TMROUTH, _RSTCNT))
    steady = frozenset(ALL_STEADY) - counters

    def __init__(self, clocks: ClockGates, *, time_out: Callable[[], None]) -> None:
        self._clocks = clocks
        self._time_out = time_out
        self._event: Event | None = None
        self._resets = 0
        super().__init__("WDOG", _BASE, mk64f12().reset_bytes(_BASE))

    def power_on(self) -> None:
        """Clear the count of resets."""
        self._resets = 0

    def reset(self) -> None:
        """Return to the state after a chip reset, with a stopped count."""
        super().reset()
        self._unlock: list[int] = []
        self._refresh: list[int] = []
        self._since = 0  # in ticks of the selected clock
        if self._event is not None:
            self._event.cancel()
            self._event = None

    @property
    def enabled(self) -> bool:
        """Return whether the watchdog is enabled."""
        return bool(self._bytes[_STCTRLH] & _WDOGEN)

    def start(self) -> None:
        """Restart the count from zero."""
        self._since = self._clock.now()
        # A refresh does not reschedule the event: `_check_due` is then called too early, and schedules the event again.
        if self.enabled and self._event is None:
            self._plan()

    def _plan(self) -> None:
        # The event does not count as wake-up: endless sleep and a branch to itself are reported as a hang at once.
        self._event = self._clock.call_at(self._due, self._check_due, wakes=False)

    def read(self, offset: int, size: int) -> int:
        """Return registers; TMROUT is the present count, RSTCNT the number of resets by the watchdog."""
        if offset in (_TMROUTH, _TMROUTL):
            count = self._count if self.enabled else 0
            return count >> 16 if offset == _TMROUTH else count & 0xFFFF
        return self._resets if offset == _RSTCNT else super().read(offset, size)

    def write(self, offset: int, size: int, value: int) -> None:
        """Write a register; STCTRLH only after the unlock sequence."""
        if offset == _UNLOCK:
            self._unlock = [*self._unlock[-1:], value]
        elif offset == _REFRESH:
            self._refresh = [*self._refresh[-1:], value]
            if self._refresh == _REFRESHING:
                self._restart()
        elif offset == _RSTCNT:
            self._resets &= ~value
        elif offset != _STCTRLH or self._unlock == _UNLOCKING:
            super().write(offset, size, value)
            self._set_up()

    def _restart(self) -> None:
        """Restart the count; a refresh before an enabled window opens resets the part."""
        opens_at = self._half(_WINH) << 16 | self._half(_WINL)
        if self.enabled and self._bytes[_STCTRLH] & _WINEN and self._count < opens_at:
            self._expire()
        self.start()

    def _expire(self) -> None:
        self._resets += 1
        self._time_out()

    def _set_up(self) -> None:
        """Count from the end of the set-up window, with the present settings."""
        if self._event is not None:
            self._event.cancel()
            self._event = None
        bus = self._clocks.bus
        opened_until = bus.cycle_of(bus.now() + _WINDOW_BUS_CLOCKS)
        self._since = self._clock.ticks_at(int(opened_until)) if math.isfinite(opened_until) else self._clock.now()
        if self.enabled:
            self._plan()

    def _half(self, offset: int) -> int:
        return int.from_bytes(self._bytes[offset : offset + 2], "little")

    @property
    def _clock(self) -> Clock:
        fast = self._half(_STCTRLH) & (_CLKSRC | _TESTWDOG)  # a test counts the bus clock too
        return self._clocks.bus if fast else self._clocks.low_power

    @property
    def _divider(self) -> int:
        return (self._half(_PRESC) >> 8 & 7) + 1

    @property
    def _count(self) -> int:
        """Divided ticks since the last refresh."""
        return max(self._clock.now() - self._since, 0) // self._divider

    @property
    def _due(self) -> int:
        """Time-out, in ticks of the selected clock."""
        return self._since + (self._half(_TOVALH) << 16 | self._half(_TOVALL)) * self._divider

    def _check_due(self) -> None:
        self._event = None
        if self._due > self._clock.now():
            self._plan()
        else:
            self._expire()
