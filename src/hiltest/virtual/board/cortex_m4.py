"""A virtual Cortex-M4: processor and memories, with functions that can be called."""

from __future__ import annotations

import contextlib
from collections.abc import Callable, Iterable, Iterator, Sequence
from functools import partial
from pathlib import Path
from typing import Literal

from hiltest.errors import BoardFault, ConfigError, place_of
from hiltest.virtual.board.bare_part import BarePart
from hiltest.virtual.board.loading import initial_stack, load_running, load_segments, vectors
from hiltest.virtual.board.machine_chip import MachineChip
from hiltest.virtual.board.memory_map import memory_map
from hiltest.virtual.board.memory_use import memory_use
from hiltest.virtual.calls.call_clock import CALL_HZ, check_clock
from hiltest.virtual.calls.call_watch import CallWatch
from hiltest.virtual.calls.calling import CallResult, call_function, find_function
from hiltest.virtual.calls.procedure_call import Argument
from hiltest.virtual.calls.solution_watch import SolutionEnd, SolutionWatch
from hiltest.virtual.core.decoder import decode_first
from hiltest.virtual.core.library import lib
from hiltest.virtual.model.profile_file import DEFAULT_PROFILE, load_profile
from hiltest.virtual.model.timing import TimingProfile
from hiltest.virtual.part.chip import MemoryMap
from hiltest.virtual.peripherals.bus import PeripheralBus
from hiltest.virtual.peripherals.dwt import CycleCounter
from hiltest.virtual.peripherals.rcm import ResetRequested, ResetSource
from hiltest.virtual.peripherals.unmodelled import UnmodelledAccess
from hiltest.virtual.processor.cpu import Processor
from hiltest.virtual.processor.faults import FaultRecord
from hiltest.virtual.processor.memory import MK64FN1M0
from hiltest.virtual.processor.stack_bounds import NoBound, StackBounds, bound_with_exceptions
from hiltest.virtual.processor.stacks import known_stacks
from hiltest.virtual.program.elf import CORES, FirmwareImage, load_image

#: Virtual time after which a called function counts as hung [s]: no measured function comes near it, and with a
#: profile, the slowest way to count, the host needs about a minute for it.
HANG_S = 1.0


class VirtualCortexM4:
    """A processor with memories, which calls functions of an image and counts their cycles.

    It has only the processor's own peripherals, and does not boot firmware: `VirtualK64F` is a complete board.

    Parameters
    ----------
    elf
        File, or its content.
    profile
        Name of a profile, or a user's own file (``.toml``), see `hiltest.virtual.model.profile_file`.
    memory
        Memories of the part, see `memory_map`; by default those that the image needs.
    stack
        Where called functions find their stack, and above it their buffers, as a caller's variables: at the initial
        stack pointer of the image's vector table ("image"), or at the end of the largest RAM, with the buffers at
        its beginning ("ram").
    part
        Connects the peripherals around the processor.
    core
        Name of the core, of `CORES`.

    Attributes
    ----------
    core_title : str
        Name of the core, for people.

    Raises
    ------
    ConfigError
        If the image is not for this processor or does not fit the memories, or the profile is for other memories.
    """

    def __init__(
        self,
        elf: str | Path | bytes | FirmwareImage,
        *,
        profile: str | TimingProfile = DEFAULT_PROFILE,
        memory: str | MemoryMap | None = None,
        stack: Literal["image", "ram"] = "ram",
        part: Callable[[Processor], BarePart | MachineChip] = BarePart,
        core: str = "cortex-m4",
    ) -> None:
        self.image = open_image(elf, core=core)
        self.core_title = CORES[core].title
        priced = load_profile(profile) if isinstance(profile, str) else profile
        self.memory = memory if isinstance(memory, MemoryMap) else memory_map(self.image, memory)
        if priced.memory and priced.waiting is None and self.memory != MK64FN1M0:
            raise ConfigError(f"{priced.name} prices the K64F's memories, not {self.memory}; use {DEFAULT_PROFILE}")
        self.processor = Processor(self.image, priced, memories=self.memory, baseline=core == "cortex-m0")
        self._stack = stack
        self._part = part(self.processor)
        self._booted = False
        load_segments(self.processor.memory, self.image)

    @property
    def bus(self) -> PeripheralBus:
        return self._part.bus

    @property
    def cycle_counter(self) -> CycleCounter:
        """DWT, with the firmware's readings of the counter."""
        return self._part.cycle_counter

    @property
    def may_rest(self) -> bool:
        """Return whether a branch to itself, without an earlier fault, counts as rest; otherwise it is a hang."""
        return self.processor.waiting.may_rest

    @may_rest.setter
    def may_rest(self, may: bool) -> None:
        self.processor.waiting.may_rest = may

    @property
    def cycles(self) -> int:
        """Clock cycles since power-on."""
        return self.processor.cycles

    @property
    def instructions(self) -> int:
        """Instructions executed since power-on."""
        return self.processor.instructions

    def memory_use(self) -> dict[str, int]:
        """Return the bytes of memory that the firmware uses, see `hiltest.virtual.board.memory_use`."""
        return memory_use(self.image, self.memory, known_stacks(self.processor.machine))

    def stack_bounds(self, functions: Iterable[str]) -> dict[str, int | str]:
        """Return the largest stack use of functions [bytes] by name, or the reason why it is unknown.

        The empty name stands for the whole firmware, with the exceptions that were taken or are enabled.
        """
        bounds, sizes = StackBounds(self.image), dict[str, int | str]()
        nvic, table = self.processor.nvic, self.processor.core.vector_table
        with contextlib.suppress(ConfigError):  # an image without a vector table did not start the firmware
            _, entry = vectors(self.processor.memory, self.image)
            read = self.processor.memory.read_words
            groups = nvic.priority_groups()
            handlers = [[read(table + 4 * exception, 1)[0] for exception in group] for group in groups]
            sizes[""] = self._bound(lambda: bound_with_exceptions(bounds, entry, handlers))
        for name in functions:
            address = find_function(self.image, name).address
            sizes[name] = self._bound(partial(bounds.bound, address))
        return sizes

    @staticmethod
    def _bound(bound: Callable[[], int]) -> int | str:
        try:
            return bound()
        except NoBound as error:
            return str(error)

    @property
    def faults(self) -> Sequence[FaultRecord]:
        """The first thousand faults since power-on that the firmware's handlers received."""
        return tuple(self.processor.fault_log.records)

    def position(self) -> str:
        """Describe the state of the firmware: asleep or executing, function and line, and the fault being handled."""
        fault = self.processor.fault_log.first_cause
        if fault is None:
            return self._activity()
        return f"{self._activity()}, after: {fault.cause} at {place_of(fault.pc, fault.function, fault.location)}"

    def _activity(self) -> str:
        pc = self.processor.registers.pc.get()
        function = self.image.function_at(pc)
        place = f"{function.name if function else hex(pc)} ({self.image.location_at(pc) or 'no line known'})"
        if self.processor.sleeping:
            return f"asleep{self._part.describe_sleep()} in {place}"
        if self._loops_at(pc & ~1):
            rests = self.may_rest and self.processor.waiting.is_in_thread
            return f"{'at rest' if rests else 'hung'}, in a branch to itself in {place}"
        resets = self._part.watchdog_resets
        by_watchdog = f", reset {resets} times by its watchdog" if resets else ""
        return f"executing {place}{self.processor.waits_for()}{by_watchdog}"

    def _loops_at(self, address: int) -> bool:
        """Return whether the instruction at an address is a branch to itself."""
        decoded = decode_first(address, self.processor.memory.code_at(address))
        return bool(decoded) and decoded.flow == lib.FLOW_JUMP and decoded.target == address and not decoded.conditional

    def watch_calls(self, functions: Iterable[str]) -> CallWatch:
        """Count the calls that running firmware makes to functions from now on."""
        return CallWatch(self.processor, functions)

    def watch_solutions(self, functions: Iterable[str], end: SolutionEnd) -> SolutionWatch:
        """Sum up the calls of functions that work in slices, per solution, from now on."""
        return SolutionWatch(self.processor, functions, end)

    # -- unmodelled registers -----------------------------------------------------------------

    @property
    def unmodelled(self) -> Sequence[UnmodelledAccess]:
        """First access to each unmodelled register; the `str` of an access is a sentence."""
        return self._part.unmodelled.accesses

    def report_waits(self, listener: Callable[[str], None]) -> None:
        """Call `listener` with one line when firmware waits for an unmodelled register, instead of warning."""
        self._part.unmodelled.on_wait = listener

    @contextlib.contextmanager
    def pause_unmodelled(self) -> Iterator[None]:
        """Record no accesses in `unmodelled` during the context, because they are not the firmware's."""
        self._part.unmodelled.pause(True)
        try:
            yield
        finally:
            self._part.unmodelled.pause(False)

    # -- calling functions --------------------------------------------------------------------

    def _call_hz(self, requested_hz: float | None) -> float:
        """Return the core clock that converts a call's cycles into seconds [Hz]."""
        return CALL_HZ if requested_hz is None else check_clock(requested_hz)

    def call(
        self,
        symbol: str,
        *arguments: Argument,
        timeout_s: float = HANG_S,
        clock_hz: float | None = None,
        keeps_ram: bool = False,
    ) -> CallResult:
        """Call one function of the image and count its cycles.

        The firmware need not be booted; if it runs, the processor's state is restored
        afterwards. Interrupts are masked during the call.

        Parameters
        ----------
        symbol
            Name of the function.
        *arguments
            Converted by the types in the DWARF; without DWARF only integers. A buffer
            is copied to free RAM and passed by address; a writable buffer then receives
            the content after the call.
        timeout_s
            Virtual time after which the function counts as hung [s].
        clock_hz
            Core clock without boot [Hz], by default 120 MHz; on a running board the clock that its firmware set up.
        keeps_ram
            True to leave the variables as an earlier call left them; otherwise each call without boot begins with the
            initial data of the image.

        Returns
        -------
        CallResult
            ``.value``, ``.cycles``, ``.instructions`` and ``.microseconds``.

        Raises
        ------
        ConfigError
            If the function or the clock does not exist, or the arguments do not fit.
        BoardFault
            If the function faults or hangs.
        """
        clock_hz = self._call_hz(clock_hz)
        if not (self._booted or keeps_ram):
            load_running(self.processor.memory, self.image)
        try:
            with self.processor.calls.paused():
                return call_function(
                    self.processor,
                    symbol,
                    arguments,
                    booted=self._booted,
                    stack=initial_stack(self.processor.memory, self.image) if self._stack == "image" else None,
                    clock_hz=clock_hz,
                    timeout_s=timeout_s,
                )
        except ResetRequested as request:
            cause = "requested" if request.source is ResetSource.SOFTWARE else "was ended by the watchdog with"
            raise BoardFault(f"{symbol} {cause} a system reset", pc=self.image.symbols[symbol].address) from None


def open_image(elf: str | Path | bytes | FirmwareImage, *, core: str = "cortex-m4") -> FirmwareImage:
    """Return the image in a file or in its content, checked for a core; an image is returned unchanged."""
    source = Path(elf) if isinstance(elf, str) else elf
    return source if isinstance(source, FirmwareImage) else load_image(source, core=core)
