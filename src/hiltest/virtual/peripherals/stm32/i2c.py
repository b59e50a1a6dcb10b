"""I2C, in the core's library (core/stm32_i2c.c)."""

from __future__ import annotations

from hiltest.virtual.core.library import lib
from hiltest.virtual.part.chip import ChipPeripheral
from hiltest.virtual.peripherals.bus import ALL_STEADY
from hiltest.virtual.peripherals.i2c import I2cMaster
from hiltest.virtual.peripherals.i2c_bus import I2cBus
from hiltest.virtual.processor.clock import Clock
from hiltest.virtual.processor.cpu import Processor

_DR, _SR2 = 0x10, 0x18


class I2c(I2cMaster):
    """An I2C module of the STM32F1 to F4 as master."""

    steady = frozenset(ALL_STEADY) - {*range(_DR, _DR + 4), *range(_SR2, _SR2 + 4)}

    def __init__(self, processor: Processor, module: ChipPeripheral, bus: I2cBus, clock: Clock, time: Clock) -> None:
        super().__init__(processor, module, bus, clock=clock, time=time, add=lib.machine_add_stm32_i2c)
