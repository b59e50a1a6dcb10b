"""The virtual FRDM-K64F: the MK64FN1M0's memories and the peripherals that firmware here uses."""

from __future__ import annotations

import contextlib
import math
from collections.abc import Callable, Iterable, Iterator, Sequence
from fractions import Fraction
from pathlib import Path

from hiltest.errors import BoardFault, ConfigError, place_of
from hiltest.virtual.accounting import AccountingFactory
from hiltest.virtual.call_clock import CALL_HZ, checked_clock
from hiltest.virtual.call_watch import CallWatch
from hiltest.virtual.calling import CallResult, call_function
from hiltest.virtual.clock import PICOSECONDS
from hiltest.virtual.cpu import Processor
from hiltest.virtual.elf import FirmwareImage, load_image
from hiltest.virtual.faults import FaultRecord
from hiltest.virtual.frdm_k64f import LedsAndButtons
from hiltest.virtual.i2c_bus import I2cDevice
from hiltest.virtual.instructions import decode
from hiltest.virtual.interrupt_wires import InterruptSource, InterruptWires
from hiltest.virtual.loading import load_running, load_segments, vectors
from hiltest.virtual.memory import MK64FN1M0, MemoryMap
from hiltest.virtual.memory_map import memory_map
from hiltest.virtual.memory_waits import MemoryAccounting
from hiltest.virtual.microcontroller import Microcontroller
from hiltest.virtual.native import by_block
from hiltest.virtual.peripherals.pins import Port
from hiltest.virtual.peripherals.reset_control import ResetRequested, ResetSource
from hiltest.virtual.peripherals.unmodelled import UnmodelledAccess
from hiltest.virtual.procedure_call import Argument
from hiltest.virtual.profile_file import DEFAULT_PROFILE, load_profile
from hiltest.virtual.schedule import Event
from hiltest.virtual.solution_watch import SolutionEnd, SolutionWatch
from hiltest.virtual.timing import TimingProfile

#: After so much virtual time a called function is taken to hang [s]: no function that is measured comes near, and
#: the slowest way to count, with a profile, takes the host about a minute for it.
HANG_S = 1.0

def _accounting_for(profile: TimingProfile) -> AccountingFactory:
    return MemoryAccounting if profile.memory else by_block


class VirtualK64F:
    """A board that runs an ELF, instruction by instruction, with a cycle count.

    Virtual time follows the clocks that the firmware sets up: out of reset the core
    runs at 20.97 MHz.

    Parameters
    ----------
    elf : str, Path, bytes or FirmwareImage
        File, or the content of one: firmware laid out for the MK64FN1M0, as ELF, Intel HEX or raw binary at 0. One that
        belongs elsewhere: `load_image(path, base=0x8000)`.
    i2c0, i2c1 : sequence of I2cDevice
        Parts on the two buses.
    profile : str or TimingProfile
        Name of a profile, or of a user's own file (``.toml``), see `hiltest.virtual.profile_file`.
    accounting : AccountingFactory, optional
        What counts; by default by block, in C where that is there, and with a profile that has memory rows by
        instruction, with them. `InstructionAccounting` is slow, and the reference.
    passes_waits : bool
        Whether loops that only wait are passed over by whole turns, up to the next event, where counting is in C.
        Nothing but the time that the host needs depends on it.
    strict : bool
        Whether a peripheral that the chip has and this board does not model is a bus error. Otherwise its
        registers keep what is written, and `unmodelled` lists what was touched.
    memory : str or MemoryMap, optional
        Memories of another part, see `memory_map`, by default those that the image needs. With them functions are
        called, no firmware starts, and of the peripherals there are the processor's own alone.
    seed : int
        Of the numbers that the chip's random number generator makes.
    flash_file : str or Path, optional
        Holds the flash from run to run. At power-on it gives back the sectors that the image has nothing in.

    Attributes
    ----------
    uarts : tuple of Uart
        UART0 to UART5, each with the far end of its wire: `host_write`, `host_read`, `line_baud`. `uart0` is the first.
    events : list of BoardEvent
        What the LEDs and buttons did since power-on.
    run_processor : callable
        Runs the processor, as `Processor.run`: a debugger puts itself here.
    debugged : bool
        Whether one is connected.
    halted_s : float
        For how long it has been halted so far [s of wall time].
    bus : PeripheralBus
    adc_volts : dict of (int, int) to float
        Voltages of the converters' inputs by converter and channel, such as ``adc_volts[0, 12] = 1.2``; of a
        differential channel between its pins. Others have 0 V.

    Raises
    ------
    ConfigError
        If the ELF is not for this processor or does not fit its memories.
    """

    def __init__(
        self,
        elf: str | Path | bytes | FirmwareImage,
        *,
        i2c0: Sequence[I2cDevice] = (),
        i2c1: Sequence[I2cDevice] = (),
        profile: str | TimingProfile = DEFAULT_PROFILE,
        accounting: AccountingFactory | None = None,
        passes_waits: bool = True,
        strict: bool = False,
        memory: str | MemoryMap | None = None,
        seed: int = 0,
        flash_file: str | Path | None = None,
    ) -> None:
        source = Path(elf) if isinstance(elf, str) else elf
        self.image = source if isinstance(source, FirmwareImage) else load_image(source)
        priced = load_profile(profile) if isinstance(profile, str) else profile
        self.memory = memory if isinstance(memory, MemoryMap) else memory_map(self.image, memory)
        if priced.memory and self._is_foreign:
            raise ConfigError(f"{priced.name} counts the K64F's memories, not {self.memory}; take {DEFAULT_PROFILE}")
        self.processor = Processor(
            self.image, priced, accounting=accounting or _accounting_for(priced), memories=self.memory,
            passes_waits=passes_waits,
        )
        self._chip = chip = Microcontroller(
            self.processor, (i2c0, i2c1), strict=strict, seed=seed, flash_file=flash_file
        )
        self.clocks, self.uarts, self.timers = chip.clocks, chip.uarts, chip.timers
        self.uart0 = chip.uart0
        self.watchdog, self.cycle_counter = chip.watchdog, chip.cycle_counter
        self.adc_volts = chip.adc_volts
        self._leds_and_buttons = LedsAndButtons(chip.ports, self.clocks.time_s)
        self.bus = chip.bus
        self.events = self._leds_and_buttons.events
        self.run_processor = self.processor.run
        self.debugged, self.halted_s = False, 0.0
        self._booted = False
        load_segments(self.processor.memory, self.image)

    @property
    def _is_foreign(self) -> bool:
        return self.memory != MK64FN1M0

    @property
    def may_rest(self) -> bool:
        """Whether firmware that ends in a loop to itself, without a fault, is at rest, and no hang."""
        return self.processor.waiting.may_rest

    @may_rest.setter
    def may_rest(self, may: bool) -> None:
        self.processor.waiting.may_rest = may

    def tell(self, told: Callable[[str], None]) -> None:
        """Say who is told, in a line, of a register that firmware waits for and that is not modelled.

        Otherwise that is an `UnmodelledWarning`.
        """
        self._chip.unmodelled.told = told

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
        pins = self._chip.wire_to(int1), self._chip.wire_to(int2)
        wires = InterruptWires(part, pins, self.clocks.time)
        self._chip.i2c_buses[bus].after_stop(part, wires.look)
        wires.look()

    def warm_by(self, temperature_degc: Callable[[], float]) -> None:
        """Say what answers the chip's temperature, which is 25 degC otherwise."""
        self._chip.temperature_degc = temperature_degc

    # -- reset --------------------------------------------------------------------------------

    def boot(self) -> None:
        """Power on: start the firmware from its vector table at the next `run_until`."""
        if self._is_foreign:
            raise ConfigError(
                f"{self.image.name}: firmware starts on the MK64FN1M0 alone, and this is on {self.memory}: "
                "functions of it can be called"
            )
        load_segments(self.processor.memory, self.image)
        self._chip.flash.power_on(self.image.segments)
        self._chip.bites = 0
        self._reset(ResetSource.POWER_ON)
        self.processor.delivers_faults = True
        self._booted = True

    def reset(self) -> None:
        """Press the reset button, and let it go: the firmware starts anew, time goes on."""
        self._reset(ResetSource.PIN)

    def _reset(self, source: ResetSource) -> None:
        processor = self.processor
        processor.nvic.reset()
        processor.exceptions.reset()
        processor.fault_log.forget_open()
        self._chip.reset(source)
        processor.sleeping = False
        processor.accounting.forget_code()
        processor.accounting.flush_pipeline()
        stack, entry = vectors(processor.memory, self.image)
        processor.exceptions.vector_table = self.image.vectors
        registers = processor.registers
        registers.xpsr.set(1 << 24)
        for register in (registers.control, registers.primask, registers.basepri, registers.faultmask):
            register.set(0)
        registers.general.write([0] * 13 + [stack, 0xFFFFFFFF, entry | 1, 1 << 24])

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
        return self._chip.unmodelled.accesses

    @contextlib.contextmanager
    def unnoticed(self) -> Iterator[None]:
        """Leave accesses out of `unmodelled` that are not the firmware's, for the time of the context."""
        self._chip.unmodelled.listens = False
        try:
            yield
        finally:
            self._chip.unmodelled.listens = True

    def press(self, button: str) -> None:
        """Press ``SW2`` or ``SW3``, and keep it pressed."""
        self._leds_and_buttons.push(button, True)

    def release(self, button: str) -> None:
        """Release a button."""
        self._leds_and_buttons.push(button, False)

    def is_on(self, what: str) -> bool:
        """Whether an LED (``LED red``, ``LED green``, ``LED blue``) is lit, or a button is pressed."""
        return self._leds_and_buttons.is_on(what)

    def drive(self, pin: str, high: bool) -> None:
        """Give a pin such as ``PTC5`` a level from outside."""
        self._pin(pin)[0].drive(self._pin(pin)[1], high)

    def level(self, pin: str) -> bool:
        """Level of a pin such as ``PTC5``, whoever gives it; low while it is analog."""
        port, number = self._pin(pin)
        return bool(port.levels >> number & 1)

    def _pin(self, name: str) -> tuple[Port, int]:
        port = self._chip.ports.get(name[2:3])
        if port is None or not (name.startswith("PT") and name[3:].isdecimal() and int(name[3:]) < 32):
            raise ConfigError(f"the MK64FN1M0 has no pin {name!r}; write PTA0 to PTE31")
        return port, int(name[3:])

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
            return f"asleep{self._chip.modes.describe()} in {place}"
        if self._loops_at(pc & ~1):
            rests = self.may_rest and self.processor.waiting.in_thread
            return f"{'at rest' if rests else 'hung'}, looping to itself in {place}"
        bitten = f", reset {self._chip.bites} times by its watchdog" if self._chip.bites else ""
        return f"executing {place}{self.processor.waits_for()}{bitten}"

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
                    self.run_processor(until, wake=wake)
                    return
                except ResetRequested as request:
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

    def watch_calls(self, functions: Iterable[str]) -> CallWatch:
        """Count the calls of functions from now on, while firmware runs."""
        return CallWatch(self.processor, functions)

    def watch_solutions(self, functions: Iterable[str], end: SolutionEnd) -> SolutionWatch:
        """Sum up the calls of functions that work in slices, by solution, from now on."""
        return SolutionWatch(self.processor, functions, end)

    # -- calling functions --------------------------------------------------------------------

    def _call_hz(self, asked_hz: float | None) -> float:
        if not self._booted:
            return CALL_HZ if asked_hz is None else checked_clock(asked_hz)
        if asked_hz is not None:
            raise ConfigError(
                f"clock_hz={asked_hz} is for functions called without boot; this firmware has set up "
                f"{self.clocks.core_hz / 1e6:g} MHz"
            )
        return self.clocks.core_hz

    def call(
        self, symbol: str, *arguments: Argument, timeout_s: float = HANG_S, clock_hz: float | None = None
    ) -> CallResult:
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
        clock_hz : float, optional
            Core clock without boot [Hz], by default 120 MHz; a running board has the one that its firmware made.

        Returns
        -------
        CallResult
            ``.value``, ``.cycles``, ``.instructions`` and ``.microseconds``.

        Raises
        ------
        ConfigError
            No such function, arguments that do not fit it, or no such clock.
        BoardFault
            The function faulted or hung.
        """
        clock_hz = self._call_hz(clock_hz)
        if not self._booted:
            load_running(self.processor.memory, self.image)
        try:
            with self.processor.exceptions.unfollowed():
                return call_function(
                    self.processor, symbol, arguments, booted=self._booted, clock_hz=clock_hz, timeout_s=timeout_s
                )
        except ResetRequested as request:
            by = "asked for" if request.source is ResetSource.SOFTWARE else "was ended by the watchdog with"
            raise BoardFault(f"{symbol} {by} a system reset", pc=self.image.symbols[symbol].address) from None
