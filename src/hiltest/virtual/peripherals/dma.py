"""Access from Python to the eDMA and the DMAMUX (core/dma.c)."""

from __future__ import annotations

from hiltest.virtual.core.library import ffi, lib
from hiltest.virtual.core.machine import Machine
from hiltest.virtual.part.chip import ChipPeripheral
from hiltest.virtual.peripherals.bus import ALL_STEADY
from hiltest.virtual.peripherals.core_device import CoreDevice
from hiltest.virtual.peripherals.pit import PeriodicTimers

_DESCRIPTORS = 0x1000


class DmaPage(CoreDevice):
    """A page of registers of the eDMA or of the DMAMUX."""

    steady = ALL_STEADY  # transfers, status and requests change only at events


def dma_pages(
    machine: Machine, module: ChipPeripheral, multiplexer: ChipPeripheral, timers: PeriodicTimers
) -> list[DmaPage]:
    """Add the eDMA with its multiplexer to the machine; return the pages of their registers.

    Parameters
    ----------
    timers
        Timers that gate the requests of triggered channels.
    """
    connections = module.base, multiplexer.base, timers.base, module.interrupts
    if not lib.machine_add_dma(machine.handle, ffi.new("struct machine_dma *", connections)[0]):
        raise MemoryError
    return [
        DmaPage(machine, multiplexer.name, multiplexer.base),
        DmaPage(machine, module.name, module.base),
        DmaPage(machine, module.name, module.base + _DESCRIPTORS),
    ]
