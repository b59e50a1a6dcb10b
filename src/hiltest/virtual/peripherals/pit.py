"""PIT: four periodic timers on the bus clock, chainable."""

from __future__ import annotations

import math

from hiltest.virtual.cpu import Processor
from hiltest.virtual.peripherals.clocks import ClockGates
from hiltest.virtual.schedule import Event

_FIRST_CHANNEL, _CHANNELS = 0x100, 4
_LDVAL, _CVAL, _TCTRL, _TFLG = 0x0, 0x4, 0x8, 0xC
_TEN, _TIE, _CHN = 1, 2, 4
_FIRST_INTERRUPT = 48


class _Channel:
    def __init__(self) -> None:
        self.load = 0
        self.control = 0
        self.flag = False  # latched: what `_flag` adds are expiries that no interrupt has shown
        self.started_at = 0  # in ticks of what it counts
        self.cleared_at = 0  # in expiries since then
        self.event: Event | None = None


class PeriodicTimers:
    """The PIT module.

    Parameters
    ----------
    processor : Processor
        Time and interrupts.
    clocks : ClockGates
        The module clock is the bus clock.
    """

    name = "PIT"
    base = 0x40037000

    def __init__(self, processor: Processor, clocks: ClockGates) -> None:
        self.clocked = True
        self._processor = processor
        self._clocks = clocks
        self._channels: list[_Channel] = []
        self.reset()

    def reset(self) -> None:
        """Return to the state after reset: all timers disabled."""
        for channel in self._channels:
            if channel.event is not None:
                channel.event.cancel()
        self._channels = [_Channel() for _ in range(_CHANNELS)]
        self._mcr = 0x06

    def began_cycles(self, index: int) -> float:
        """Return when a channel that counts bus clocks was last enabled, in core cycles since power-on."""
        return self._channels[index].started_at * self._core_cycles_a_tick

    @property
    def _core_cycles_a_tick(self) -> float:
        return self._clocks.core_hz / self._clocks.bus_hz

    def _ticks(self, index: int) -> int:
        """Ticks that reach a channel up to now: bus clocks, or expiries of the channel before."""
        channel = self._channels[index]
        if channel.control & _CHN and index > 0:
            return self._expiries(index - 1)
        return int(self._processor.now() / self._core_cycles_a_tick)

    def _expiries(self, index: int) -> int:
        channel = self._channels[index]
        if not channel.control & _TEN:
            return 0
        return (self._ticks(index) - channel.started_at) // (channel.load + 1)

    def _flag(self, index: int) -> bool:
        channel = self._channels[index]
        return channel.flag or self._expiries(index) > channel.cleared_at

    def _period(self, index: int) -> float:
        """Bus clocks from one expiry of a channel to the next; infinite where nothing counts."""
        channel = self._channels[index]
        if not channel.control & _TEN:
            return math.inf
        return (channel.load + 1) * (self._period(index - 1) if channel.control & _CHN and index > 0 else 1)

    def _until_expiry(self, index: int) -> float:
        """Bus clocks up to the next expiry of a channel."""
        channel = self._channels[index]
        if not channel.control & _TEN:
            return math.inf
        if channel.control & _CHN and index > 0:
            return self._until_expiry(index - 1) + self._value(index) * self._period(index - 1)
        return self._value(index) + 1

    def _value(self, index: int) -> int:
        channel = self._channels[index]
        if not channel.control & _TEN:
            return 0
        return channel.load - (self._ticks(index) - channel.started_at) % (channel.load + 1)

    def read(self, offset: int, size: int) -> int:
        """Answer a word register."""
        if offset == 0:
            return self._mcr
        index, register = divmod(offset - _FIRST_CHANNEL, 0x10)
        if not 0 <= index < _CHANNELS:
            return 0
        channel = self._channels[index]
        if register == _CVAL:
            return self._value(index)
        return {_LDVAL: channel.load, _TCTRL: channel.control, _TFLG: int(self._flag(index))}.get(register, 0)

    def write(self, offset: int, size: int, value: int) -> None:
        """Take a word register."""
        if offset == 0:
            self._mcr = value
            return
        index, register = divmod(offset - _FIRST_CHANNEL, 0x10)
        if not 0 <= index < _CHANNELS:
            return
        channel = self._channels[index]
        if register == _LDVAL:
            channel.load = value
        elif register == _TCTRL:
            channel.flag = self._flag(index)
            enabling = value & _TEN and not channel.control & _TEN
            channel.control = value
            if enabling:
                channel.started_at = self._ticks(index)
            channel.cleared_at = self._expiries(index)
            for later in range(index, _CHANNELS):  # those chained to it begin or cease to count with it
                self._plan(later)
        elif register == _TFLG and value & 1:
            channel.flag = False
            channel.cleared_at = self._expiries(index)
        self._drive(index)

    def _plan(self, index: int) -> None:
        """Schedule the next expiry of a channel that interrupts; those of others are not seen."""
        channel = self._channels[index]
        if channel.event is not None:
            channel.event.cancel()
            channel.event = None
        left = self._until_expiry(index) * self._core_cycles_a_tick
        if channel.control & _TIE and left < math.inf:
            channel.event = self._processor.schedule.at(self._processor.now() + left, lambda: self._expire(index))

    def _expire(self, index: int) -> None:
        channel = self._channels[index]
        channel.flag = True
        channel.cleared_at = self._expiries(index)
        self._drive(index)
        self._plan(index)

    def _drive(self, index: int) -> None:
        channel = self._channels[index]
        self._processor.nvic.set_line(_FIRST_INTERRUPT + index, bool(channel.control & _TIE) and self._flag(index))
