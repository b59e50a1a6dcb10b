"""PIT: four periodic timers on the bus clock, chainable."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass

from hiltest.virtual.chip import ChipPeripheral
from hiltest.virtual.cpu import Processor
from hiltest.virtual.peripherals.bus import ALL_STEADY
from hiltest.virtual.peripherals.clocks import ClockGates
from hiltest.virtual.schedule import Event
from hiltest.virtual.turn import Counting

_MCR, _FIRST_CHANNEL, _CHANNELS = 0x0, 0x100, 4
_LDVAL, _CVAL, _TCTRL, _TFLG = 0x0, 0x4, 0x8, 0xC
_MDIS = 2
_TEN, _TIE, _CHN = 1, 2, 4


def _register(index: int, offset: int) -> int:
    return _FIRST_CHANNEL + 0x10 * index + offset


@dataclass(slots=True)
class _Channel:
    load: int = 0  # LDVAL: taken over at the next expiry
    reload: int = 0  # what this round began with
    control: int = 0
    flag: bool = False
    began: int = 0  # of this round, in ticks of what it counts
    expiries: int = 0
    enabled_s: float = 0.0
    event: Event | None = None


class PeriodicTimers:
    """The PIT module.

    Parameters
    ----------
    processor : Processor
        Interrupts.
    clocks : ClockGates
        The module clock is the bus clock.
    module : ChipPeripheral
        Its addresses and interrupts.

    Attributes
    ----------
    on_expiry : callable
        Told which channel has expired, of those that are heard.
    """

    counters = frozenset(
        byte for index in range(_CHANNELS) for byte in range(_register(index, _CVAL), _register(index, _CVAL) + 4)
    )
    steady = frozenset(ALL_STEADY) - counters

    def __init__(self, processor: Processor, clocks: ClockGates, module: ChipPeripheral) -> None:
        self.on_expiry: Callable[[int], None] = lambda _channel: None
        self._heard: frozenset[int] = frozenset()
        self.name = module.name
        self.base = module.base
        self.clocked = True
        self._interrupts = module.interrupts
        self._nvic = processor.nvic
        self._accounting = processor.accounting
        self._clocks = clocks
        self._channels: list[_Channel] = []
        self.reset()

    def reset(self) -> None:
        """Return to the state after reset: the module and all timers disabled."""
        for channel in self._channels:
            if channel.event is not None:
                channel.event.cancel()
        self._channels = [_Channel() for _ in range(_CHANNELS)]
        self._mcr = 0x06
        self._held = 0  # ticks that have reached the timers, while the module is disabled
        self._lost = 0  # ticks of the bus clock that never did

    @property
    def heard(self) -> frozenset[int]:
        """Channels whose expiries something else on the chip waits for."""
        return self._heard

    @heard.setter
    def heard(self, channels: frozenset[int]) -> None:
        if channels != self._heard:
            self._advance(_CHANNELS - 1)
            self._heard = channels
            self._plan()

    def enabled_s(self, index: int) -> float:
        """Virtual time at which a channel was last enabled [s since power-on]."""
        return self._channels[index].enabled_s

    # -- counting -----------------------------------------------------------------------------

    def _ticks(self) -> int:
        return self._held if self._mcr & _MDIS else self._clocks.bus.now() - self._lost

    def _advance(self, last: int) -> None:
        """Count up to now, from the first channel to `last`: each may count the expiries of the one before."""
        ticks = self._ticks()
        for index, channel in enumerate(self._channels[: last + 1]):
            if channel.control & _TEN:
                elapsed = self._counted(index, ticks) - channel.began
                if elapsed > channel.reload:
                    more = (elapsed - channel.reload - 1) // (channel.load + 1)
                    channel.began += channel.reload + 1 + more * (channel.load + 1)
                    channel.expiries += 1 + more
                    channel.reload = channel.load
                    channel.flag = True
                    if index in self._heard:
                        self.on_expiry(index)

    def _counted(self, index: int, ticks: int) -> int:
        """Ticks of what a channel counts."""
        chained = self._channels[index].control & _CHN and index > 0
        return self._channels[index - 1].expiries if chained else ticks

    def _value(self, index: int) -> int:
        channel = self._channels[index]
        if not channel.control & _TEN:
            return 0
        return channel.reload - (self._counted(index, self._ticks()) - channel.began)

    def _period(self, index: int) -> float:
        """Bus clocks from one expiry of a channel to the next; infinite where nothing counts."""
        channel = self._channels[index]
        if not channel.control & _TEN:
            return math.inf
        return (channel.load + 1) * (self._period(index - 1) if channel.control & _CHN and index > 0 else 1)

    def _until_expiry(self, index: int) -> float:
        """Bus clocks up to the next expiry of a channel."""
        channel = self._channels[index]
        if not channel.control & _TEN or self._mcr & _MDIS:
            return math.inf
        if channel.control & _CHN and index > 0:
            rounds = self._value(index)  # of the channel before, behind the one that is under way
            return self._until_expiry(index - 1) + (rounds * self._period(index - 1) if rounds else 0)
        return self._value(index) + 1

    def _expires_at(self, index: int) -> float:
        """Return the cycle of the core at which a channel expires next."""
        left = self._until_expiry(index)
        return self._clocks.bus.cycle_of(self._clocks.bus.now() + int(left)) if left < math.inf else math.inf

    def counting(self, offset: int) -> Counting:
        """Return how a channel counts: down, until it expires."""
        index = (offset - _FIRST_CHANNEL) // 0x10
        self._advance(index)
        channel, bus, lost = self._channels[index], self._clocks.bus, self._lost
        if not channel.control & _TEN or self._mcr & _MDIS or channel.control & _CHN:
            value = self._value(index)  # one that is chained stands still until that before it expires
            return Counting(lambda _cycle: value, rises=False, until=self._chain_moves_at(index))
        start = channel.reload + channel.began + lost
        return Counting(lambda cycle: start - bus.ticks_at(cycle), rises=False, until=self._expires_at(index))

    def _chain_moves_at(self, index: int) -> float:
        """Return the cycle at which a channel that counts another's expiries counts one."""
        chained = self._channels[index].control & _CHN and index > 0
        return self._expires_at(index - 1) if chained else math.inf

    # -- registers ----------------------------------------------------------------------------

    def read(self, offset: int, size: int) -> int:
        """Answer a word register."""
        if offset == _MCR:
            return self._mcr
        index, register = divmod(offset - _FIRST_CHANNEL, 0x10)
        if not 0 <= index < _CHANNELS:
            return 0
        self._advance(index)
        channel = self._channels[index]
        if register == _CVAL:
            return self._value(index)
        if register == _TFLG and not channel.flag:
            self._accounting.steady_until(self._expires_at(index))
        return {_LDVAL: channel.load, _TCTRL: channel.control, _TFLG: int(channel.flag)}.get(register, 0)

    def write(self, offset: int, size: int, value: int) -> None:
        """Take a word register."""
        self._advance(_CHANNELS - 1)
        if offset == _MCR:
            self._enable_module(value)
            return
        index, register = divmod(offset - _FIRST_CHANNEL, 0x10)
        if not 0 <= index < _CHANNELS:
            return
        channel = self._channels[index]
        if register == _LDVAL:
            channel.load = value
        elif register == _TCTRL:
            self._control(index, value & 7)
        elif register == _TFLG and value & 1:
            channel.flag = False
        self._plan()
        self._drive()

    def _enable_module(self, value: int) -> None:
        ticks = self._ticks()
        self._mcr = value & 3
        self._held, self._lost = ticks, self._clocks.bus.now() - ticks
        self._plan()
        self._drive()

    def _control(self, index: int, value: int) -> None:
        channel, ticks = self._channels[index], self._ticks()
        elapsed = self._counted(index, ticks) - channel.began
        enabling = value & _TEN and not channel.control & _TEN
        channel.control = value
        if enabling:
            channel.reload, elapsed = channel.load, 0
            channel.enabled_s = self._clocks.time_s()
        channel.began = self._counted(index, ticks) - elapsed

    def _plan(self) -> None:
        """Schedule the next expiry of each channel that interrupts or is heard; those of others are not seen."""
        for index, channel in enumerate(self._channels):
            if channel.event is not None:
                channel.event.cancel()
                channel.event = None
            seen = channel.control & _TIE or index in self._heard
            left = self._until_expiry(index) if seen else math.inf
            if left < math.inf:
                channel.event = self._clocks.bus.after(int(left), self._expire)

    def _expire(self) -> None:
        self._advance(_CHANNELS - 1)
        self._drive()
        self._plan()

    def _drive(self) -> None:
        for channel, interrupt in zip(self._channels, self._interrupts, strict=True):
            self._nvic.set_line(interrupt, bool(channel.control & _TIE) and channel.flag)
