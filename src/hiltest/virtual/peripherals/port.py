"""PORT and GPIO: this module connects pins (core/port.c) to the signals of timers, and reports changes of pins."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any

from hiltest.virtual.core.library import ffi, guarded_callback, lib
from hiltest.virtual.core.machine import Machine
from hiltest.virtual.part.chip import ChipPeripheral
from hiltest.virtual.peripherals.bus import ALL_STEADY
from hiltest.virtual.peripherals.core_device import CoreDevice
from hiltest.virtual.peripherals.pin_signals import PinSignal
from hiltest.virtual.processor.cpu import Processor

_FUNCTION_SHIFT, _FUNCTION = 8, 7


class Port(CoreDevice):
    """The 32 pins of one port, with the registers of its PORT module.

    Parameters
    ----------
    initial
        Register bytes that are not zero after reset.

    Attributes
    ----------
    on_change : callable
        Called after the level of a watched pin has changed, or the processor has begun or ceased to pull it low.
    on_levels : callable
        Called with the pins that rose and those that fell, if one of these pins is watched.
    """

    steady = ALL_STEADY

    def __init__(self, processor: Processor, module: ChipPeripheral, initial: dict[int, int]) -> None:
        machine = processor.machine
        self.on_change: Callable[[Port], None] = lambda _port: None
        self.on_levels: Callable[[int, int], None] = lambda _rose, _fell: None
        self._watched = 0
        self._followed = 0  # pins whose edges are reported even if a timer makes them
        self._signals: dict[tuple[int, int], PinSignal] = {}  # by pin and multiplexer setting
        self._selected: dict[int, PinSignal] = {}  # by pin
        self._listeners: dict[int, Callable[[bool], None]] = {}  # by pin
        self._reporting: set[PinSignal] = set()  # selected signals that report each edge
        self._callbacks = (  # the library keeps only the pointers
            guarded_callback("void(void *, uint32_t, uint32_t)", self._report, processor.abort),
            guarded_callback("void(void *)", self._select, processor.abort),
            guarded_callback("void(void *)", self._declare_signals, processor.abort),
        )
        connections = ffi.new("struct machine_port *")
        (connections.interrupt,) = module.interrupts
        connections.changed, connections.selected, connections.declare = self._callbacks
        for offset, value in initial.items():
            ffi.buffer(connections.controls)[offset] = bytes([value])
        self._pins: Any = lib.machine_add_port(machine.handle, module.base, connections[0])
        if self._pins == ffi.NULL:
            raise MemoryError
        super().__init__(machine, module.name, module.base)

    @property
    def levels(self) -> int:
        """Return the levels of the pins; bit n is pin n."""
        if self._selected:
            self._settle()
        levels: int = self._pins.levels
        return levels

    @property
    def driven_low(self) -> int:
        """Return the pins that the processor pulls low, one bit each."""
        driven_low: int = self._pins.driven_low
        return driven_low

    def drive(self, pin: int, high: bool) -> None:
        """Drive a pin from outside of the chip."""
        pins, bit = self._pins, 1 << pin
        pins.outside |= bit
        pins.outside_high = pins.outside_high & ~bit | high << pin
        self._settle()

    def watch(self, pins: int, *, follows_timers: bool = False) -> None:
        """Report changes of pins, one bit each, to `on_change` and `on_levels`.

        Edges that a timer makes are reported only with `follows_timers`, or if they cause interrupts.
        """
        self._watched |= pins
        self._followed |= pins if follows_timers else 0
        self._select()
        self._settle()

    def listen(self, pin: int, on_level: Callable[[bool], None]) -> None:
        """Call `on_level` with the level of a pin now, and whenever it changes."""
        self._listeners[pin] = on_level
        self.watch(1 << pin, follows_timers=True)
        on_level(bool(self.levels >> pin & 1))

    def connect(self, pin: int, function: int, signal: PinSignal) -> None:
        """Connect a peripheral's signal to a pin while the pin's multiplexer selects the function."""
        self._signals[pin, function] = signal

    def _settle(self) -> None:
        """Update the levels of the pins and their effects."""
        self._declare_signals()
        lib.machine_settle_pins(self._handle, self.base)

    def _declare_signals(self) -> None:
        """Declare to the core the pins that signals drive, and those whose changes it must report."""
        pins, driving, high, silent, watched = self._pins, 0, 0, 0, self._watched
        for pin, signal in self._selected.items():
            level = signal.level()
            if level is None:
                watched |= 1 << pin
            else:
                driving |= 1 << pin
                high |= level << pin
                silent |= (signal not in self._reporting) << pin
        pins.signals, pins.signals_high, pins.silent, pins.watched = driving, high, silent, watched

    def _select(self) -> None:
        """Collect the signals that the multiplexers select, and listen to those on followed pins."""
        self._selected = {
            pin: signal
            for (pin, function), signal in self._signals.items()
            if self.read(4 * pin, 4) >> _FUNCTION_SHIFT & _FUNCTION == function
        }
        self._pins.with_signals = sum(1 << pin for pin in self._selected)
        followed = self._pins.interrupting | self._followed
        reporting = {signal for pin, signal in self._selected.items() if followed >> pin & 1}
        for signal in reporting - self._reporting:
            signal.add_listener(self._settle)
        for signal in self._reporting - reporting:
            signal.remove_listener(self._settle)
        self._reporting = reporting
        self._declare_signals()

    def _report(self, rose: int, fell: int) -> None:
        self.on_change(self)
        if rose or fell:
            self.on_levels(rose, fell)
        for pin, on_level in self._listeners.items():
            if (rose | fell) >> pin & 1:
                on_level(bool(rose >> pin & 1))
        for pin, signal in self._selected.items():
            if (rose | fell) >> pin & 1 and signal.level() is None:
                signal.on_level(bool(rose >> pin & 1))


class Gpio(CoreDevice):
    """The GPIO modules of ports A to E, on one page."""

    steady = ALL_STEADY

    def __init__(self, machine: Machine, ports: Sequence[Port]) -> None:
        if not lib.machine_add_gpio(machine.handle, 0x400FF000, [port.base for port in ports]):
            raise MemoryError
        super().__init__(machine, "GPIO", 0x400FF000)
