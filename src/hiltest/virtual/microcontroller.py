"""The MK64FN1M0: its processor's peripherals, connected as the part's tables say."""

from __future__ import annotations

from collections.abc import Callable, Sequence

from hiltest.virtual.chip import ChipPeripheral, mk64f12
from hiltest.virtual.cpu import Processor
from hiltest.virtual.flash_waits import FlashController
from hiltest.virtual.i2c_bus import I2cBus, I2cDevice
from hiltest.virtual.memory import MK64FN1M0
from hiltest.virtual.memory_waits import MemoryAccounting
from hiltest.virtual.peripherals.bus import Peripheral, PeripheralBus, StoredRegisters
from hiltest.virtual.peripherals.clock_generator import ClockGenerator
from hiltest.virtual.peripherals.clocks import ClockGates
from hiltest.virtual.peripherals.cycle_counter import CycleCounter
from hiltest.virtual.peripherals.flash_control import FlashControl
from hiltest.virtual.peripherals.i2c import I2c
from hiltest.virtual.peripherals.pins import Gpio, Port
from hiltest.virtual.peripherals.pit import PeriodicTimers
from hiltest.virtual.peripherals.reset_control import ResetControl, ResetRequested, ResetSource
from hiltest.virtual.peripherals.system_control import SystemControlSpace
from hiltest.virtual.peripherals.uart import Uart
from hiltest.virtual.peripherals.unmodelled import UnmodelledLog, UnmodelledPage
from hiltest.virtual.peripherals.watchdog import Watchdog
from hiltest.virtual.waits.turns import LoopProver

# Firmware sets these up without an effect that it could see: their registers keep what is written, unreported.
_STORED = ("OSC", "SMC", "SYSMPU", "PMC")


class Microcontroller:
    """The peripherals of the part, on the bus of a processor.

    Parameters
    ----------
    processor : Processor
    i2c : (2,) sequence of sequence of I2cDevice
        Parts on I2C0 and I2C1.
    strict : bool
        Whether a peripheral that is not modelled is a bus error.

    Attributes
    ----------
    clocks : ClockGates
    uart0 : Uart
    timers : PeriodicTimers
    watchdog : Watchdog
    cycle_counter : CycleCounter
    i2c_buses : tuple of I2cBus
    ports : dict of str to Port
        By letter.
    unmodelled : UnmodelledLog
    bus : PeripheralBus
    bites : int
        Resets by the watchdog since power-on.
    """

    def __init__(self, processor: Processor, i2c: Sequence[Sequence[I2cDevice]], *, strict: bool = False) -> None:
        self._processor = processor
        self._chip = mk64f12()
        self._modules = {module.name: module for module in self._chip.peripherals}
        self.i2c_buses = tuple(I2cBus(parts) for parts in i2c)
        self.bites = 0
        generator = ClockGenerator()
        self.clocks = ClockGates(processor, generator)
        core = self._core_modules()
        self._peripherals: list[Peripheral] = [generator, self.clocks, *core, *self._chip_modules()]
        self._peripherals += [StoredRegisters(name, self._base(name), self._initial(name)) for name in _STORED]
        sim = self._base("SIM")
        self._peripherals.append(StoredRegisters("SIM (SOPT)", sim, self._chip.reset_bytes(sim)))
        self.unmodelled = UnmodelledLog(processor, self._chip)
        is_foreign = processor.memory.map != MK64FN1M0
        if is_foreign:  # what is around the processor is of another part, and nothing here is
            self._peripherals = core
        elif not strict:
            self._store_the_rest()
        for peripheral in self._peripherals:
            gates = {gate for entry in self._chip.pages.get(peripheral.base >> 12, ()) for gate in entry.gates}
            self.clocks.gate(peripheral, gates)
        self.bus = PeripheralBus(processor, self._peripherals, None if is_foreign else self._chip.register_name)
        self.clocks.on_gates = self.bus.look_again
        self.bus.on_passed = self.unmodelled.passed
        processor.accounting.pass_over = LoopProver(processor, self.bus).pass_over

    def _base(self, name: str) -> int:
        return self._modules[name].base

    def _initial(self, name: str) -> dict[int, int]:
        return self._chip.reset_bytes(self._base(name))

    def _core_modules(self) -> list[Peripheral]:
        """Make the processor's private peripherals."""
        self.cycle_counter = CycleCounter(self._processor)
        control = SystemControlSpace(self._processor, self.clocks.core, self.cycle_counter, self._request_reset)
        return [self.cycle_counter, control]

    def _chip_modules(self) -> list[Peripheral]:
        """Make the peripherals that the part has around the processor."""
        processor, clocks, modules = self._processor, self.clocks, self._modules
        self.uart0 = Uart(processor, clocks, clocks.core, modules["UART0"])
        self.timers = PeriodicTimers(processor, clocks, modules["PIT"])
        self.watchdog = Watchdog(clocks, bite=self._bitten)
        self.reset_control = ResetControl()
        self.ports = {letter: self._port(modules[f"PORT{letter}"]) for letter in "ABCDE"}
        masters = [
            I2c(processor, clocks, bus, modules[f"I2C{number}"]) for number, bus in enumerate(self.i2c_buses)
        ]
        return [
            self.uart0, self.timers, self.watchdog, self.reset_control, *self.ports.values(),
            Gpio(list(self.ports.values())), *masters, FlashControl(self._flash_controller()),
        ]  # fmt: skip

    def _port(self, module: ChipPeripheral) -> Port:
        return Port(module, self._processor.nvic, self._chip.reset_bytes(module.base))

    def _flash_controller(self) -> FlashController | None:
        accounting = self._processor.accounting
        return accounting.flash if isinstance(accounting, MemoryAccounting) else None

    def _store_the_rest(self) -> None:
        """Give every page that is left registers which keep what is written, and are reported."""
        modelled = {peripheral.base >> 12 for peripheral in self._peripherals}
        self._peripherals += [
            UnmodelledPage(page << 12, modules, self._chip, self.unmodelled)
            for page, modules in self._chip.pages.items()
            if page not in modelled
        ]

    # -- reset --------------------------------------------------------------------------------

    def reset(self, source: ResetSource) -> None:
        """Bring every peripheral to its state after a reset of the chip."""
        for peripheral in self._peripherals:
            peripheral.reset()
        self.reset_control.reset_by(source)
        self.watchdog.start()

    def _request_reset(self) -> None:
        self._processor.abort(ResetRequested(ResetSource.SOFTWARE))

    def _bitten(self) -> None:
        self.bites += 1
        raise ResetRequested(ResetSource.WATCHDOG)  # the emulator stands still: nothing to abort

    # -- what is outside the chip -------------------------------------------------------------

    def wire_to(self, pin: str | None) -> Callable[[bool], None] | None:
        """Return what sets the level of a pin such as ``PTB9`` from outside; None for no pin."""
        if pin is None:
            return None
        port, number = self.ports[pin[2]], int(pin[3:])
        return lambda high: port.drive(number, high)
