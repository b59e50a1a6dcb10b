"""Halting the processor for a debugger: breakpoints, watchpoints, steps, and who may touch it meanwhile.

Nothing of this is in the way of a board that is not being debugged: `Debugger.run` stands in for `Processor.run`, and
the core looks for breakpoints and watchpoints only where there are any. Virtual time stands still in a halt, because
the thread that runs the board waits in `run`. A halt changes no count.
"""

from __future__ import annotations

import threading
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from enum import Enum

from hiltest.errors import BoardFault, ConfigError
from hiltest.virtual.board.k64f import VirtualK64F
from hiltest.virtual.core.library import lib
from hiltest.virtual.core.machine import NEVER
from hiltest.virtual.processor.schedule import Event

_LOOK_AGAIN_S = 0.02  # a request to halt that came while the core was being entered is made again
_BKPT = 0xBE  # high byte of the instruction


class WatchKind(Enum):
    """What a watchpoint looks for."""

    WRITE = lib.WATCH_WRITE
    READ = lib.WATCH_READ
    ACCESS = lib.WATCH_ACCESS


class StopReason(Enum):
    """Why the processor was halted."""

    ASKED = 0
    STEPPED = 1
    BREAKPOINT = 2
    WATCHPOINT = 3
    FAULT = 4


@dataclass(frozen=True, slots=True)
class Stop:
    """A halt."""

    reason: StopReason
    watch: WatchKind | None = None
    """Kind of the watchpoint that was hit."""
    address: int = 0
    """Data that it was hit by."""
    fault: BoardFault | None = None
    """What ends the firmware as soon as the processor goes on."""


class _Stopped(Exception):
    """The core has stopped between two instructions."""

    def __init__(self, stop: Stop) -> None:
        super().__init__(stop.reason.name)
        self.stop = stop


class Debugger:
    """Halts the processor of a board and lets it go on.

    The thread that runs the board comes by in `run`; everything else is called from another one, and touches the
    processor within `halted` only.

    Parameters
    ----------
    machine
        Must not be running.
    on_stop
        Called, in the thread that runs the board, when the processor has halted by itself.

    Attributes
    ----------
    latest : Stop
        Why it halted last.
    """

    def __init__(self, machine: VirtualK64F, *, on_stop: Callable[[], None]) -> None:
        self.latest = Stop(StopReason.ASKED)
        self._machine, self._processor = machine, machine.processor
        self._on_stop = on_stop
        self._turn = threading.Condition()  # guards what follows, and the processor while nobody is inside
        self._halt = False  # whether it is to stand still
        self._inside = False  # whether the processor is entered
        self._within = range(0)  # a step goes on while it stays in there
        self._active: int | None = None  # exceptions that were active before a step, until it begins
        self._breakpoints: set[int] = set()
        self._watchpoints: list[tuple[WatchKind, int, int]] = []
        machine.run_processor = self.run
        self._processor.at_stop = self._at_stop
        self._processor.at_breakpoint = self._at_instruction

    # -- the thread that runs the board -------------------------------------------------------

    def run(self, until: Event, *, wake: Callable[[], bool] | None = None, for_bytes: bool = False) -> bool:
        """Run the processor as `Processor.run` does, and wait whenever it is halted."""

        def look() -> bool:
            return self._halt or (wake is not None and wake())

        while True:
            self._enter()
            stop: Stop | None = None
            try:
                returned = self._processor.run(until, wake=look, for_bytes=for_bytes or wake is None)
            except _Stopped as stopped:
                stop = stopped.stop
            except BoardFault as fault:
                if not self._attended:
                    raise
                stop = Stop(StopReason.FAULT, fault=fault)
            finally:
                asked = self._leave(stop)
            if stop is None and not asked:
                return returned
            self._on_stop()

    @property
    def _attended(self) -> bool:
        """Whether a debugger is there, to whom a fault is shown before it ends the firmware."""
        return self._machine.debugged

    def _enter(self) -> None:
        with self._turn:
            began_s = time.monotonic()
            while self._halt:
                self._turn.wait(_LOOK_AGAIN_S)
            self._machine.halted_s += time.monotonic() - began_s
            fault, self.latest = self.latest.fault, Stop(StopReason.ASKED)
            if fault is not None:
                raise fault
            self._inside = True

    def _leave(self, stop: Stop | None) -> bool:
        """Note that the processor is left; True when somebody waits for that."""
        with self._turn:
            asked = self._halt
            self._inside = False
            if stop is not None:
                self._halt = True
                self.latest = stop
            self._turn.notify_all()
            return asked

    # -- called by the processor --------------------------------------------------------------

    def _at_stop(self, reason: int) -> None:
        core = self._processor.core
        if reason == lib.STOP_WATCHPOINT:
            watch, core.watch_kinds = WatchKind(core.watch_kinds), 0
            raise _Stopped(Stop(StopReason.WATCHPOINT, watch, core.watch_address))
        if reason == lib.STOP_STEP and self._steps_on():
            core.instruction_limit = core.instructions + 1
            return
        core.instruction_limit = NEVER
        raise _Stopped(Stop(StopReason.BREAKPOINT if core.r[15] in self._breakpoints else StopReason.STEPPED))

    def _steps_on(self) -> bool:
        """Whether a step is not over: nothing has run yet, or an instruction comes that is passed over."""
        core, before = self._processor.core, self._active
        self._active = None
        if before is not None:
            return bool(core.active_count == before)  # else an exception's handler begins, which is a step as well
        if lib.machine_skips(self._processor.machine.handle):
            return True
        return core.r[15] in self._within and core.r[15] not in self._breakpoints

    def _at_instruction(self, _address: int) -> None:
        """Halt at a BKPT instruction, if a debugger is there."""
        if self._attended:
            raise _Stopped(Stop(StopReason.BREAKPOINT))

    # -- from the other thread ----------------------------------------------------------------

    @property
    def is_halted(self) -> bool:
        """Whether the processor stands still until it is let go."""
        with self._turn:
            return self._halt

    @contextmanager
    def halted(self) -> Iterator[None]:
        """Keep the processor halted, and the board's thread out, for the time of the context."""
        with self._turn:
            self._halt = True
            while self._inside:
                self._processor.look_soon()
                self._turn.wait(_LOOK_AGAIN_S)
            yield

    def go_on(self, *, step: bool = False, within: range = range(0)) -> None:
        """Let a processor that is halted go on: for one instruction, or until it leaves the addresses `within`."""
        with self.halted():
            core = self._processor.core
            if not step and self._is_instruction(core.r[15]):
                core.r[15] += 2
            core.passes_breakpoint, core.watch_kinds = True, 0
            # A step has the core take what is pending first: no instruction is due until then.
            core.instruction_limit = core.instructions if step else NEVER
            self._active, self._within = core.active_count, within
            self._halt = False
            self._turn.notify_all()

    def _is_instruction(self, pc: int) -> bool:
        """Whether a BKPT is there, which would halt it again and again."""
        try:
            return self._processor.memory.read(pc + 1, 1)[0] == _BKPT
        except ValueError:
            return False

    def set_breakpoint(self, address: int) -> None:
        """Halt before the instruction at an address.

        Raises
        ------
        ConfigError
            If there are too many.
        """
        with self.halted():
            if not lib.machine_set_breakpoint(self._processor.machine.handle, address, True):
                raise ConfigError("too many breakpoints")
            self._breakpoints.add(address)

    def clear_breakpoint(self, address: int) -> None:
        """Forget a breakpoint, if it is there."""
        with self.halted():
            if address in self._breakpoints:
                lib.machine_set_breakpoint(self._processor.machine.handle, address, False)
                self._breakpoints.remove(address)

    def set_watchpoint(self, watch: WatchKind, address: int, size: int) -> None:
        """Halt behind an instruction that accesses one of `size` bytes.

        Raises
        ------
        ConfigError
            If there are too many.
        """
        with self.halted():
            if (watch, address, size) not in self._watchpoints:
                if not lib.machine_add_watchpoint(self._processor.machine.handle, address, size, watch.value):
                    raise ConfigError("too many watchpoints")
                self._watchpoints.append((watch, address, size))

    def clear_watchpoint(self, watch: WatchKind, address: int, size: int) -> None:
        """Forget a watchpoint, if it is there."""
        with self.halted():
            if (watch, address, size) in self._watchpoints:
                self._watchpoints.remove((watch, address, size))
                lib.machine_clear_watchpoints(self._processor.machine.handle)
                for kind, begin, length in self._watchpoints:
                    lib.machine_add_watchpoint(self._processor.machine.handle, begin, length, kind.value)

    def clear(self) -> None:
        """Forget all breakpoints and watchpoints."""
        for address in list(self._breakpoints):
            self.clear_breakpoint(address)
        for watched in list(self._watchpoints):
            self.clear_watchpoint(*watched)
