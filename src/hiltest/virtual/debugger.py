"""Halting the processor for a debugger: breakpoints, watchpoints, steps, and who may touch it meanwhile.

Nothing of this is in the way of a board that is not being debugged: `Debugger.run` stands in for `Processor.run`, and
the emulator is told of an address only while there is a breakpoint on it. Virtual time stands still in a halt, because
the thread that runs the board waits in `run`.
"""

from __future__ import annotations

import ctypes
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from enum import Enum
from functools import partial

import unicorn

from hiltest.errors import BoardFault
from hiltest.virtual.code_hook import CODE_CALLBACK
from hiltest.virtual.engine import add_hook, remove_hook
from hiltest.virtual.k64f import VirtualK64F
from hiltest.virtual.schedule import Event

_DATA_CALLBACK = ctypes.CFUNCTYPE(
    None, ctypes.c_void_p, ctypes.c_int, ctypes.c_uint64, ctypes.c_int, ctypes.c_int64, ctypes.c_void_p
)
_LOOK_AGAIN_S = 0.02  # a request to halt that came while the emulator was being entered is made again
_BKPT = 0xBE  # high byte of the instruction


class WatchKind(Enum):
    """What a watchpoint looks for."""

    WRITE = unicorn.UC_HOOK_MEM_WRITE
    READ = unicorn.UC_HOOK_MEM_READ
    ACCESS = unicorn.UC_HOOK_MEM_WRITE | unicorn.UC_HOOK_MEM_READ


class StopReason(Enum):
    """Why the processor was halted."""

    ASKED = 0
    STEPPED = 1
    BREAKPOINT = 2
    WATCHPOINT = 3
    FAULT = 4


@dataclass(frozen=True, slots=True)
class Stop:
    """A halt.

    Attributes
    ----------
    watch : WatchKind, optional
        Kind of the watchpoint that was hit.
    address : int
        Data that it was hit by.
    fault : BoardFault, optional
        What ends the firmware as soon as the processor goes on.
    """

    reason: StopReason
    watch: WatchKind | None = None
    address: int = 0
    fault: BoardFault | None = None


class _Stopped(Exception):
    """The emulator was stopped before an instruction, at a time [cycles] and behind so many instructions."""

    def __init__(self, stop: Stop, cycles: int, instructions: int) -> None:
        super().__init__(stop.reason.name)
        self.stop, self.cycles, self.instructions = stop, cycles, instructions


class Debugger:
    """Halts the processor of a board and lets it go on.

    The thread that runs the board comes by in `run`; everything else is called from another one, and touches the
    processor within `halted` only.

    Parameters
    ----------
    machine : VirtualK64F
        Must not be running.
    on_stop : callable
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
        self._inside = False  # whether the emulator is entered
        self._passing: int | None = None  # a breakpoint here is not hit by going on from it
        self._within = range(0)  # a step goes on while it stays in there
        self._steps = False
        self._hit: Stop | None = None  # by the instruction that runs
        self._breakpoints: dict[int, tuple[int, object]] = {}  # hook of the emulator, and its callback
        self._watchpoints: dict[tuple[WatchKind, int, int], tuple[int, object]] = {}
        self._looks: tuple[int, object] | None = None  # the hook of every instruction
        machine.run_processor = self.run
        self._processor.traps.at_breakpoint = self._at_instruction

    # -- the thread that runs the board -------------------------------------------------------

    def run(self, until: Event, *, wake: Callable[[], bool] | None = None) -> bool:
        """Run the processor as `Processor.run` does, and wait whenever it is halted."""

        def look() -> bool:
            return self._halt or (wake is not None and wake())

        while True:
            self._enter()
            stop: Stop | None = None
            try:
                returned = self._processor.run(until, wake=look)
            except _Stopped as stopped:
                stop = self._mend(stopped)
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
        """Note that the emulator is left; True when somebody waits for that."""
        with self._turn:
            asked = self._halt
            self._inside = False
            if stop is not None:
                self._halt = True
                self.latest = stop
            self._turn.notify_all()
            return asked

    def _mend(self, stopped: _Stopped) -> Stop:
        """Count what ran before the instruction, and not the rest of its block."""
        accounting = self._processor.accounting
        accounting.cycles, accounting.instructions = stopped.cycles, stopped.instructions
        accounting.flush_pipeline()
        return stopped.stop

    # -- called by the emulator ---------------------------------------------------------------

    def _stop_before(self, address: int, stop: Stop) -> None:
        accounting = self._processor.accounting
        self._processor.abort(_Stopped(stop, accounting.now(address), accounting.instructions_now(address)))

    def _on_breakpoint(self, _engine: int, address: int, _size: int, _data: int) -> None:
        try:
            if self._looks is None:  # else that hook looks for it
                passed, self._passing = self._passing == address, None
                if not passed:
                    self._stop_before(address, Stop(StopReason.BREAKPOINT))
        except BaseException as error:  # re-raised by the processor; ctypes would print and drop it
            self._processor.abort(error)

    def _on_instruction(self, _engine: int, address: int, _size: int, _data: int) -> None:
        try:
            hit, passed = self._hit, self._passing == address
            self._hit = self._passing = None
            if hit is not None:
                self._stop_before(address, hit)
            elif passed:
                pass
            elif address in self._breakpoints:
                self._stop_before(address, Stop(StopReason.BREAKPOINT))
            elif self._steps and address not in self._within:
                self._stop_before(address, Stop(StopReason.STEPPED))
        except BaseException as error:  # as above
            self._processor.abort(error)

    def _on_data(
        self, watch: WatchKind, _engine: int, _access: int, address: int, _size: int, _value: int, _data: int
    ) -> None:
        self._hit = Stop(StopReason.WATCHPOINT, watch, address)
        self._processor.registers.forget_condition()

    def _at_instruction(self, address: int) -> bool:
        """Halt at a BKPT instruction, if a debugger is there."""
        if self._attended:
            self._stop_before(address & ~1, Stop(StopReason.BREAKPOINT))
        return self._attended

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
            pc = self._processor.registers.pc.get() & ~1
            if not step and self._is_instruction(pc):
                pc += 2
                self._processor.registers.pc.set(pc | 1)
            self._passing, self._steps, self._within, self._hit = pc, step, within, None
            self._look_at_all()
            self._halt = False
            self._turn.notify_all()

    def _is_instruction(self, pc: int) -> bool:
        """Whether a BKPT is there, which would halt it again and again."""
        try:
            return self._processor.memory.read(pc + 1, 1)[0] == _BKPT
        except ValueError:
            return False

    def set_breakpoint(self, address: int) -> None:
        """Halt before the instruction at an address."""
        with self.halted():
            if address not in self._breakpoints:
                callback = CODE_CALLBACK(self._on_breakpoint)
                hook = add_hook(self._processor.engine, unicorn.UC_HOOK_CODE, callback, within=(address, address))
                self._breakpoints[address] = hook, callback
                self._forget(address)

    def clear_breakpoint(self, address: int) -> None:
        """Forget a breakpoint, if it is there."""
        with self.halted():
            hook, _callback = self._breakpoints.pop(address, (None, None))
            if hook is not None:
                remove_hook(self._processor.engine, hook)
                self._forget(address)

    def set_watchpoint(self, watch: WatchKind, address: int, size: int) -> None:
        """Halt behind an instruction that accesses one of `size` bytes."""
        with self.halted():
            if (watch, address, size) not in self._watchpoints:
                callback = _DATA_CALLBACK(partial(self._on_data, watch))
                within = address, address + size - 1
                hook = add_hook(self._processor.engine, watch.value, callback, within=within)
                self._watchpoints[watch, address, size] = hook, callback
                self._processor.engine.ctl_flush_tb()

    def clear_watchpoint(self, watch: WatchKind, address: int, size: int) -> None:
        """Forget a watchpoint, if it is there."""
        with self.halted():
            hook, _callback = self._watchpoints.pop((watch, address, size), (None, None))
            if hook is not None:
                remove_hook(self._processor.engine, hook)
                self._processor.engine.ctl_flush_tb()

    def clear(self) -> None:
        """Forget all breakpoints and watchpoints."""
        for address in list(self._breakpoints):
            self.clear_breakpoint(address)
        for watched in list(self._watchpoints):
            self.clear_watchpoint(*watched)

    def _forget(self, address: int) -> None:
        """Have code translated anew, which goes on as it was otherwise."""
        self._processor.engine.ctl_remove_cache(address, address + 2)

    def _look_at_all(self) -> None:
        """Have every instruction looked at while steps or watchpoints need it, and else none."""
        wanted = self._steps or bool(self._watchpoints)
        if wanted == (self._looks is not None):
            return
        if self._looks is None:
            callback = CODE_CALLBACK(self._on_instruction)
            self._looks = add_hook(self._processor.engine, unicorn.UC_HOOK_CODE, callback), callback
        else:
            remove_hook(self._processor.engine, self._looks[0])
            self._looks = None
        self._processor.engine.ctl_flush_tb()
