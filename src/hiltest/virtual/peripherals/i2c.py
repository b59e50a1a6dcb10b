"""I2C modules in the core's library, whose transfers reach the parts on the bus, and each other, through Python."""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import Any

from hiltest.state import Restorable
from hiltest.virtual.core.library import ffi, guarded_callback, lib
from hiltest.virtual.core.machine import NEVER, Machine
from hiltest.virtual.part.chip import ChipPeripheral
from hiltest.virtual.peripherals.bus import ALL_STEADY
from hiltest.virtual.peripherals.core_device import CoreDevice
from hiltest.virtual.peripherals.i2c_bus import HeldLine, I2cBus
from hiltest.virtual.peripherals.sim import ClockGates
from hiltest.virtual.processor.clock import PICOSECONDS, Clock
from hiltest.virtual.processor.cpu import Processor

_A1, _C1, _D = 0, 2, 4
_C1_ENABLED, _C1_MASTER = 0x80, 0x20
_ADDRESS, _WRITE, _READ, _STOP = lib.I2C_ADDRESS, lib.I2C_WRITE, lib.I2C_READ, lib.I2C_STOP


class I2cMaster(CoreDevice):
    """An I2C module in the core's library, as master of a bus.

    Parameters
    ----------
    clock
        Clock of the module.
    time
        Virtual time in picoseconds.
    add
        Adds the module to the machine.
    """

    def __init__(
        self,
        processor: Processor,
        module: ChipPeripheral,
        bus: I2cBus,
        *,
        clock: Clock,
        time: Clock,
        add: Callable[..., bool],
    ) -> None:
        machine = processor.machine
        self._ask = _bus_callback(bus, processor.abort)  # the library keeps only the pointer
        connections = ffi.new("struct machine_i2c *")
        connections.interrupt, connections.error_interrupt = module.interrupts[0], module.interrupts[-1]
        connections.request = module.requests[0] if module.requests else -1
        connections.clock, connections.time = clock.number_in(machine), time.number_in(machine)
        connections.ask = self._ask
        if not add(machine.handle, module.base, connections[0]):
            raise MemoryError
        super().__init__(machine, module.name, module.base)
        bus.on_hold = self._hold

    def _hold(self, hold: HeldLine) -> None:
        """Pull a line low for a time."""
        wire = lib.I2C_SDA if hold.line == "sda" else lib.I2C_SCL
        lib.machine_hold_wire(self._handle, self.base, wire, _picoseconds(hold.begin_s), _picoseconds(hold.end_s))


class I2c(I2cMaster):
    """A Kinetis I2C module."""

    steady = frozenset(ALL_STEADY) - {_D}

    def __init__(self, processor: Processor, clocks: ClockGates, bus: I2cBus, module: ChipPeripheral) -> None:
        super().__init__(processor, module, bus, clock=clocks.bus, time=clocks.time, add=lib.machine_add_i2c)


class I2cSlave(Restorable):
    """An I2C module as a part on the bus of another master, see core/i2c.c.

    Parameters
    ----------
    module
        The module that listens.
    bus
        Bus of the master.
    """

    def __init__(self, machine: Machine, module: I2c, bus: I2cBus) -> None:
        self._handle, self._module, self._bus = machine.handle, module, bus

    @property
    def address(self) -> int:
        """Address to which it listens; -1 if it does not."""
        control = self._module.read(_C1, 1)
        listens = self._module.clocked and control & (_C1_ENABLED | _C1_MASTER) == _C1_ENABLED
        return self._module.read(_A1, 1) >> 1 or -1 if listens else -1

    def start(self, reading: bool, time_s: float) -> bool:
        """Address the module."""
        return bool(self._pass_on(_ADDRESS, self.address << 1 | reading))

    def write(self, value: int, time_s: float) -> bool:
        """Send a byte to the module; return True if it acknowledges."""
        return bool(self._pass_on(_WRITE, value))

    def read(self, time_s: float) -> int:
        """Return the byte that the module sends."""
        return self._pass_on(_READ, int(self._bus.is_refused))

    def stop(self, time_s: float) -> None:
        """End the transfer."""
        self._pass_on(_STOP, 0)

    def _pass_on(self, operation: int, value: int) -> int:
        answer: int = lib.machine_i2c_slave(self._handle, self._module.base, operation, value)
        return answer


def _picoseconds(time_s: float) -> int:
    return NEVER if math.isinf(time_s) else math.ceil(time_s * PICOSECONDS)


def _bus_callback(bus: I2cBus, abort: Callable[[BaseException], None]) -> Any:
    """Return the function that the library calls to reach the parts of a bus; `abort` receives exceptions."""

    def ask(operation: int, value: int, time: int) -> int:
        time_s = time / PICOSECONDS
        if operation == _READ:
            bus.is_refused = bool(value)
            return bus.read(time_s)
        if operation == _WRITE:
            return bus.write(value, time_s)
        if operation == _ADDRESS:
            return bus.address(value, time_s)
        bus.stop(time_s)
        return 0

    return guarded_callback("uint32_t(void *, int32_t, uint32_t, int64_t)", ask, abort)
