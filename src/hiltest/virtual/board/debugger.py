"""Run control for a debugger: halts, breakpoints, watchpoints, single steps, and exclusion of the board's thread.

Without a debugger the board runs at full speed: `Debugger.run` replaces `Processor.run`, and the core checks
breakpoints and watchpoints only if any are set. A halt stops virtual time, because the thread that runs the board waits
in `run`, and it changes no count.
"""

from __future__ import annotations

import threading
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from enum import Enum

from hiltest.errors import BoardFault, ConfigError
from hiltest.virtual.board.virtual_machine import VirtualMachine
from hiltest.virtual.core.library import lib
from hiltest.virtual.core.machine import NEVER
from hiltest.virtual.processor.schedule import Event

_REPEAT_S = 0.02  # a halt request can be lost while the core is being entered, so it is repeated
_BKPT = 0xBE  # high byte of the instruction


class WatchKind(Enum):
    """Kind of access that a watchpoint detects."""

    WRITE = lib.WATCH_WRITE
    READ = lib.WATCH_READ
    ACCESS = lib.WATCH_ACCESS


class StopReason(Enum):
    """Reason for a halt of the processor."""

    REQUESTED = 0
    STEPPED = 1
    BREAKPOINT = 2
    WATCHPOINT = 3
    FAULT = 4


@dataclass(frozen=True, slots=True)
class Stop:
    """A halt of the processor."""

    reason: StopReason
    watch: WatchKind | None = None
    """Kind of the watchpoint that was hit."""
    address: int = 0
    """Address of the access that hit the watchpoint."""
    fault: BoardFault | None = None
    """Fault that `run` raises when the processor continues."""


class _Stopped(Exception):
    """The core has stopped between two instructions."""

    def __init__(self, stop: Stop) -> None:
        super().__init__(stop.reason.name)
        self.stop = stop


class Debugger:
    """Control of a board's processor: halts, breakpoints, watchpoints and steps.

    The thread that runs the board calls `run`; all other methods are for another thread, which may access the processor
    only within `halted`.

    Parameters
    ----------
    machine
        Board that is not running.
    on_stop
        Called in the thread that runs the board when the processor has halted.

    Attributes
    ----------
    latest : Stop
        The last halt.
    """

    def __init__(self, machine: VirtualMachine, *, on_stop: Callable[[], None]) -> None:
        self.latest = Stop(StopReason.REQUESTED)
        self._machine, self._processor = machine, machine.processor
        self._on_stop = on_stop
        # Guards the members below, and the processor while it is not running.
        self._changed = threading.Condition(machine.access)
        self._halt = False  # a halt is requested
        self._in_core = False  # the board's thread is in the core
        self._step_range = range(0)  # a step continues while the PC stays in this range
        self._active: int | None = None  # number of active exceptions before a step, until the step begins
        self._breakpoints: set[int] = set()
        self._watchpoints: list[tuple[WatchKind, int, int]] = []
        machine.run_processor = self.run
        self._processor.at_stop = self._halt_at_stop
        self._processor.at_breakpoint = self._halt_at_breakpoint

    # -- the thread that runs the board -------------------------------------------------------

    def run(self, until: Event, *, wake: Callable[[], bool] | None = None, for_bytes: bool = False) -> bool:
        """Run the processor as `Processor.run` does, and wait while it is halted."""

        def must_return() -> bool:
            return self._halt or (wake is not None and wake())

        while True:
            self._enter()
            stop: Stop | None = None
            try:
                returned = self._processor.run(until, wake=must_return, for_bytes=for_bytes or wake is None)
            except _Stopped as stopped:
                stop = stopped.stop
            except BoardFault as fault:
                if not self._is_attended:
                    raise
                stop = Stop(StopReason.FAULT, fault=fault)
            finally:
                halt_requested = self._leave(stop)
            if stop is None and not halt_requested:
                return returned
            self._on_stop()

    @property
    def _is_attended(self) -> bool:
        """Return whether a debugger is connected; a fault then halts the processor before it ends the run."""
        return self._machine.debugged

    def _enter(self) -> None:
        with self._changed:
            began_s = time.monotonic()
            while self._halt:
                self._changed.wait(_REPEAT_S)
            self._machine.halted_s += time.monotonic() - began_s
            fault, self.latest = self.latest.fault, Stop(StopReason.REQUESTED)
            if fault is not None:
                raise fault
            self._in_core = True

    def _leave(self, stop: Stop | None) -> bool:
        """Record that the thread has left the core; return whether a halt is requested."""
        with self._changed:
            halt_requested = self._halt
            self._in_core = False
            if stop is not None:
                self._halt = True
                self.latest = stop
            self._changed.notify_all()
            return halt_requested

    # -- called by the processor --------------------------------------------------------------

    def _halt_at_stop(self, reason: int) -> None:
        core = self._processor.core
        if reason == lib.STOP_WATCHPOINT:
            watch, core.watch_kinds = WatchKind(core.watch_kinds), 0
            raise _Stopped(Stop(StopReason.WATCHPOINT, watch, core.watch_address))
        if reason == lib.STOP_STEP and self._continues_step():
            core.instruction_limit = core.instructions + 1
            return
        core.instruction_limit = NEVER
        raise _Stopped(Stop(StopReason.BREAKPOINT if core.r[15] in self._breakpoints else StopReason.STEPPED))

    def _continues_step(self) -> bool:
        """Return whether a step continues: no instruction has run yet, or the next one is within the range."""
        core, before = self._processor.core, self._active
        self._active = None
        if before is not None:
            return bool(core.active_count == before)  # otherwise an exception handler begins, which is a step too
        if lib.machine_skips(self._processor.machine.handle):
            return True
        return core.r[15] in self._step_range and core.r[15] not in self._breakpoints

    def _halt_at_breakpoint(self, _address: int) -> None:
        """Halt at a BKPT instruction if a debugger is connected."""
        if self._is_attended:
            raise _Stopped(Stop(StopReason.BREAKPOINT))

    # -- from the other thread ----------------------------------------------------------------

    @property
    def is_halted(self) -> bool:
        """Return whether the processor is halted."""
        with self._changed:
            return self._halt

    @contextmanager
    def halted(self) -> Iterator[None]:
        """Keep the processor halted, and the board's thread out of the core, during the context."""
        with self._changed:
            self._halt = True
            while self._in_core:
                self._processor.return_soon()
                self._changed.wait(_REPEAT_S)
            yield

    def resume(self, *, step: bool = False, within: range = range(0)) -> None:
        """Continue a halted processor; a step ends after one instruction, or on leaving the addresses `within`."""
        with self.halted():
            core = self._processor.core
            if not step and self._is_bkpt(core.r[15]):
                core.r[15] += 2
            core.passes_breakpoint, core.watch_kinds = True, 0
            # In a step the core first takes pending exceptions, so no instruction is due before that.
            core.instruction_limit = core.instructions if step else NEVER
            self._active, self._step_range = core.active_count, within
            self._halt = False
            self._changed.notify_all()

    def _is_bkpt(self, pc: int) -> bool:
        """Return whether the instruction is BKPT, which would halt the processor at once."""
        try:
            return self._processor.memory.read(pc + 1, 1)[0] == _BKPT
        except ValueError:
            return False

    def set_breakpoint(self, address: int) -> None:
        """Halt before the instruction at an address.

        Raises
        ------
        ConfigError
            If there are too many breakpoints.
        """
        with self.halted():
            if not lib.machine_set_breakpoint(self._processor.machine.handle, address, True):
                raise ConfigError("too many breakpoints")
            self._breakpoints.add(address)

    def clear_breakpoint(self, address: int) -> None:
        """Remove a breakpoint if it exists."""
        with self.halted():
            if address in self._breakpoints:
                lib.machine_set_breakpoint(self._processor.machine.handle, address, False)
                self._breakpoints.remove(address)

    def set_watchpoint(self, watch: WatchKind, address: int, size: int) -> None:
        """Halt after an instruction that accesses any of `size` bytes.

        Raises
        ------
        ConfigError
            If there are too many watchpoints.
        """
        with self.halted():
            if (watch, address, size) not in self._watchpoints:
                if not lib.machine_add_watchpoint(self._processor.machine.handle, address, size, watch.value):
                    raise ConfigError("too many watchpoints")
                self._watchpoints.append((watch, address, size))

    def clear_watchpoint(self, watch: WatchKind, address: int, size: int) -> None:
        """Remove a watchpoint if it exists."""
        with self.halted():
            if (watch, address, size) in self._watchpoints:
                self._watchpoints.remove((watch, address, size))
                lib.machine_clear_watchpoints(self._processor.machine.handle)
                for kind, begin, length in self._watchpoints:
                    lib.machine_add_watchpoint(self._processor.machine.handle, begin, length, kind.value)

    def clear(self) -> None:
        """Remove all breakpoints and watchpoints."""
        for address in list(self._breakpoints):
            self.clear_breakpoint(address)
        for watched in list(self._watchpoints):
            self.clear_watchpoint(*watched)
