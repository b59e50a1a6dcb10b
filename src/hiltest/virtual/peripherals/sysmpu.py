"""System memory protection in the core's library (core/sysmpu.c)."""

from __future__ import annotations

from hiltest.virtual.core.library import lib
from hiltest.virtual.core.machine import Machine
from hiltest.virtual.part.chip import ChipPeripheral
from hiltest.virtual.peripherals.bus import ALL_STEADY
from hiltest.virtual.peripherals.core_device import CoreDevice


class MemoryProtection(CoreDevice):
    """The SYSMPU, which refuses the core's loads and stores in regions without rights."""

    steady = ALL_STEADY

    def __init__(self, machine: Machine, module: ChipPeripheral) -> None:
        if not lib.machine_add_sysmpu(machine.handle, module.base):
            raise MemoryError
        super().__init__(machine, module.name, module.base)
