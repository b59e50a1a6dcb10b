"""DMAMUX: which source of requests each channel of the eDMA listens to."""

from __future__ import annotations

from collections.abc import Callable

from hiltest.virtual.part.chip import ChipPeripheral
from hiltest.virtual.peripherals.bus import StoredRegisters
from hiltest.virtual.peripherals.pit import PeriodicTimers

_ENBL, _TRIG, _SOURCE = 0x80, 0x40, 0x3F
_ALWAYS_ON = range(58, 64)
_TRIGGERED = 4  # channels that a timer of the PIT can hold back, each its own
CHANNELS = 16


class DmaMultiplexer(StoredRegisters):
    """The DMA channel multiplexer.

    Parameters
    ----------
    module : ChipPeripheral
        Its address.
    timers : PeriodicTimers
        Let requests of triggered channels through, one an expiry.

    Attributes
    ----------
    on_request : callable
        Told that a channel may be requested.
    """

    def __init__(self, module: ChipPeripheral, timers: PeriodicTimers) -> None:
        self.on_request: Callable[[], None] = lambda: None
        self._sources: set[int] = set()
        self._triggered: set[int] = set()
        self._timers = timers
        super().__init__(module.name, module.base)
        timers.on_expiry = self._trigger

    def reset(self) -> None:
        """Return to the state after reset: every channel is disabled."""
        super().reset()
        self._triggered.clear()
        self._timers.heard = frozenset()

    def write(self, offset: int, size: int, value: int) -> None:
        """Take the configuration of channels."""
        super().write(offset, size, value)
        heard = {channel for channel in range(_TRIGGERED) if self._bytes[channel] & _TRIG}
        self._triggered &= heard
        self._timers.heard = frozenset(heard)
        self.on_request()

    def set_request(self, source: int, level: bool) -> None:
        """Set the request of a source."""
        if not level:
            self._sources.discard(source)
        elif source not in self._sources:
            self._sources.add(source)
            self.on_request()

    def requests(self, channel: int) -> bool:
        """Whether a channel is requested."""
        held_back = channel < _TRIGGERED and self._bytes[channel] & _TRIG
        return self._asked(channel) and (not held_back or channel in self._triggered)

    def served(self, channel: int) -> None:
        """Take note that a channel has begun what it was requested for."""
        self._triggered.discard(channel)

    def _asked(self, channel: int) -> bool:
        configuration = self._bytes[channel]
        source = configuration & _SOURCE
        return bool(configuration & _ENBL) and (source in self._sources or source in _ALWAYS_ON)

    def _trigger(self, channel: int) -> None:
        if self._asked(channel):
            self._triggered.add(channel)
            self.on_request()
