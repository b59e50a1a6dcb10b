"""PIT in the core's library: the four periodic timers."""

from __future__ import annotations

from hiltest.virtual.core.library import ffi, lib
from hiltest.virtual.part.chip import ChipPeripheral
from hiltest.virtual.peripherals.bus import ALL_STEADY
from hiltest.virtual.peripherals.core_device import CoreDevice
from hiltest.virtual.peripherals.sim import ClockGates
from hiltest.virtual.processor.clock import PICOSECONDS
from hiltest.virtual.processor.cpu import Processor

_FIRST_CHANNEL, _CHANNEL_BYTES, _CHANNELS = 0x100, 0x10, 4
_CVAL, _WORD = 0x4, 4


class PeriodicTimers(CoreDevice):
    """The PIT module."""

    counters = frozenset(
        _FIRST_CHANNEL + _CHANNEL_BYTES * index + byte
        for index in range(_CHANNELS)
        for byte in range(_CVAL, _CVAL + _WORD)
    )
    steady = frozenset(ALL_STEADY) - counters

    def __init__(self, processor: Processor, clocks: ClockGates, module: ChipPeripheral) -> None:
        machine = processor.machine
        connections = module.interrupts, clocks.bus.number_in(machine), clocks.time.number_in(machine)
        if not lib.machine_add_pit(machine.handle, module.base, ffi.new("struct machine_pit *", connections)[0]):
            raise MemoryError
        super().__init__(machine, module.name, module.base)

    def enabled_s(self, index: int) -> float:
        """Return the virtual time at which a channel was last enabled [s since power-on]."""
        ps: int = lib.machine_timer_enabled_at(self._handle, self.base, index)
        return ps / PICOSECONDS
