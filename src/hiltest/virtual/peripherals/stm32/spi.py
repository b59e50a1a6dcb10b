"""SPI, in the core's library (core/stm32_spi.c)."""

from __future__ import annotations

from hiltest.virtual.core.library import ffi, guarded_callback, lib
from hiltest.virtual.part.chip import ChipPeripheral
from hiltest.virtual.peripherals.bus import ALL_STEADY
from hiltest.virtual.peripherals.core_device import CoreDevice
from hiltest.virtual.peripherals.spi_bus import SpiBus
from hiltest.virtual.processor.clock import PICOSECONDS, Clock
from hiltest.virtual.processor.cpu import Processor

_DR = 0x0C
_NO_REQUESTS = -1, -1


class Spi(CoreDevice):
    """A master with frames of 8 and 16 bits in both directions; slave, one-way modes, CRC and I2S have no model."""

    steady = frozenset(ALL_STEADY) - frozenset(range(_DR, _DR + 4))  # a read clears flags

    def __init__(self, processor: Processor, module: ChipPeripheral, bus: SpiBus, clock: Clock, time: Clock) -> None:
        machine, (interrupt,) = processor.machine, module.interrupts

        def exchange(value: int, time_ps: int) -> int:
            return bus.exchange(value, time_ps / PICOSECONDS)

        # The library keeps only the pointer.
        self._exchange = guarded_callback("uint32_t(void *, uint32_t, int64_t)", exchange, processor.abort)
        receive, send = module.requests or _NO_REQUESTS
        clocks = clock.number_in(machine), time.number_in(machine)
        connections = interrupt, receive, send, *clocks, self._exchange, ffi.NULL
        if not lib.machine_add_stm32_spi(machine.handle, module.base, connections):
            raise MemoryError
        super().__init__(machine, module.name, module.base)
