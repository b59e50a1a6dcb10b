"""The virtual FRDM-K64F: the MK64FN1M0's memories and the peripherals that firmware here uses."""

from __future__ import annotations

import contextlib
import math
from collections.abc import Callable, Iterable, Sequence
from fractions import Fraction
from functools import partial
from pathlib import Path

from hiltest.errors import BoardFault, ConfigError, place_of
from hiltest.virtual.board.bare_part import BarePart
from hiltest.virtual.board.board_parts import BoardParts
from hiltest.virtual.board.loading import load_running, load_segments, vectors
from hiltest.virtual.board.memory_map import memory_map
from hiltest.virtual.board.memory_use import memory_use
from hiltest.virtual.board.microcontroller import Microcontroller
from hiltest.virtual.calls.call_clock import CALL_HZ, checked_clock
from hiltest.virtual.calls.call_watch import CallWatch
from hiltest.virtual.calls.calling import CallResult, call_function, function_named
from hiltest.virtual.calls.procedure_call import Argument
from hiltest.virtual.calls.solution_watch import SolutionEnd, SolutionWatch
from hiltest.virtual.model.profile_file import DEFAULT_PROFILE, load_profile
from hiltest.virtual.model.timing import TimingProfile
from hiltest.virtual.part.chip import MemoryMap
from hiltest.virtual.peripherals.i2c_bus import I2cDevice
from hiltest.virtual.peripherals.rcm import ResetRequested, ResetSource
from hiltest.virtual.processor.clock import PICOSECONDS
from hiltest.virtual.processor.cpu import Processor
from hiltest.virtual.processor.faults import FaultRecord
from hiltest.virtual.processor.memory import MK64FN1M0
from hiltest.virtual.processor.schedule import Event
from hiltest.virtual.processor.stacks import known_stacks
from hiltest.virtual.program.elf import FirmwareImage, load_image
from hiltest.virtual.program.instructions import decode
from hiltest.virtual.program.stack_bounds import NoBound, StackBounds, bound_with_exceptions

#: After so much virtual time a called function is taken to hang [s]: no function that is measured comes near, and
#: the slowest way to count, with a profile, takes the host about a minute for it.
HANG_S = 1.0

class VirtualK64F(BoardParts):
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
        Name of a profile, or of a user's own file (``.toml``), see `hiltest.virtual.model.profile_file`.
    strict : bool
        Whether a peripheral that the chip has and this board does not model is a bus error. Otherwise its
        registers keep what is written, and `unmodelled` lists what was touched.
    memory : str or MemoryMap, optional
        Memories of another part, see `memory_map`, by default those that the image needs. With them functions are
        called, no firmware starts, and of the peripherals there are the processor's own alone.
    flash_file : str or Path, optional
        Holds the flash from run to run. At power-on it gives back the sectors that the image has nothing in.

    Attributes
    ----------
    run_processor : callable
        Runs the processor, as `Processor.run`: a debugger puts itself here.
    debugged : bool
        Whether one is connected.
    halted_s : float
        For how long it has been halted so far [s of wall time].

    Raises
    ------
    ConfigError
        If the ELF is not for this processor or does not fit its memories, or what is given is not of such a part.
    """

    def __init__(
        self,
        elf: str | Path | bytes | FirmwareImage,
        *,
        i2c0: Sequence[I2cDevice] = (),
        i2c1: Sequence[I2cDevice] = (),
        profile: str | TimingProfile = DEFAULT_PROFILE,
        strict: bool = False,
        memory: str | MemoryMap | None = None,
        flash_file: str | Path | None = None,
    ) -> None:
        source = Path(elf) if isinstance(elf, str) else elf
        self.image = source if isinstance(source, FirmwareImage) else load_image(source)
        priced = load_profile(profile) if isinstance(profile, str) else profile
        self.memory = memory if isinstance(memory, MemoryMap) else memory_map(self.image, memory)
        if priced.memory and self._is_foreign:
            raise ConfigError(f"{priced.name} counts the K64F's memories, not {self.memory}; take {DEFAULT_PROFILE}")
        self.processor = Processor(self.image, priced, memories=self.memory)
        if self._is_foreign and (i2c0 or i2c1 or flash_file):
            raise ConfigError(f"{self.image.name} is on {self.memory}: i2c0, i2c1 and flash_file are of the MK64FN1M0")
        super().__init__(
            BarePart(self.processor) if self._is_foreign
            else Microcontroller(self.processor, (i2c0, i2c1), strict=strict, flash_file=flash_file)
        )  # fmt: skip
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

    def reset_at(self, time_s: float, source: ResetSource) -> None:
        """Reset the board at a time, whatever it is at then: by its button, or as the supply comes back."""

        def reset() -> None:
            raise ResetRequested(source)

        self.clocks.time.at(math.ceil(Fraction(time_s) * PICOSECONDS), reset)

    def _reset(self, source: ResetSource) -> None:
        processor = self.processor
        processor.reset()
        self._chip.reset(source)
        stack, entry = vectors(processor.memory, self.image)
        processor.core.vector_table = self.image.vectors
        processor.core.r[13], processor.core.r[15] = stack & ~3, entry & ~1

    # -- time ---------------------------------------------------------------------------------

    @property
    def cycles(self) -> int:
        """Clock cycles since power-on."""
        return self.processor.cycles

    @property
    def instructions(self) -> int:
        """Instructions executed since power-on."""
        return self.processor.instructions

    def memory_use(self) -> dict[str, int]:
        """Return the bytes that the firmware takes, see `hiltest.virtual.board.memory_use`."""
        return memory_use(self.image, self.memory, known_stacks(self.processor.machine))

    def stack_bounds(self, functions: Iterable[str]) -> dict[str, int | str]:
        """Return the bytes of stack that functions can take at most, by name, or why that is not known.

        The empty name is that of the whole firmware, with the exceptions that were taken or are enabled.
        """
        bounds, found = StackBounds(self.image), dict[str, int | str]()
        nvic, table = self.processor.nvic, self.processor.core.vector_table
        with contextlib.suppress(ConfigError):  # it did not start from here
            _, entry = vectors(self.processor.memory, self.image)
            read = self.processor.memory.read_words
            handlers = [[read(table + 4 * each, 1)[0] for each in alike] for alike in nvic.together()]
            found[""] = self._bound(lambda: bound_with_exceptions(bounds, entry, handlers))
        for name in functions:
            address = function_named(self.image, name).address
            found[name] = self._bound(partial(bounds.bound, address))
        return found

    @staticmethod
    def _bound(bound: Callable[[], int]) -> int | str:
        try:
            return bound()
        except NoBound as error:
            return str(error)

    @property
    def time_s(self) -> float:
        """Virtual time since power-on [s]."""
        return self.clocks.time_s()

    @property
    def faults(self) -> Sequence[FaultRecord]:
        """Faults that the firmware's handlers got since power-on: the first thousand."""
        return tuple(self.processor.fault_log.records)

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
            return f"asleep{self._part.describe_sleep()} in {place}"
        if self._loops_at(pc & ~1):
            rests = self.may_rest and self.processor.waiting.in_thread
            return f"{'at rest' if rests else 'hung'}, looping to itself in {place}"
        bitten = f", reset {self._part.bites} times by its watchdog" if self._part.bites else ""
        return f"executing {place}{self.processor.waits_for()}{bitten}"

    def _loops_at(self, address: int) -> bool:
        """Whether a branch to itself stands there; what stands there may be the end of a memory, or nothing."""
        for size in (4, 2):
            with contextlib.suppress(ValueError):
                return decode(address, self.processor.memory.read(address, size))[0].jumps_to(address)
        return False

    def run_until(self, time_s: float, *, wake: Callable[[], bool] | None = None, for_bytes: bool = False) -> None:
        """Run the firmware until virtual time `time_s`, or until `wake` answers true.

        Parameters
        ----------
        time_s : float
            Virtual time since power-on [s].
        wake : callable, optional
            Asked after every event of a peripheral.
        for_bytes : bool
            Whether it need not be asked before bytes come that the host of a UART expects, see `Uart.host_expect`.

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
                    self.run_processor(until, wake=wake, for_bytes=for_bytes)
                    return
                except ResetRequested as request:
                    fault = self.processor.fault_log.first_cause
                    if request.source is ResetSource.POWER_ON:
                        self.boot()
                    else:
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
            with self.processor.calls.paused():
                return call_function(
                    self.processor, symbol, arguments, booted=self._booted, clock_hz=clock_hz, timeout_s=timeout_s
                )
        except ResetRequested as request:
            by = "asked for" if request.source is ResetSource.SOFTWARE else "was ended by the watchdog with"
            raise BoardFault(f"{symbol} {by} a system reset", pc=self.image.symbols[symbol].address) from None
