"""PORT and GPIO, as Python sees them: the core's library has them, and tells of pins that somebody watches."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any

from hiltest.virtual.core.library import ffi, lib
from hiltest.virtual.core.machine import Machine
from hiltest.virtual.part.chip import ChipPeripheral
from hiltest.virtual.peripherals.bus import ALL_STEADY
from hiltest.virtual.peripherals.core_device import CoreDevice
from hiltest.virtual.peripherals.pin_signals import PinSignal

_FUNCTION_SHIFT, _FUNCTION = 8, 7


class Port(CoreDevice):
    """The 32 pins of one port, with the PORT module's registers.

    Parameters
    ----------
    machine : Machine
    module : ChipPeripheral
        The PORT module.
    initial : dict of int to int
        Bytes of the registers that are not zero after reset.
    abort : callable
        Gets any exception of whoever is told.

    Attributes
    ----------
    on_change : callable
        Told after pins that are watched have changed their level or whether the processor pulls them low.
    on_levels : callable
        Told which pins rose and which fell, if one of them is watched.
    """

    steady = ALL_STEADY

    def __init__(
        self, machine: Machine, module: ChipPeripheral, initial: dict[int, int],
        abort: Callable[[BaseException], None],
    ) -> None:  # fmt: skip
        self.on_change: Callable[[Port], None] = lambda _port: None
        self.on_levels: Callable[[int, int], None] = lambda _rose, _fell: None
        self._watched = 0
        self._signals: dict[tuple[int, int], PinSignal] = {}  # by pin and what its multiplexer selects
        self._carried: dict[int, PinSignal] = {}  # by pin

        @ffi.callback("void(void *, uint32_t, uint32_t)")  # type: ignore[untyped-decorator]
        def on_changed(_context: Any, rose: int, fell: int) -> None:
            try:
                self._tell(rose, fell)
            except BaseException as error:  # the library cannot pass it on; `abort` has it raised again
                abort(error)

        @ffi.callback("void(void *)")  # type: ignore[untyped-decorator]
        def on_connected(_context: Any) -> None:
            try:
                self._connect()
            except BaseException as error:  # as above
                abort(error)

        self._told = on_changed, on_connected  # the library keeps only the pointers
        connections = ffi.new("struct machine_port *")
        (connections.interrupt,) = module.interrupts
        connections.changed, connections.connected = self._told
        for offset, value in initial.items():
            ffi.buffer(connections.controls)[offset] = bytes([value])
        self._pins: Any = lib.machine_add_port(machine.handle, module.base, connections[0])
        if self._pins == ffi.NULL:
            raise MemoryError
        super().__init__(machine, module.name, module.base)

    @property
    def levels(self) -> int:
        """Bit n is the level of pin n."""
        levels: int = self._pins.levels
        return levels

    @property
    def driven_low(self) -> int:
        """Pins that the processor pulls low."""
        driven_low: int = self._pins.driven_low
        return driven_low

    def drive(self, pin: int, high: bool) -> None:
        """Give a pin a level from outside."""
        pins, bit = self._pins, 1 << pin
        pins.outside |= bit
        pins.outside_high = pins.outside_high & ~bit | high << pin
        self._settle()

    def watch(self, pins: int) -> None:
        """Have `on_change` and `on_levels` told of changes of pins, a bit each."""
        self._watched |= pins
        self._settle()

    def lead(self, pin: int, function: int, signal: PinSignal) -> None:
        """Connect a signal of a peripheral to a pin, for when its multiplexer selects that function."""
        self._signals[pin, function] = signal
        signal.settle.append(self._settle)

    def _settle(self) -> None:
        """Have the levels of the pins found, and what follows from them."""
        self._carry()
        lib.machine_settle_pins(self._handle, self.base)

    def _carry(self) -> None:
        """Say which pins signals drive, and which have to be told of."""
        pins = self._pins
        pins.signals = pins.signals_high = 0
        pins.watched = self._watched
        for pin, signal in self._carried.items():
            if signal.driven is None:
                pins.watched |= 1 << pin
            else:
                pins.signals |= 1 << pin
                pins.signals_high |= signal.driven << pin

    def _connect(self) -> None:
        """Carry the signals that the multiplexers select."""
        before = self._carried
        self._carried = {
            pin: signal
            for (pin, function), signal in self._signals.items()
            if self.read(4 * pin, 4) >> _FUNCTION_SHIFT & _FUNCTION == function
        }
        for pin, signal in before.items():
            if self._carried.get(pin) is not signal:
                signal.pins -= 1
                signal.on_pins()
        for pin, signal in self._carried.items():
            if before.get(pin) is not signal:
                signal.pins += 1
                signal.on_pins()
        self._carry()

    def _tell(self, rose: int, fell: int) -> None:
        self.on_change(self)
        if rose or fell:
            self.on_levels(rose, fell)
        for pin, signal in self._carried.items():
            if signal.driven is None and (rose | fell) >> pin & 1:
                signal.on_level(bool(rose >> pin & 1))


class Gpio(CoreDevice):
    """The GPIO modules of all ports, on one page.

    Parameters
    ----------
    machine : Machine
    ports : sequence of Port
        A to E.
    """

    steady = ALL_STEADY

    def __init__(self, machine: Machine, ports: Sequence[Port]) -> None:
        if not lib.machine_add_gpio(machine.handle, 0x400FF000, [port.base for port in ports]):
            raise MemoryError
        super().__init__(machine, "GPIO", 0x400FF000)
