"""Every call of some functions that firmware makes while it runs, as the board sees it.

A function is watched at its first instruction and where its calls return to; nothing of the firmware is changed, and
no cycle count is. A call counts from the function's first instruction to its return, both included, which is what
`VirtualK64F.call` counts of it.

What an exception takes is counted apart: from its entry to its return, those included, with what is nested in it. A
pipeline that it emptied is its doing too: where the code behind it would have overlapped with the code before it, the
difference belongs to the exception. Each exception that is active, and each task of a kernel, has its calls for
itself: a thread that was interrupted goes on when registers are taken from where its own were put.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field, replace
from functools import partial

import unicorn

from hiltest.virtual.accounting import CODE_CALLBACK
from hiltest.virtual.blocks import CodeBlock
from hiltest.virtual.call_summary import Call
from hiltest.virtual.cpu import Processor
from hiltest.virtual.engine import add_hook
from hiltest.virtual.instructions import Instruction, decode
from hiltest.virtual.timing import NEUTRAL, PipelineState

_STACK_AND_LINK = (13, 14)
_LINK_REGISTER = 1 << 14
_EXC_RETURN = 0xFFFFFFE0  # a return address from here on ends an exception


@dataclass(slots=True)
class WatchedFunction:
    """A function, and its calls.

    Attributes
    ----------
    address : int
        First instruction.
    calls : list of Call
        Those that have returned, in that order.
    abandoned : int
        How many never returned: their stack was given up (longjmp, a task or exception that ended, a reset).
    open : int
        How many are under way.
    came_back : int
        How many returned though their stack had been given up: something switches stacks without an exception, and
        whose cycles are whose cannot be told.
    looks : callable
        Asked at each return for `Call.left`.
    """

    address: int
    calls: list[Call] = field(default_factory=list)
    abandoned: int = 0
    open: int = 0
    came_back: int = 0
    looks: Callable[[], int] = int


@dataclass(slots=True)
class _Apart:
    """What a thread was interrupted by so far."""

    interrupted: int = 0
    interrupts: int = 0
    elsewhere: int = 0


@dataclass(slots=True)
class _Open:
    """A call under way, with what its thread had been interrupted by when it began."""

    function: WatchedFunction
    entered: int
    stack: int
    return_address: int
    outermost: bool
    apart: _Apart


@dataclass(slots=True)
class _Thread:
    """A thread of execution: an exception that is active, a task, or what runs without either.

    Attributes
    ----------
    open : list of _Open
        Innermost last.
    apart : _Apart
    given_up : dict
        Calls whose stack was given up, by return address and stack pointer.
    left_at : int
        Cycle at which an exception was entered.
    before : CodeBlock or None
        What had run last then.
    state : PipelineState
        What that had left.
    resumed_behind : int
        Instructions executed when it went on.
    """

    open: list[_Open] = field(default_factory=list)
    apart: _Apart = field(default_factory=_Apart)
    given_up: dict[tuple[int, int], WatchedFunction] = field(default_factory=dict)
    left_at: int = 0
    before: CodeBlock | None = None
    state: PipelineState = NEUTRAL
    resumed_behind: int = -1


class RunningCalls:
    """Sees the calls of functions while firmware runs.

    Parameters
    ----------
    processor : Processor
        The emulator must not be running.

    Notes
    -----
    A function that is inlined is never entered. One that calls itself has a call for each level.

    A call that ends in a tail call returns where that does, and contains it. One is abandoned when the stack pointer
    is above its own (longjmp), when it is called anew with the same one, or when its thread ends.
    """

    def __init__(self, processor: Processor) -> None:
        self._processor = processor
        self._accounting = processor.accounting
        self._stack_and_link = processor.registers.cores(_STACK_AND_LINK)
        self._functions: dict[int, WatchedFunction] = {}
        self._hooked: set[int] = set()
        self._callback = CODE_CALLBACK(self._on_code)  # the emulator keeps only the pointer
        self._is_paused = False
        self._paused_cycles = 0
        self._thread = _Thread()
        self._interrupted: list[_Thread] = []  # by exceptions that are active, the innermost last
        self._suspended: dict[tuple[bool, int], _Thread] = {}

    @classmethod
    def of(cls, processor: Processor) -> RunningCalls:
        """Return what sees the calls of a processor; there is one."""
        if not isinstance(processor.exceptions.follower, cls):
            processor.exceptions.follower = cls(processor)
        return processor.exceptions.follower

    def watch(self, address: int) -> WatchedFunction:
        """Watch the function at an address from now on; one that is watched already stays the same."""
        if address not in self._functions:
            self._functions[address] = WatchedFunction(address)
            self._hook(address)
        return self._functions[address]

    def reset(self) -> None:
        """Abandon all calls under way."""
        for thread in (self._thread, *self._interrupted, *self._suspended.values()):
            self._abandon(thread, 0)
        self._thread = _Thread()
        self._interrupted.clear()
        self._suspended.clear()

    @contextmanager
    def paused(self) -> Iterator[None]:
        """See nothing of what runs in the context, and count no cycle of it."""
        if self._is_paused:
            yield
            return
        began, thread = self._processor.cycles, self._thread
        self._leave(thread)
        self._is_paused = True
        try:
            yield
        finally:
            self._is_paused = False
            thread.resumed_behind = self._accounting.instructions
            lost = self._lost(self._processor.registers.pc.get() & ~1, thread.state)
            self._paused_cycles += self._processor.cycles - began + lost

    def now(self) -> int:
        """Cycles since power-on without those that were paused, while nothing runs."""
        return self._processor.cycles - self._paused_cycles

    # -- called by the emulator ---------------------------------------------------------------

    def _hook(self, address: int) -> None:
        if address not in self._hooked:
            self._hooked.add(address)
            add_hook(self._processor.engine, unicorn.UC_HOOK_CODE, self._callback, within=(address, address))
            # What has been translated without the hook would go on without it.
            self._processor.engine.ctl_remove_cache(address, address + 2)

    def _on_code(self, _engine: int, address: int, _size: int, _data: int) -> None:
        if self._is_paused:
            return
        try:
            self._accounting.end_watch()  # each call is seen
            stack, link = self._stack_and_link.read()
            now = self._accounting.now(address)
            begins_block = now == self._accounting.cycles
            before = self._before() if begins_block else None
            last = None if before is None else before.instructions[-1]
            now -= self._paused_cycles
            self._arrives(address, stack, now, last)
            function = self._functions.get(address)
            if function is not None:
                self._enters(function, stack, link & ~1, now, last)
        except BaseException as error:  # re-raised by the processor; ctypes would print and drop it
            self._processor.abort(error)

    def _before(self) -> CodeBlock | None:
        """Return what ran last in this thread."""
        thread, accounting = self._thread, self._accounting
        return thread.before if accounting.instructions == thread.resumed_behind else accounting.before

    def _enters(
        self, function: WatchedFunction, stack: int, return_address: int, now: int, last: Instruction | None
    ) -> None:
        thread = self._thread
        is_called = last is not None and _calls(last)
        for index, each in enumerate(thread.open):
            if each.stack != stack:
                continue
            if each.function is function and (each.entered == now or not is_called):
                return  # the emulator was stopped there and comes to it again, or it jumps to its own beginning
            if is_called and (each.function is function or each.return_address == return_address):
                self._abandon(thread, index)
                break
        outermost = all(each.function is not function for each in thread.open)
        thread.given_up.pop((return_address, stack), None)
        thread.open.append(_Open(function, now, stack, return_address, outermost, replace(thread.apart)))
        function.open += 1
        if return_address not in self._hooked and return_address < _EXC_RETURN:
            self._processor.between_blocks(partial(self._hook, return_address))

    def _arrives(self, address: int, stack: int, now: int, last: Instruction | None) -> None:
        """Take note of an instruction that calls return to, or that begins a function."""
        thread = self._thread
        calls = thread.open
        while calls and calls[-1].stack < stack:
            thread.given_up[calls[-1].return_address, calls[-1].stack] = calls[-1].function
            self._abandon(thread, len(calls) - 1)
        has_returned = last is not None and _may_return(last)
        first = next((at for at, each in enumerate(calls) if (each.return_address, each.stack) == (address, stack)), -1)
        if first < 0 and has_returned and (address, stack) in thread.given_up:
            thread.given_up.pop((address, stack)).came_back += 1
        elif first >= 0:
            for each in calls[first:]:  # otherwise, where the call would have returned to was jumped to
                if has_returned and last is not None and each.return_address == address:
                    self._close(each, now, last.address)
                else:
                    each.function.abandoned += 1
                each.function.open -= 1
            del calls[first:]

    def _close(self, call: _Open, now: int, place: int) -> None:
        before, apart = call.apart, self._thread.apart
        call.function.calls.append(Call(
            call.entered, now, apart.interrupted - before.interrupted, apart.interrupts - before.interrupts,
            apart.elsewhere - before.elsewhere, call.outermost, place, call.function.looks(),
        ))  # fmt: skip

    def _abandon(self, thread: _Thread, first: int) -> None:
        """Close calls from an index on that will not return."""
        for each in thread.open[first:]:
            each.function.open -= 1
            each.function.abandoned += 1
        del thread.open[first:]

    # -- called by the processor between blocks -----------------------------------------------

    def entered(self, frame: tuple[bool, int], *, from_thread: bool) -> None:
        """Take note of an exception."""
        if self._is_paused:
            return
        thread = self._thread
        self._leave(thread)
        if from_thread:
            self._interrupted.clear()
            if frame in self._suspended:
                self._abandon(self._suspended[frame], 0)
            self._suspended[frame] = thread
        self._interrupted.append(thread)
        self._thread = _Thread()

    def left(self, frame: tuple[bool, int], *, to_thread: bool) -> None:
        """Take note of a return from an exception."""
        if self._is_paused:
            return
        self._end_handler()
        interrupted = self._interrupted.pop() if self._interrupted else _Thread()
        thread = interrupted
        if to_thread:  # one that is not known begins
            thread = self._suspended.pop(frame) if frame in self._suspended else _Thread(left_at=self.now())
        gone = self.now() + self._processor.profile.exception_return - thread.left_at
        gone += self._lost(self._processor.registers.pc.get() & ~1, thread.state)
        if thread is interrupted:
            thread.apart.interrupted += 1
            thread.apart.interrupts += gone
        else:
            thread.apart.elsewhere += gone
        thread.resumed_behind = self._accounting.instructions
        self._thread = thread

    def _leave(self, thread: _Thread) -> None:
        """Keep what a thread needs to go on."""
        has_run = self._accounting.instructions != thread.resumed_behind
        thread.before, thread.left_at = self._before(), self.now()
        # A thread that is left again before it ran has lost nothing more.
        fell = thread.before is not None and has_run and not thread.before.transfers
        thread.state = thread.before.exit_state if thread.before is not None and fell else NEUTRAL

    def _end_handler(self) -> None:
        """Close the calls of an exception: of its handler, and of what that tail-called."""
        calls, before = self._thread.open, self._accounting.before
        while calls and calls[-1].return_address >= _EXC_RETURN:
            call = calls.pop()
            call.function.open -= 1
            self._close(call, self.now(), before.instructions[-1].address if before is not None else 0)
        self._abandon(self._thread, 0)

    def _lost(self, pc: int, state: PipelineState) -> int:
        """Return how much longer the code at `pc` takes because a pipeline was emptied of `state`."""
        lost, emptied, profile = 0, NEUTRAL, self._processor.profile
        while state != emptied:
            instruction = decode(pc, self._processor.memory.read(pc, 4))[0]
            cycles, emptied = profile.step(instruction, emptied)
            overlapping, state = profile.step(instruction, state)
            lost += cycles - overlapping
            pc += instruction.size
        return lost


def _calls(instruction: Instruction) -> bool:
    """Whether it was a call that went from there."""
    return bool(instruction.transfer and instruction.core_writes & _LINK_REGISTER)


def _may_return(instruction: Instruction) -> bool:
    """Whether it may have been a return that went from there."""
    return instruction.transfer == "indirect" and instruction.row != "table_branch" and not _calls(instruction)
