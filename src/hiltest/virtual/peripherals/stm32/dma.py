"""DMA1 and DMA2, in the core's library (core/stm32_dma.c)."""

from __future__ import annotations

from collections.abc import Mapping

from hiltest.virtual.core.library import ffi, lib
from hiltest.virtual.part.chip import ChipPeripheral
from hiltest.virtual.peripherals.bus import ALL_STEADY
from hiltest.virtual.peripherals.core_device import CoreDevice
from hiltest.virtual.processor.clock import Clock
from hiltest.virtual.processor.cpu import Processor

_CHANNELS = 8


class Dma(CoreDevice):
    """A controller.

    Parameters
    ----------
    sources
        Numbers of requests by stream and channel, such as ``6.4``.
    """

    steady = ALL_STEADY

    def __init__(self, processor: Processor, module: ChipPeripheral, clock: Clock, sources: Mapping[str, int]) -> None:
        machine = processor.machine
        connections = ffi.new("struct machine_stm32_dma *")
        connections.interrupts, connections.clock = module.interrupts, clock.number_in(machine)
        connections.sources = [
            sources.get(f"{place // _CHANNELS}.{place % _CHANNELS}", -1) for place in range(len(connections.sources))
        ]
        if not lib.machine_add_stm32_dma(machine.handle, module.base, connections[0]):
            raise MemoryError
        super().__init__(machine, module.name, module.base)
