"""TIM2 to TIM5 and TIM9 to TIM11, in the core's library (core/stm32_timer.c)."""

from __future__ import annotations

from hiltest.virtual.core.library import ffi, lib
from hiltest.virtual.part.chip import ChipPeripheral
from hiltest.virtual.peripherals.bus import ALL_STEADY
from hiltest.virtual.peripherals.core_device import CoreDevice
from hiltest.virtual.processor.clock import Clock
from hiltest.virtual.processor.cpu import Processor

_CNT = 0x24


class Timer(CoreDevice):
    """A timer that counts upwards; down and centre-aligned counting, slave modes, capture and outputs have no model."""

    counters = frozenset(range(_CNT, _CNT + 4))
    steady = frozenset(ALL_STEADY) - counters

    def __init__(self, processor: Processor, module: ChipPeripheral, clock: Clock, bits: int) -> None:
        machine = processor.machine
        connections = ffi.new("struct machine_stm32_timer *")
        connections.clock, connections.mask = clock.number_in(machine), (1 << bits) - 1
        (connections.interrupt,) = module.interrupts
        if not lib.machine_add_stm32_timer(machine.handle, module.base, connections[0]):
            raise MemoryError
        super().__init__(machine, module.name, module.base)
