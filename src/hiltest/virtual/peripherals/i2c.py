"""I2C masters in the core's library, whose transfers reach the parts on the bus through Python."""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import Any

from hiltest.virtual.core.library import ffi, guarded_callback, lib
from hiltest.virtual.core.machine import NEVER
from hiltest.virtual.part.chip import ChipPeripheral
from hiltest.virtual.peripherals.bus import ALL_STEADY
from hiltest.virtual.peripherals.core_device import CoreDevice
from hiltest.virtual.peripherals.i2c_bus import HeldLine, I2cBus
from hiltest.virtual.peripherals.sim import ClockGates
from hiltest.virtual.processor.clock import PICOSECONDS
from hiltest.virtual.processor.cpu import Processor

_D = 4
_ADDRESS, _WRITE, _READ, _STOP = lib.I2C_ADDRESS, lib.I2C_WRITE, lib.I2C_READ, lib.I2C_STOP


class I2c(CoreDevice):
    """A Kinetis I2C module, as master."""

    steady = frozenset(ALL_STEADY) - {_D}

    def __init__(self, processor: Processor, clocks: ClockGates, bus: I2cBus, module: ChipPeripheral) -> None:
        machine = processor.machine
        self._ask = _bus_callback(bus, processor.abort)  # the library keeps only the pointer
        (interrupt,), (request,) = module.interrupts, module.requests
        connections = ffi.new("struct machine_i2c *")
        connections.interrupt, connections.request = interrupt, request
        connections.clock, connections.time = clocks.bus.number_in(machine), clocks.time.number_in(machine)
        connections.ask = self._ask
        if not lib.machine_add_i2c(machine.handle, module.base, connections[0]):
            raise MemoryError
        super().__init__(machine, module.name, module.base)
        bus.on_hold = self._hold

    def _hold(self, hold: HeldLine) -> None:
        """Pull a line low for a time."""
        wire = lib.I2C_SDA if hold.line == "sda" else lib.I2C_SCL
        lib.machine_hold_wire(self._handle, self.base, wire, _picoseconds(hold.begin_s), _picoseconds(hold.end_s))


def _picoseconds(time_s: float) -> int:
    return NEVER if math.isinf(time_s) else math.ceil(time_s * PICOSECONDS)


def _bus_callback(bus: I2cBus, abort: Callable[[BaseException], None]) -> Any:
    """Return the function that the library calls to reach the parts of a bus; `abort` receives exceptions."""

    def ask(operation: int, value: int, time: int) -> int:
        time_s = time / PICOSECONDS
        if operation == _READ:
            return bus.read(time_s)
        if operation == _WRITE:
            return bus.write(value, time_s)
        if operation == _ADDRESS:
            return bus.address(value, time_s)
        bus.stop(time_s)
        return 0

    return guarded_callback("uint32_t(void *, int32_t, uint32_t, int64_t)", ask, abort)
