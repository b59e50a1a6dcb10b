"""The virtual FRDM-K64F: the MK64FN1M0's memories and the peripherals that firmware here uses."""

from __future__ import annotations

import contextlib
import math
from collections.abc import Callable, Sequence
from fractions import Fraction
from pathlib import Path

from hiltest.errors import BoardFault, ConfigError, place_of
from hiltest.virtual.accounting import AccountingFactory
from hiltest.virtual.calling import CallResult, call_function
from hiltest.virtual.chip import mk64f12
from hiltest.virtual.clock import PICOSECONDS
from hiltest.virtual.cpu import Processor
from hiltest.virtual.elf import load_image
from hiltest.virtual.faults import FaultRecord
from hiltest.virtual.flash_waits import FlashController
from hiltest.virtual.frdm_k64f import LedsAndButtons
from hiltest.virtual.i2c_bus import I2cBus, I2cDevice
from hiltest.virtual.instructions import decode
from hiltest.virtual.interrupt_wires import InterruptSource, InterruptWires, Wire
from hiltest.virtual.memory import SRAM
from hiltest.virtual.memory_waits import MemoryAccounting
from hiltest.virtual.native import by_block
from hiltest.virtual.peripherals.bus import Peripheral, PeripheralBus, StoredRegisters
from hiltest.virtual.peripherals.clock_generator import ClockGenerator
from hiltest.virtual.peripherals.clocks import ClockGates
from hiltest.virtual.peripherals.cycle_counter import CycleCounter
from hiltest.virtual.peripherals.flash_control import FlashControl
from hiltest.virtual.peripherals.i2c import I2c
from hiltest.virtual.peripherals.pins import Gpio, Port
from hiltest.virtual.peripherals.pit import PeriodicTimers
from hiltest.virtual.peripherals.reset_control import ResetControl, ResetSource
from hiltest.virtual.peripherals.system_control import SystemControlSpace
from hiltest.virtual.peripherals.uart import Uart
from hiltest.virtual.peripherals.unmodelled import UnmodelledAccess, UnmodelledLog, UnmodelledPage
from hiltest.virtual.peripherals.watchdog import Watchdog
from hiltest.virtual.procedure_call import Argument
from hiltest.virtual.profile_file import DEFAULT_PROFILE, load_profile
from hiltest.virtual.schedule import Event
from hiltest.virtual.timing import TimingProfile

#: Core clock of functions that are called without boot [Hz].
CALL_HZ = 120_000_000
#: After so much virtual time a called function is taken to hang [s]: no function that is measured comes near, and
#: the slowest way to count, with a profile, takes the host about a minute for it.
HANG_S = 1.0

# Registers that firmware sets up without an effect that it could see: not reported.
_STORED = {
    "SIM (SOPT)": 0x40047000, "OSC": 0x40065000, "SMC": 0x4007E000, "SYSMPU": 0x4000D000, "PMC": 0x4007D000,
}  # fmt: skip
_FIRST_PORT, _FIRST_PORT_INTERRUPT = 0x40049000, 59


class _ResetRequested(Exception):
    """Request to reset the part: by AIRCR, or by the watchdog."""

    def __init__(self, source: ResetSource) -> None:
        super().__init__("the watchdog reset it" if source is ResetSource.WATCHDOG else "the firmware reset itself")
        self.source = source


def _accounting_for(profile: TimingProfile) -> AccountingFactory:
    return MemoryAccounting if profile.memory else by_block


class VirtualK64F:
    """A board that runs an ELF, instruction by instruction, with a cycle count.

    Virtual time follows the clocks that the firmware sets up: out of reset the core
    runs at 20.97 MHz.

    Parameters
    ----------
    elf : str, Path or bytes
        File, or the content of one: firmware laid out for the MK64FN1M0.
    i2c0, i2c1 : sequence of I2cDevice
        Parts on the two buses.
    profile : str or TimingProfile
        Name of a profile, or of a user's own file (``.toml``), see `hiltest.virtual.profile_file`.
    accounting : AccountingFactory, optional
        What counts; by default by block, in C where that is there, and with a profile that has memory rows by
        instruction, with them. `InstructionAccounting` is slow, and the reference.
    strict : bool
        Whether a peripheral that the chip has and this board does not model is a bus error. Otherwise its
        registers keep what is written, and `unmodelled` lists what was touched.

    Attributes
    ----------
    events : list of BoardEvent
        What the LEDs and buttons did since power-on.

    Raises
    ------
    ConfigError
        If the ELF is not for this processor or does not fit its memories.
    """

    def __init__(
        self,
        elf: str | Path | bytes,
        *,
        i2c0: Sequence[I2cDevice] = (),
        i2c1: Sequence[I2cDevice] = (),
        profile: str | TimingProfile = DEFAULT_PROFILE,
        accounting: AccountingFactory | None = None,
        strict: bool = False,
    ) -> None:
        self.image = load_image(Path(elf) if isinstance(elf, str) else elf)
        priced = load_profile(profile) if isinstance(profile, str) else profile
        self.processor = Processor(self.image, priced, accounting=accounting or _accounting_for(priced))
        generator = ClockGenerator()
        self.clocks = ClockGates(self.processor, generator)
        self.uart0 = Uart(self.processor, self.clocks, self.clocks.core)
        self.timers = PeriodicTimers(self.processor, self.clocks)
        self.watchdog = Watchdog(self.clocks, bite=self._bitten)
        self._reset_control = ResetControl()
        self._bites = 0  # of the watchdog, since power-on
        self.cycle_counter = CycleCounter(self.processor)
        self._i2c_buses = (I2cBus(i2c0), I2cBus(i2c1))
        chip = mk64f12()
        nvic = self.processor.nvic
        ports = {
            letter: Port(letter, base, _FIRST_PORT_INTERRUPT + index, nvic, chip.reset_bytes(base))
            for index, letter in enumerate("ABCDE")
            for base in [_FIRST_PORT + 0x1000 * index]
        }
        self._peripherals: list[Peripheral] = [
            generator, self.clocks, self.watchdog, self._reset_control, self.uart0, self.cycle_counter,
            SystemControlSpace(self.processor, self.clocks.core, self.cycle_counter, self._request_reset),
            self.timers, *ports.values(), Gpio(list(ports.values())), FlashControl(self._flash_controller()),
            *self._i2c_masters(),
            *(StoredRegisters(name, base, chip.reset_bytes(base)) for name, base in _STORED.items()),
        ]  # fmt: skip
        self._unmodelled = UnmodelledLog(self.processor, chip)
        if not strict:
            modelled = {peripheral.base >> 12 for peripheral in self._peripherals}
            self._peripherals += [
                UnmodelledPage(page << 12, peripherals, chip, self._unmodelled)
                for page, peripherals in chip.pages.items()
                if page not in modelled
            ]
        for peripheral in self._peripherals:
            gates = {gate for entry in chip.pages.get(peripheral.base >> 12, ()) for gate in entry.gates}
            self.clocks.gate(peripheral, gates)
        self._ports = ports
        self._bus = PeripheralBus(self.processor, self._peripherals, chip.register_name)
        self.clocks.on_gates = self._bus.look_again
        self._leds_and_buttons = LedsAndButtons(ports, self.clocks.time_s)
        self.events = self._leds_and_buttons.events
        self._booted = False
        self._load()

    def _flash_controller(self) -> FlashController | None:
        accounting = self.processor.accounting
        return accounting.flash if isinstance(accounting, MemoryAccounting) else None

    def _i2c_masters(self) -> list[I2c]:
        modules = (("I2C0", 0x40066000, 24), ("I2C1", 0x40067000, 25))
        return [
            I2c(self.processor, self.clocks, bus, name=name, base=base, interrupt=interrupt)
            for (name, base, interrupt), bus in zip(modules, self._i2c_buses, strict=True)
        ]

    def lead_interrupts(self, bus: int, part: InterruptSource, *, int1: str | None, int2: str | None) -> None:
        """Connect the interrupt pins of a part.

        Parameters
        ----------
        bus : int
            Which I2C bus the part is on: 0 or 1.
        part : InterruptSource
            One of the parts given for that bus.
        int1, int2 : str or None
            Pins of the processor, such as ``PTB9``; None leaves one open.
        """
        pins = self._wire_to(int1), self._wire_to(int2)
        wires = InterruptWires(part, pins, self.clocks.time)
        self._i2c_buses[bus].after_stop(part, wires.look)
        wires.look()

    def _wire_to(self, pin: str | None) -> Wire | None:
        if pin is None:
            return None
        port, number = self._ports[pin[2]], int(pin[3:])
        return lambda high: port.drive(number, high)

    # -- memory and reset ---------------------------------------------------------------------

    def _load(self) -> None:
        memory = self.processor.memory
        memory.clear()
        for segment in self.image.segments:
            try:
                memory.write(segment.address, segment.data)
                memory.read(segment.run_address, segment.run_size)
            except ValueError as error:
                raise ConfigError(
                    f"{self.image.name}: a segment does not fit the MK64FN1M0 ({error}); "
                    "link for 1 MiB of flash at 0 and 256 KiB of SRAM at 0x1fff0000"
                ) from error

    def boot(self) -> None:
        """Power on: start the firmware from its vector table at the next `run_until`."""
        self._load()
        self._bites = 0
        self._reset(ResetSource.POWER_ON)
        self.processor.delivers_faults = True
        self._booted = True

    def _reset(self, source: ResetSource) -> None:
        processor = self.processor
        processor.nvic.reset()
        processor.exceptions.reset()
        processor.fault_log.forget_open()
        for peripheral in self._peripherals:
            peripheral.reset()
        self._reset_control.reset_by(source)
        self.watchdog.start()
        processor.sleeping = False
        processor.accounting.forget_code()
        processor.accounting.flush_pipeline()
        stack, entry = self._vectors()
        registers = processor.registers
        registers.xpsr.set(1 << 24)
        for register in (registers.control, registers.primask, registers.basepri, registers.faultmask):
            register.set(0)
        registers.general.write([0] * 13 + [stack, 0xFFFFFFFF, entry | 1, 1 << 24])

    def _vectors(self) -> tuple[int, int]:
        """Read initial stack pointer and reset vector; the part would lock up on wrong ones."""
        stack, entry = self.processor.memory.read_words(0, 2)
        in_sram = SRAM[0] < stack <= SRAM[0] + SRAM[1] and stack % 4 == 0
        code = self.image.segments
        in_code = any(segment.address <= entry & ~1 < segment.address + len(segment.data) for segment in code)
        if not (in_sram and in_code and entry & 1):
            raise ConfigError(
                f"{self.image.name}: what stands at address 0 is no vector table (stack 0x{stack:08x}, reset "
                f"0x{entry:08x}); link the vectors to 0, the stack into SRAM, and handlers with the Thumb bit"
            )
        return stack, entry

    def _request_reset(self) -> None:
        self.processor.abort(_ResetRequested(ResetSource.SOFTWARE))

    def _bitten(self) -> None:
        self._bites += 1
        raise _ResetRequested(ResetSource.WATCHDOG)  # the emulator stands still: nothing to abort

    # -- time ---------------------------------------------------------------------------------

    @property
    def cycles(self) -> int:
        """Clock cycles since power-on."""
        return self.processor.cycles

    @property
    def instructions(self) -> int:
        """Instructions executed since power-on."""
        return self.processor.instructions

    @property
    def time_s(self) -> float:
        """Virtual time since power-on [s]."""
        return self.clocks.time_s()

    @property
    def faults(self) -> Sequence[FaultRecord]:
        """Faults that the firmware's handlers got since power-on: the first thousand."""
        return tuple(self.processor.fault_log.records)

    @property
    def unmodelled(self) -> Sequence[UnmodelledAccess]:
        """First access to each register that keeps what is written and does nothing; `str` of one is a sentence."""
        return self._unmodelled.accesses

    def press(self, button: str) -> None:
        """Press ``SW2`` or ``SW3``, and keep it pressed."""
        self._leds_and_buttons.push(button, True)

    def release(self, button: str) -> None:
        """Release a button."""
        self._leds_and_buttons.push(button, False)

    def is_on(self, what: str) -> bool:
        """Whether an LED (``LED red``, ``LED green``, ``LED blue``) is lit, or a button is pressed."""
        return self._leds_and_buttons.is_on(what)

    def position(self) -> str:
        """Say where the firmware is: sleeping, or executing which line, and in which fault's handler."""
        fault = self.processor.fault_log.first_cause
        if fault is None:
            return self._doing()
        return f"{self._doing()}, after: {fault.cause} at {place_of(fault.pc, fault.function, fault.location)}"

    def _doing(self) -> str:
        pc = self.processor.registers.pc.get()
        function = self.image.function_at(pc)
        place = f"{function.name if function else hex(pc)} ({self.image.location_at(pc) or 'no line known'})"
        if self.processor.sleeping:
            return f"asleep in {place}"
        if self._loops_at(pc & ~1):
            return f"hung, looping to itself in {place}"
        polled = self._unmodelled.polled
        bitten = f", reset {self._bites} times by its watchdog" if self._bites else ""
        return f"executing {place}" + (f", polling {polled}, which is not modelled" if polled else "") + bitten

    def _loops_at(self, address: int) -> bool:
        """Whether a branch to itself stands there; what stands there may be the end of a memory, or nothing."""
        for size in (4, 2):
            with contextlib.suppress(ValueError):
                return decode(address, self.processor.memory.read(address, size))[0].jumps_to(address)
        return False

    def run_until(self, time_s: float, *, wake: Callable[[], bool] | None = None) -> None:
        """Run the firmware until virtual time `time_s`, or until `wake` answers true.

        Parameters
        ----------
        time_s : float
            Virtual time since power-on [s].
        wake : callable, optional
            Asked after every event of a peripheral.

        Raises
        ------
        BoardFault
            The processor met a fault, or hung.
        ConfigError
            The image has no vector table to boot from.
        """
        if not self._booted:
            self.boot()
        until = self._moment(time_s)
        try:
            while True:
                try:
                    self.processor.run(until, wake=wake)
                    return
                except _ResetRequested as request:
                    fault = self.processor.fault_log.first_cause
                    self._reset(request.source)
                    if fault is not None:
                        raise fault.ended(str(request)) from None
        finally:
            until.cancel()

    def _moment(self, time_s: float) -> Event:
        """Return the event of reaching a time, whatever the clocks do until then."""
        if not math.isfinite(time_s):
            return Event(math.inf)
        until = math.ceil(Fraction(time_s) * PICOSECONDS)
        return self.clocks.time.at(until, lambda: None, wakes=False)

    # -- calling functions --------------------------------------------------------------------

    @property
    def call_hz(self) -> float:
        """Core clock of a function that is called now [Hz]: as the firmware has set it up, 120 MHz without boot."""
        return self.clocks.core_hz if self._booted else CALL_HZ

    def call(self, symbol: str, *arguments: Argument, timeout_s: float = HANG_S) -> CallResult:
        """Call one function of the image and count what it costs.

        Works without booting; on a running board the processor's state is put
        back afterwards. Interrupts are masked during the call.

        Parameters
        ----------
        symbol : str
            Name of the function.
        *arguments : int, float, bytes, bytearray, numpy array or Structure
            By the types in the DWARF; integers only without it. A buffer is
            copied to free RAM and passed by address; a writable one gets what
            the function left there.
        timeout_s : float
            Virtual time after which it is taken to hang [s].

        Returns
        -------
        CallResult
            ``.value``, ``.cycles`` and ``.instructions``.

        Raises
        ------
        ConfigError
            No such function, or arguments that do not fit it.
        BoardFault
            The function faulted or hung.
        """
        if not self._booted:
            for segment in self.image.segments:
                zeroed = segment.run_size - len(segment.data)
                self.processor.memory.write(segment.run_address, segment.data + bytes(zeroed))
        try:
            return call_function(
                self.processor, symbol, arguments, booted=self._booted, hang_cycles=round(timeout_s * self.call_hz)
            )
        except _ResetRequested as request:
            by = "asked for" if request.source is ResetSource.SOFTWARE else "was ended by the watchdog with"
            raise BoardFault(f"{symbol} {by} a system reset", pc=self.image.symbols[symbol].address) from None
