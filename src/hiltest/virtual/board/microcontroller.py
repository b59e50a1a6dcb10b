"""The MK64FN1M0: peripherals connected to the processor according to the part's tables."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence
from functools import partial
from pathlib import Path

from hiltest.state import HasState, Restorable
from hiltest.virtual.board.bare_part import private_peripherals
from hiltest.virtual.part.chip import ChipPeripheral, mk64f12, pin_place
from hiltest.virtual.peripherals.adc import Converter
from hiltest.virtual.peripherals.bus import Peripheral, PeripheralBus, StoredRegisters
from hiltest.virtual.peripherals.crc import CheckValue
from hiltest.virtual.peripherals.dma import dma_pages
from hiltest.virtual.peripherals.dspi import Dspi
from hiltest.virtual.peripherals.flash_array import FlashArray
from hiltest.virtual.peripherals.fmc import FlashControl
from hiltest.virtual.peripherals.ftfe import FlashMemory
from hiltest.virtual.peripherals.ftm import FlexTimer
from hiltest.virtual.peripherals.i2c import I2c, I2cSlave
from hiltest.virtual.peripherals.i2c_bus import I2cBus, I2cDevice
from hiltest.virtual.peripherals.lptmr import LowPowerTimer
from hiltest.virtual.peripherals.mcg import ClockGenerator
from hiltest.virtual.peripherals.pin_signals import PinSignal
from hiltest.virtual.peripherals.pit import PeriodicTimers
from hiltest.virtual.peripherals.port import Gpio, Port
from hiltest.virtual.peripherals.rcm import ResetControl, ResetRequested, ResetSource
from hiltest.virtual.peripherals.rng import RandomNumbers
from hiltest.virtual.peripherals.rtc import BatteryRegisters, RealTimeClock
from hiltest.virtual.peripherals.sim import ClockGates
from hiltest.virtual.peripherals.smc import PowerManagement, SystemModes, WakeUpUnit
from hiltest.virtual.peripherals.spi_bus import SpiBus, SpiDevice
from hiltest.virtual.peripherals.sysmpu import MemoryProtection
from hiltest.virtual.peripherals.uart import Uart
from hiltest.virtual.peripherals.unmodelled import UnmodelledLog, UnmodelledPage
from hiltest.virtual.peripherals.wdog import Watchdog
from hiltest.virtual.processor.cpu import Processor
from hiltest.virtual.processor.memory import SRAM
from hiltest.virtual.program.elf import LoadSegment

_SPI0_DEPTH = 4  # of its FIFOs; those of SPI1 and SPI2 hold one word
_WITH_FIFO = 2  # number of UARTs with FIFOs and the core clock: UART0 and UART1

ROOM_DEGC = 25.0
_VLLS3 = 3  # retains RAM; lower modes lose it (the part retains some of it in VLLS2)


class Microcontroller(Restorable):
    """The peripherals of the part, on the bus of a processor.

    Parameters
    ----------
    i2c
        Parts on I2C0 and on I2C1.
    spi
        Parts on SPI0, SPI1 and SPI2, by the pin that selects them.
    strict
        True if an access to a peripheral that is not modelled is a bus error.
    flash_file
        File that stores the flash between runs.

    Attributes
    ----------
    uarts : tuple of Uart
        UART0 to UART5.
    ports : dict of str to Port
        By letter.
    adc_volts : dict of (int, int) to float
        Input voltages of the converters, by converter and channel; 0 V by default.
    temperature_degc : callable
        Returns the temperature of the chip.
    watchdog_resets : int
        Resets by the watchdog since power-on.
    """

    def __init__(
        self,
        processor: Processor,
        i2c: Sequence[Sequence[I2cDevice]],
        spi: Sequence[Mapping[str, SpiDevice]] = ({}, {}, {}),
        *,
        strict: bool = False,
        flash_file: str | Path | None = None,
    ) -> None:
        self._processor = processor
        self.flash = FlashArray(processor, flash_file)
        self._chip = mk64f12()
        self._modules = {module.name: module for module in self._chip.peripherals}
        self.i2c_buses = tuple(I2cBus(parts) for parts in i2c)
        self.spi_buses = tuple(SpiBus(parts) for parts in spi)
        self.watchdog_resets = 0
        self._silent: list[
            tuple[int, str, bool]
        ] = []  # interrupts of unmodelled modules, and if modelled ones share them
        self.unmodelled = UnmodelledLog(processor, self._chip)
        processor.waits_for = lambda: self.unmodelled.polled or self.silent_interrupts()
        generator = ClockGenerator()
        self.clocks = ClockGates(processor, generator)
        self.cycle_counter, control = private_peripherals(processor, self.clocks.core)
        self._peripherals: list[Peripheral] = [generator, self.clocks, self.cycle_counter, control]
        self._peripherals += self._chip_modules()
        self._peripherals += [*self._slow_modules(), *self._flex_timers(), *self._converters()]
        self._peripherals.append(self.clocks.options)
        self._connect_pins(self.low_power_timer.signals)
        self._connect_chip_selects()
        if not strict:
            self._add_unmodelled_pages()
        for peripheral in self._peripherals:
            gates = {gate for entry in self._chip.pages.get(peripheral.base >> 12, ()) for gate in entry.gates}
            self.clocks.gate(peripheral, gates)
        self.bus = PeripheralBus(processor, self._peripherals, self._chip.register_name)
        self.clocks.on_gates = self.bus.recheck

    def _base(self, name: str) -> int:
        return self._modules[name].base

    def _initial(self, name: str) -> dict[int, int]:
        return self._chip.reset_bytes(self._base(name))

    def _chip_modules(self) -> list[Peripheral]:
        """Return the peripherals around the processor that run at any time."""
        processor, clocks, modules = self._processor, self.clocks, self._modules
        self.uarts = tuple(self._uart(number) for number in range(6))
        self.uart0 = self.uarts[0]
        self.timers = PeriodicTimers(processor, clocks, modules["PIT"])
        self.watchdog = Watchdog(clocks, time_out=self._reset_by_watchdog)
        self.reset_control = ResetControl()
        self.ports = {letter: self._port(modules[f"PORT{letter}"]) for letter in "ABCDE"}
        self.random_numbers = RandomNumbers(processor, clocks.bus, modules["RNG"])
        self._spi_masters = [self._spi_master(number, bus) for number, bus in enumerate(self.spi_buses)]
        masters = [I2c(processor, clocks, bus, modules[f"I2C{number}"]) for number, bus in enumerate(self.i2c_buses)]
        # Firmware that is master of one bus and slave on the other expects a wire between both, as NXP's examples do.
        for bus, listener in zip(self.i2c_buses, reversed(masters), strict=True):
            bus.slave = I2cSlave(processor.machine, listener, bus)
        return [
            *self.uarts,
            self.timers,
            self.watchdog,
            self.reset_control,
            *self.ports.values(),
            Gpio(processor.machine, list(self.ports.values())),
            *masters,
            *self._spi_masters,
            MemoryProtection(processor.machine, modules["SYSMPU"]),
            FlashControl(self._processor.machine),
            CheckValue(modules["CRC"]),
            self.random_numbers,
            FlashMemory(processor, clocks.time, modules["FTFE"], self.flash, self.unmodelled),
            *dma_pages(processor.machine, modules["DMA"], modules["DMAMUX"], self.timers),
        ]

    def _spi_master(self, number: int, bus: SpiBus) -> Dspi:
        module, note = self._modules[f"SPI{number}"], self.unmodelled.note
        return Dspi(self._processor, self.clocks, bus, module, depth=1 if number else _SPI0_DEPTH, note=note)

    def _connect_chip_selects(self) -> None:
        """Connect the chip selects of the modules to their pins, and the parts to the pins that select them."""
        for master, bus in zip(self._spi_masters, self.spi_buses, strict=True):
            self._connect_pins(master.signals)
            for name in bus.devices:
                port, number = self.pin(name)
                port.drive(number, True)  # the pull-up of a part's board
                port.listen(number, partial(self._set_select, bus, name))

    def _set_select(self, bus: SpiBus, pin: str, high: bool) -> None:
        bus.set_select(pin, high, self.clocks.time_s())

    def _uart(self, number: int) -> Uart:
        clock = self.clocks.core if number < _WITH_FIFO else self.clocks.bus
        depth = 8 if number < _WITH_FIFO else 1
        return Uart(self._processor, self.clocks, clock, self._modules[f"UART{number}"], depth=depth)

    def _slow_modules(self) -> list[Peripheral]:
        """Return the peripherals that count while the processor is stopped, or that a battery supplies."""
        processor, clocks, modules = self._processor, self.clocks, self._modules
        self.low_power_timer = LowPowerTimer(processor, clocks, modules["LPTMR0"])
        self.real_time_clock = RealTimeClock(processor, clocks, modules["RTC"])
        files = [BatteryRegisters(modules[name]) for name in ("RFVBAT", "RFSYS")]
        self._persistent: list[LowPowerTimer | RealTimeClock | BatteryRegisters | Watchdog]
        self._persistent = [self.watchdog, self.low_power_timer, self.real_time_clock, *files]
        return [*self._persistent[1:], *self._power_modules()]

    def _power_modules(self) -> list[Peripheral]:
        """Return the peripherals that control sleep."""
        modules = self._modules
        oscillator = StoredRegisters("OSC", self._base("OSC"), self._initial("OSC"))
        self._power = PowerManagement("PMC", self._base("PMC"), self._initial("PMC"))
        self._wake_up_unit = WakeUpUnit(modules["LLWU"], self._processor, self.ports)
        self.modes = SystemModes(
            modules["SMC"], self._processor, self.clocks, oscillator, self._wake_up_unit, self._wake_up
        )
        return [oscillator, self._power, self._wake_up_unit, self.modes]

    def _flex_timers(self) -> list[FlexTimer]:
        """Return the timers with channels, connected to their pins."""
        timers = [
            FlexTimer(self._processor, self.clocks, self._modules[f"FTM{number}"], self.unmodelled.note)
            for number in range(4)
        ]

        def pass_edge(number: int, high: bool) -> None:
            for timer in timers:
                timer.clock_input(number, high)

        self._connect_pins({f"FTM_CLKIN{number}": PinSignal(partial(pass_edge, number)) for number in range(2)})
        for timer in timers:
            self._connect_pins(timer.signals)
        return timers

    def _converters(self) -> list[Converter]:
        """Return the converters, connected to their inputs."""
        self.adc_volts: dict[tuple[int, int], float] = {}
        self.temperature_degc: Callable[[], float] = lambda: ROOM_DEGC

        def make(number: int) -> Converter:
            module = self._modules[f"ADC{number}"]
            converter = Converter(self._processor, self.clocks, module, self.unmodelled.note)
            converter.volts = lambda channel: self.adc_volts.get((number, channel), 0.0)
            converter.temperature_degc = lambda: self.temperature_degc()
            converter.on_request = self._processor.machine.set_request
            return converter

        return [make(0), make(1)]

    def _connect_pins(self, signals: Mapping[str, PinSignal]) -> None:
        """Connect the signals of modules to the pins that may carry them."""
        for pin in self._chip.pins:
            if pin.signal in signals:
                self.ports[pin.port].connect(pin.number, pin.function, signals[pin.signal])

    def _port(self, module: ChipPeripheral) -> Port:
        return Port(self._processor, module, self._chip.reset_bytes(module.base))

    def _add_unmodelled_pages(self) -> None:
        """Add registers that store writes, and report accesses, for every unmodelled page."""
        modelled = {peripheral.base >> 12 for peripheral in self._peripherals}
        silent = [module for module in self._chip.peripherals if module.base >> 12 not in modelled]
        answered = {number for module in self._chip.peripherals if module not in silent for number in module.interrupts}
        self._silent = [(number, module.name, number in answered) for module in silent for number in module.interrupts]
        self._peripherals += [
            UnmodelledPage(self._processor.machine, page << 12, modules, self._chip)
            for page, modules in self._chip.pages.items()
            if page not in modelled
        ]

    def parts(self) -> list[HasState]:
        """Return the peripherals with their bus, the event queue, and the parts on the buses."""
        return [
            *self._peripherals,
            self.bus,
            self._processor.schedule,
            self.flash,
            self.unmodelled,
            *self.i2c_buses,
            *self.spi_buses,
        ]

    def power_on(self, segments: Iterable[LoadSegment]) -> None:
        """Restore the flash from its file, except for sectors of the image."""
        self.flash.power_on(segments)

    # -- reset --------------------------------------------------------------------------------

    def reset(self, source: ResetSource) -> None:
        """Bring every peripheral to its state after a reset of the chip."""
        if source is ResetSource.POWER_ON:
            for module in self._persistent:
                module.power_on()
        self._wake_up_unit.keeps = source is ResetSource.WAKE_UP
        for peripheral in self._peripherals:
            peripheral.reset()
        if source is ResetSource.WAKE_UP:
            self._power.isolate()
        self.reset_control.set_source(source)
        self.watchdog.start()

    def _reset_by_watchdog(self) -> None:
        self.watchdog_resets += 1
        raise ResetRequested(ResetSource.WATCHDOG)  # the core is not running, so nothing must be aborted

    def _wake_up(self, vlls: int) -> None:
        """Reset the part at the end of a VLLS mode, as soon as the core runs."""

        def wake() -> None:
            if vlls < _VLLS3:
                self._processor.memory.write(SRAM[0], bytes(SRAM[1]))
            raise ResetRequested(ResetSource.WAKE_UP)

        self._processor.schedule.call_at(self._processor.cycles, wake)

    # -- outside of the chip ------------------------------------------------------------------

    def pin(self, name: str) -> tuple[Port, int]:
        """Return the port of a pin such as ``PTB9``, and its number in the port.

        Raises
        ------
        ConfigError
            If the part has no such pin.
        """
        letter, number = pin_place(name)
        return self.ports[letter], number

    def describe_sleep(self) -> str:
        """Return a description of the processor's sleep mode, and of interrupts that never end it."""
        return self.modes.describe() + self.silent_interrupts()

    def silent_interrupts(self) -> str:
        """Return the unmodelled modules whose interrupts are enabled, as a clause; empty if there are none."""
        enabled = [entry for entry in self._silent if self._processor.nvic.is_enabled(entry[0])]
        used = {access.register.partition("_")[0] for access in self.unmodelled.accesses} if enabled else set()
        names = dict.fromkeys(name for _, name, is_shared in enabled if not is_shared or name in used)
        if not names:
            return ""
        return f", with interrupts of {', '.join(names)} enabled, which the virtual board does not model"
