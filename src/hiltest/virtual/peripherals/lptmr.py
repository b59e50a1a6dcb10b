"""LPTMR: this module connects the timer (core/lptmr.c) to the pins whose pulses it counts."""

from __future__ import annotations

from collections.abc import Iterable
from functools import partial

from hiltest.virtual.core.library import ffi, lib
from hiltest.virtual.part.chip import ChipPeripheral
from hiltest.virtual.peripherals.bus import ALL_STEADY
from hiltest.virtual.peripherals.core_device import CoreDevice
from hiltest.virtual.peripherals.pin_signals import PinSignal
from hiltest.virtual.peripherals.sim import ClockGates
from hiltest.virtual.processor.cpu import Processor

_REGISTERS = range(0x0, 0x10, 4)


class LowPowerTimer(CoreDevice):
    """The LPTMR module, which only power-on resets.

    Attributes
    ----------
    signals : dict of str to PinSignal
        Pin inputs that the timer can count, by name.
    """

    steady = ALL_STEADY

    def __init__(self, processor: Processor, clocks: ClockGates, module: ChipPeripheral) -> None:
        machine = processor.machine
        sources = clocks.internal, clocks.low_power, clocks.slow_external, clocks.oscillator
        connections = *module.interrupts, [clock.number_in(machine) for clock in sources]
        if not lib.machine_add_lptmr(machine.handle, module.base, ffi.new("struct machine_lptmr *", connections)[0]):
            raise MemoryError
        super().__init__(machine, module.name, module.base)
        self.signals = {f"{self.name}_ALT{select}": PinSignal(partial(self._edge, select)) for select in (1, 2)}

    def parts(self) -> Iterable[PinSignal]:
        return self.signals.values()

    def power_on(self) -> None:
        """Return to the state after power-on: disabled."""
        for offset in _REGISTERS:
            self.write(offset, 4, 0)

    def _edge(self, select: int, high: bool) -> None:
        lib.machine_lptmr_edge(self._handle, self.base, select, high)
