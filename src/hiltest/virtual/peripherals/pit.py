"""PIT, as Python sees it: the core's library has the four periodic timers."""

from __future__ import annotations

from collections.abc import Callable

from hiltest.virtual.core.library import ffi, lib
from hiltest.virtual.part.chip import ChipPeripheral
from hiltest.virtual.peripherals.bus import ALL_STEADY
from hiltest.virtual.peripherals.core_device import CoreDevice, guarded
from hiltest.virtual.peripherals.sim import ClockGates
from hiltest.virtual.processor.clock import PICOSECONDS
from hiltest.virtual.processor.cpu import Processor

_FIRST_CHANNEL, _CHANNEL_BYTES, _CHANNELS = 0x100, 0x10, 4
_CVAL, _WORD = 0x4, 4


class PeriodicTimers(CoreDevice):
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
        _FIRST_CHANNEL + _CHANNEL_BYTES * index + byte
        for index in range(_CHANNELS)
        for byte in range(_CVAL, _CVAL + _WORD)
    )
    steady = frozenset(ALL_STEADY) - counters

    def __init__(self, processor: Processor, clocks: ClockGates, module: ChipPeripheral) -> None:
        machine = processor.machine
        self.on_expiry: Callable[[int], None] = lambda _channel: None
        self._heard: frozenset[int] = frozenset()

        self._expired = guarded(processor, "void(void *, int32_t)", lambda channel: self.on_expiry(channel))
        connections = ffi.new("struct machine_pit *")
        connections.interrupts = module.interrupts
        connections.clock, connections.time = clocks.bus.number_in(machine), clocks.time.number_in(machine)
        connections.expired = self._expired  # the library keeps only the pointer
        if not lib.machine_add_pit(machine.handle, module.base, connections[0]):
            raise MemoryError
        super().__init__(machine, module.name, module.base)

    @property
    def heard(self) -> frozenset[int]:
        """Channels whose expiries something else on the chip waits for."""
        return self._heard

    @heard.setter
    def heard(self, channels: frozenset[int]) -> None:
        self._heard = channels
        lib.machine_hear_timers(self._handle, self.base, sum(1 << channel for channel in channels))

    def enabled_s(self, index: int) -> float:
        """Virtual time at which a channel was last enabled [s since power-on]."""
        ps: int = lib.machine_timer_enabled_at(self._handle, self.base, index)
        return ps / PICOSECONDS
