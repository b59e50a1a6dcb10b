"""A board whose chip is described by a machine file."""

from __future__ import annotations

import re
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass
from fractions import Fraction
from functools import partial
from pathlib import Path

from hiltest.errors import ConfigError
from hiltest.state import HasState, Restorable
from hiltest.virtual.board.bare_part import private_peripherals
from hiltest.virtual.board.leds_and_buttons import LedsAndButtons
from hiltest.virtual.board.virtual_machine import VirtualMachine
from hiltest.virtual.core.library import lib
from hiltest.virtual.model.timing import TimingProfile
from hiltest.virtual.part.chip import ChipPeripheral, is_in
from hiltest.virtual.part.machine_file import Block as BlockTable
from hiltest.virtual.part.machine_file import MachineFile, load_machine
from hiltest.virtual.part.part_file import load_part
from hiltest.virtual.peripherals.bus import Peripheral, PeripheralBus
from hiltest.virtual.peripherals.core_device import CoreDevice
from hiltest.virtual.peripherals.i2c_bus import I2cBus, I2cDevice
from hiltest.virtual.peripherals.rcm import ResetSource
from hiltest.virtual.peripherals.spi_bus import SpiBus, SpiDevice
from hiltest.virtual.peripherals.stm32.block import Block, BlockPage, UnmodelledBlock
from hiltest.virtual.peripherals.stm32.dma import Dma
from hiltest.virtual.peripherals.stm32.exti import PinInterrupts, PinSelection
from hiltest.virtual.peripherals.stm32.flash import FlashControl
from hiltest.virtual.peripherals.stm32.gpio import PINS, Gpio
from hiltest.virtual.peripherals.stm32.i2c import I2c
from hiltest.virtual.peripherals.stm32.rcc import ResetAndClocks
from hiltest.virtual.peripherals.stm32.spi import Spi
from hiltest.virtual.peripherals.stm32.timer import Timer
from hiltest.virtual.peripherals.stm32.usart import Usart
from hiltest.virtual.peripherals.unmodelled import UnmodelledLog
from hiltest.virtual.processor.cpu import Processor
from hiltest.virtual.processor.memory import PERIPHERALS
from hiltest.virtual.program.elf import FirmwareImage, LoadSegment

_PIN = re.compile(r"P([A-K])(0|[1-9][0-9]?)")
_PAGE_BITS = 12
_MEGA = 1_000_000
_MOST_BUSES = 10  # of one kind, from number 0 on
#: Lists of registers whose blocks only store: voltage scaling is ready at once.
_STORED = {"power"}


@dataclass(slots=True)
class _Seed:
    """Seed of a chip without a random number generator."""

    seed: int = 0


def _buses_of(machine: MachineFile, *kinds: str) -> list[str]:
    """Return the names of buses, such as ``i2c1``, that blocks with one of these lists of registers drive."""
    return sorted(name.lower() for name, block in machine.blocks.items() if block.registers in kinds)


class DescribedChip(Restorable):
    """The blocks of a machine file, on the bus of a processor.

    Attributes
    ----------
    uarts : tuple of Usart
        The board's serial port first.
    clocks : ResetAndClocks
    """

    watchdog_resets = 0
    spi_buses: tuple[SpiBus, ...] = ()

    def __init__(
        self,
        processor: Processor,
        machine: MachineFile,
        i2c: Mapping[str, Sequence[I2cDevice]],
        spi: Mapping[str, Mapping[str, SpiDevice]],
    ) -> None:
        self._processor, self._machine = processor, machine
        self._i2c = {name: I2cBus(i2c.get(name, ())) for name in _buses_of(machine, "i2c")}
        self._spi = {name: SpiBus(spi.get(name, {})) for name in _buses_of(machine, "spi")}
        self.i2c_buses = tuple(self._i2c.get(f"i2c{number}", I2cBus(())) for number in range(_MOST_BUSES))
        self.spi_buses = tuple(self._spi.get(f"spi{number}", SpiBus({})) for number in range(_MOST_BUSES))
        processor.core.interrupts = machine.interrupts
        tables = machine.chip()
        modules = {module.name: module for module in tables.peripherals}
        self.unmodelled = UnmodelledLog(processor, tables)
        processor.waits_for = lambda: self.unmodelled.polled
        self.random_numbers = _Seed()
        self.temperature_degc: Callable[[], float] = lambda: 25.0
        self.clocks = ResetAndClocks(processor, modules["RCC"], Fraction(str(machine.board.hse_mhz)) * _MEGA)
        self.cycle_counter, control = private_peripherals(processor, self.clocks.core)
        blocks = {name: self._model(modules[name], table) for name, table in machine.blocks.items()}
        for name, table in machine.blocks.items():
            if table.gate:
                blocks[name].clocked = False
                self.clocks.gate(blocks[name], table.gate)
        self._ports = {name[-1]: block for name, block in blocks.items() if isinstance(block, Gpio)}
        lines = [block for block in blocks.values() if isinstance(block, Usart)]
        self.uarts = tuple(sorted(lines, key=lambda line: line.name != machine.board.serial))
        pages: dict[int, list[Block | CoreDevice]] = {}
        for block in blocks.values():
            pages.setdefault(block.base >> _PAGE_BITS, []).append(block)
        for page in pages:
            base = page << _PAGE_BITS
            is_near = is_in([PERIPHERALS], base)
            if not is_near and not lib.machine_add_device_region(processor.machine.handle, base, 1 << _PAGE_BITS):
                raise MemoryError
        self._peripherals: list[Peripheral] = [
            *(BlockPage(page << _PAGE_BITS, group, self.unmodelled) for page, group in pages.items()),
            self.cycle_counter,
            control,
        ]
        self.bus = PeripheralBus(processor, self._peripherals, tables.register_name)
        self._connect(list(blocks.values()))

    def _connect(self, blocks: list[Block | CoreDevice]) -> None:
        """Connect blocks with each other, and the chip selects of parts."""
        for block in blocks:
            if isinstance(block, PinInterrupts):
                for port in self._ports.values():
                    block.connect(port)
            elif isinstance(block, FlashControl):
                lib.machine_pass_flash_stores(self._processor.machine.handle)
                self.bus.store_in_flash = block.program
        for bus in self._spi.values():
            for name in bus.devices:
                port, number = self.pin(name)
                port.on_change.append(partial(self._follow_select, bus, name, 1 << number))
                port.drive(number, True)  # a pull-up

    def _follow_select(self, bus: SpiBus, name: str, pin: int, rose: int, fell: int) -> None:
        if (rose | fell) & pin:
            bus.set_select(name, bool(rose & pin), self.clocks.time_s())

    def _model(self, module: ChipPeripheral, table: BlockTable) -> Block | CoreDevice:
        """Return the model of a block, which its list of registers selects."""
        processor, clocks = self._processor, self.clocks
        is_slow = table.gate.startswith("APB1")
        bus_clock = clocks.pclk1 if is_slow else clocks.pclk2
        if table.registers == "rcc":
            return clocks
        if table.registers == "gpio":
            return Gpio(processor, module)
        if table.registers == "usart":
            return Usart(processor, module, bus_clock, clocks.time)
        if table.registers == "timer":
            return Timer(processor, module, clocks.timers1 if is_slow else clocks.timers2, table.bits)
        if table.registers == "i2c":
            return I2c(processor, module, self._i2c[module.name.lower()], bus_clock, clocks.time)
        if table.registers == "spi":
            return Spi(processor, module, self._spi[module.name.lower()], bus_clock, clocks.time, self.unmodelled)
        if table.registers == "syscfg":
            self._selection = PinSelection(processor, module, self.unmodelled)
            return self._selection
        if table.registers == "exti":
            return PinInterrupts(processor, module, self._selection, self.unmodelled)
        if table.registers == "dma":
            return Dma(processor, module, clocks.core, self._machine.sources(module.name))
        if table.registers == "flash":
            memory = next(memory for memory in self._machine.memories if memory.sectors_kib)
            return FlashControl(
                processor, module, begin=memory.begin, sectors_kib=[*memory.sectors_kib], time=clocks.time,
                log=self.unmodelled,
            )  # fmt: skip
        if table.registers in _STORED:
            return Block(processor, module)
        return UnmodelledBlock(processor, module, self.unmodelled)

    def parts(self) -> list[HasState]:
        """Return the blocks with their bus, and the event queue."""
        return [
            *self._peripherals,
            self.bus,
            self._processor.schedule,
            self.unmodelled,
            *self._i2c.values(),
            *self._spi.values(),
        ]

    def power_on(self, segments: Iterable[LoadSegment]) -> None:
        """Write the words that the factory has programmed."""
        for words in self._machine.words:
            self._processor.memory.write_words(words.address, words.values)

    def reset(self, source: ResetSource) -> None:
        """Bring every block to its state after a reset of the chip."""
        for peripheral in self._peripherals:
            peripheral.reset()
        self.clocks.note_reset(source)

    def pin(self, name: str) -> tuple[Gpio, int]:
        """Return the port of a pin such as ``PA5``, and its number in the port.

        Raises
        ------
        ConfigError
            If the chip has no such pin.
        """
        match = _PIN.fullmatch(name)
        if match is None or match[1] not in self._ports or int(match[2]) >= PINS:
            ports = ", ".join(sorted(self._ports))
            raise ConfigError(f"the {self._machine.title} has no pin {name!r}; write PA0 to PA15, with one of {ports}")
        return self._ports[match[1]], int(match[2])

    def describe_sleep(self) -> str:
        """Return a description of the processor's sleep mode."""
        return ""


class _LedsAndButtons(LedsAndButtons):
    """The LEDs and buttons of a board, all of which are active high."""

    def __init__(self, machine: MachineFile, chip: DescribedChip) -> None:
        def drive(button: str, is_released: bool) -> None:
            port, number = chip.pin(machine.board.buttons[button])
            port.drive(number, not is_released)

        super().__init__(machine.title, machine.board.leds, machine.board.buttons, drive, chip.clocks.time_s)
        for led, pin in machine.board.leds.items():
            port, number = chip.pin(pin)
            port.on_change.append(partial(self._follow, led, number))

    def _follow(self, led: str, number: int, rose: int, fell: int) -> None:
        if (rose | fell) >> number & 1:
            self._record(led, bool(rose >> number & 1))


class DescribedMachine(VirtualMachine):
    """A board of a machine file that runs an image.

    Parameters
    ----------
    machine
        Name of a shipped machine, or a file (``.toml``).
    elf
        File, or its content: firmware linked for the chip.
    i2c
        Parts by the name of their bus, such as ``i2c1``.
    spi
        Parts by the name of their bus, such as ``spi1``, and the pin of their chip select.
    profile
        Timing profile; by default that of the part at its highest clock.

    Raises
    ------
    ConfigError
        If there is no such machine or bus, or the image is not for its core or memories.
    """

    _chip: DescribedChip

    def __init__(
        self,
        machine: str,
        elf: str | Path | bytes | FirmwareImage,
        *,
        i2c: Mapping[str, Sequence[I2cDevice]] | None = None,
        spi: Mapping[str, Mapping[str, SpiDevice]] | None = None,
        profile: str | TimingProfile | None = None,
    ) -> None:
        table = load_machine(machine)
        for bus, parts in {**(i2c or {}), **(spi or {})}.items():
            buses = _buses_of(table, "i2c", "spi")
            if parts and bus not in buses:
                raise ConfigError(f"the {table.title} has no bus {bus}; known: {', '.join(buses)}")

        def chip(processor: Processor) -> DescribedChip:
            self._chip = DescribedChip(processor, table, i2c or {}, spi or {})
            return self._chip

        timing = load_part(table.part).timing() if profile is None else profile
        super().__init__(elf, profile=timing, memory=table.memory_map, chip=chip, core=table.core)
        self.title = table.title  # type: ignore[misc]  # of this machine, not of its class
        self._leds_and_buttons = _LedsAndButtons(table, self._chip)
