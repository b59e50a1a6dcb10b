"""The nRF51822: its blocks connected to the processor according to the part's tables."""

from __future__ import annotations

import re
from collections.abc import Callable, Iterable, Mapping
from fractions import Fraction

from hiltest.errors import ConfigError
from hiltest.state import HasState, Restorable
from hiltest.virtual.board.bare_part import private_peripherals
from hiltest.virtual.core.library import lib
from hiltest.virtual.part.chip import chip
from hiltest.virtual.peripherals.bus import Peripheral, PeripheralBus, StoredRegisters
from hiltest.virtual.peripherals.i2c_bus import I2cBus
from hiltest.virtual.peripherals.nrf51.block import CLOCK_HZ, Block
from hiltest.virtual.peripherals.nrf51.gpio import Gpio, PinEvents
from hiltest.virtual.peripherals.nrf51.nvmc import FlashControl
from hiltest.virtual.peripherals.nrf51.small_blocks import ClockAndPower, EventRouter, RandomNumbers, Thermometer
from hiltest.virtual.peripherals.nrf51.timers import RealTimeCounter, Timer
from hiltest.virtual.peripherals.nrf51.twi import Twi
from hiltest.virtual.peripherals.nrf51.uart import Uart
from hiltest.virtual.peripherals.rcm import ResetSource
from hiltest.virtual.peripherals.spi_bus import SpiBus
from hiltest.virtual.peripherals.unmodelled import UnmodelledLog, UnmodelledPage
from hiltest.virtual.processor.clock import PICOSECONDS, Clock
from hiltest.virtual.processor.cpu import Processor
from hiltest.virtual.program.elf import LoadSegment

PART = "nrf51822"
_INTERRUPTS = 32
_PIN = re.compile(r"P0\.(0|[1-9][0-9]?)")
_PINS = 32


class FixedClocks(Restorable):
    """Clocks of a chip whose core has one rate: `core`, and `time` in picoseconds."""

    def __init__(self, processor: Processor, core_hz: int) -> None:
        self.core, self.time = (Clock(processor.schedule, processor.now) for _ in range(2))
        self.core.run_at(Fraction(core_hz), Fraction(core_hz), 0)
        self.time.run_at(Fraction(PICOSECONDS), Fraction(core_hz), 0)

    @property
    def core_hz(self) -> float:
        """Core clock [Hz]."""
        return float(self.core.hz)

    def time_s(self) -> float:
        """Return the virtual time since power-on [s], also during an access to a peripheral."""
        return self.time.now() / PICOSECONDS


class Nrf51822(Restorable):
    """The blocks of the part, on the bus of a processor.

    Parameters
    ----------
    buses
        I2C buses of the board, by the numbers of their pins of SCL and SDA.
    strict
        True if an access to a block that is not modelled is a bus error.

    Attributes
    ----------
    uarts : tuple of Uart
        UART0.
    pins : Gpio
    """

    watchdog_resets = 0
    spi_buses: tuple[SpiBus, ...] = ()  # SPI0 and SPI1, in the pages of TWI0 and TWI1, have no model

    def __init__(self, processor: Processor, buses: Mapping[tuple[int, int], I2cBus], *, strict: bool = False) -> None:
        self._processor = processor
        tables = chip(PART)
        modules = {module.name: module for module in tables.peripherals}
        processor.core.interrupts = _INTERRUPTS
        for name in ("GPIO", "ROM"):
            if not lib.machine_add_device_region(processor.machine.handle, modules[name].base, modules[name].size):
                raise MemoryError
        lib.machine_pass_flash_stores(processor.machine.handle)
        self.i2c_buses = tuple(buses.values())
        self.unmodelled = UnmodelledLog(processor, tables)
        processor.waits_for = lambda: self.unmodelled.polled
        self.clocks = FixedClocks(processor, CLOCK_HZ)
        self.cycle_counter, control = private_peripherals(processor, self.clocks.core)
        self.cycle_counter.present = False
        uart = Uart(processor, tables, modules["UART0"])
        self.uarts = (uart,)
        self.pins = Gpio(processor, tables, modules["GPIO"])
        self._pin_events = PinEvents(processor, tables, modules["GPIOTE"], self.pins)
        self.pins.on_change = self._pin_events.look
        self._power = ClockAndPower(processor, tables, modules["CLOCK"])
        self.random_numbers = RandomNumbers(processor, tables, modules["RNG"])
        self.thermometer = Thermometer(processor, tables, modules["TEMP"])
        self.flash = FlashControl(processor, tables, modules["NVMC"])
        router = EventRouter(processor, tables, modules["PPI"])
        blocks: list[Block | Timer] = [
            self._power,
            uart,
            self.pins,
            self._pin_events,
            self.random_numbers,
            self.thermometer,
        ]
        blocks += [Timer(processor, self.clocks.core, modules[f"TIMER{number}"]) for number in range(3)]
        blocks += [RealTimeCounter(processor, tables, modules[f"RTC{number}"]) for number in range(2)]
        blocks += [Twi(processor, tables, modules[name], buses) for name in ("TWI0", "SPI1")]
        router.connect(blocks)
        rom = StoredRegisters("ROM", modules["ROM"].base, tables.reset_bytes(modules["ROM"].base))
        self._peripherals: list[Peripheral] = [*blocks, self.flash, router, rom, self.cycle_counter, control]
        modelled = {peripheral.base >> 12 for peripheral in self._peripherals}
        if not strict:
            self._peripherals += [
                UnmodelledPage(processor.machine, page << 12, entries, tables)
                for page, entries in tables.pages.items()
                if page not in modelled
            ]
        self.bus = PeripheralBus(processor, self._peripherals, tables.register_name)
        self.bus.store_in_flash = self.flash.program

    @property
    def temperature_degc(self) -> Callable[[], float]:
        """Function that returns the temperature of the chip [degC]."""
        return self.thermometer.temperature_degc

    @temperature_degc.setter
    def temperature_degc(self, temperature_degc: Callable[[], float]) -> None:
        self.thermometer.temperature_degc = temperature_degc

    def parts(self) -> list[HasState]:
        """Return the blocks with their bus, the event queue, and the parts on the I2C buses."""
        return [*self._peripherals, self.bus, self._processor.schedule, self.unmodelled, *self.i2c_buses]

    def power_on(self, segments: Iterable[LoadSegment]) -> None:
        """Give the flash its content at power-on, behind the segments of the image."""
        self.flash.write_facts()

    def reset(self, source: ResetSource) -> None:
        """Bring every block to its state after a reset of the chip."""
        for peripheral in self._peripherals:
            peripheral.reset()
        self._power.note_reset(source)

    def pin(self, name: str) -> tuple[Gpio, int]:
        """Return the pins, and the number of a pin such as ``P0.17``.

        Raises
        ------
        ConfigError
            If the part has no such pin.
        """
        return self.pins, pin_number(name)

    def describe_sleep(self) -> str:
        """Return a description of the processor's sleep mode."""
        return ""


def pin_number(name: str) -> int:
    """Return the number of a pin such as ``P0.17``.

    Raises
    ------
    ConfigError
        If the part has no such pin.
    """
    match = _PIN.fullmatch(name)
    if match is None or int(match[1]) >= _PINS:
        raise ConfigError(f"the nRF51822 has no pin {name!r}; write P0.0 to P0.31")
    return int(match[1])
