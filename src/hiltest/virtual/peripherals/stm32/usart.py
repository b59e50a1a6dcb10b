"""USART, in the core's library (core/stm32_usart.c)."""

from __future__ import annotations

from hiltest.virtual.core.library import lib
from hiltest.virtual.part.chip import ChipPeripheral
from hiltest.virtual.peripherals.bus import ALL_STEADY
from hiltest.virtual.peripherals.uart import SerialPort
from hiltest.virtual.processor.clock import Clock
from hiltest.virtual.processor.cpu import Processor

_DR, _CR1 = 0x04, 0x0C
_UE, _TE_RE = 1 << 13, 0xC
_NO_REQUESTS = -1, -1


class Usart(SerialPort):
    """A USART with eight data bits, no parity and one stop bit; other frames have no model."""

    steady = frozenset(ALL_STEADY) - frozenset(range(_DR, _DR + 4))  # a second read of SR shows the same flags

    def __init__(self, processor: Processor, module: ChipPeripheral, clock: Clock, time: Clock) -> None:
        machine, (interrupt,) = processor.machine, module.interrupts
        receive, send = module.requests or _NO_REQUESTS
        connections = 1, interrupt, interrupt, receive, send, clock.number_in(machine), time.number_in(machine)
        super().__init__(machine, module, lib.machine_add_stm32_usart, connections)

    @property
    def is_on(self) -> bool:
        control = self.read(_CR1, 4)
        return bool(control & _UE and control & _TE_RE)
