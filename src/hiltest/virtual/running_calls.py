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

from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field
from functools import partial

import unicorn

from hiltest.virtual.blocks import CodeBlock
from hiltest.virtual.call_summary import Call
from hiltest.virtual.code_hook import CODE_CALLBACK
from hiltest.virtual.cpu import Processor
from hiltest.virtual.engine import add_hook
from hiltest.virtual.exceptions import OF_THREAD
from hiltest.virtual.instructions import Instruction, decode
from hiltest.virtual.pipeline import NEUTRAL, PipelineState

_STACK_AND_LINK = (13, 14)
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
    lost : int
        How many there was no room for.
    looks_at : tuple of (int, int), optional
        Address and size of what `Call.left` tells.
    """

    address: int
    calls: list[Call] = field(default_factory=list)
    abandoned: int = 0
    open: int = 0
    came_back: int = 0
    lost: int = 0
    looks_at: tuple[int, int] | None = None


# What a thread was interrupted by so far: how often, cycles of that, cycles elsewhere; see `Call`.
_Apart = tuple[int, int, int]


@dataclass(slots=True)
class _Open:
    """A call under way, with what its thread had been interrupted by when it began, and how low its stack has been."""

    function: WatchedFunction
    entered: int
    stack: int
    lowest: int
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
    given_up: dict[tuple[int, int], WatchedFunction] = field(default_factory=dict)
    apart: _Apart = (0, 0, 0)
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
    While no call is under way it does not want to know of exceptions.

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
        self._interrupted: list[_Thread | None] = []  # by exceptions that are active, the innermost last
        self._suspended: dict[int, _Thread] = {}
        self._spare: _Thread | None = None
        self._open_calls = 0
        self.listens = False

    def watch(self, address: int) -> WatchedFunction:
        """Watch the function at an address from now on; one that is watched already stays the same."""
        if address not in self._functions:
            self._functions[address] = WatchedFunction(address)
            self._hook(address)
        return self._functions[address]

    def look_at(self, function: WatchedFunction, address: int, size: int) -> None:
        """Have `Call.left` say what memory holds at each return of a function."""
        function.looks_at = address, size

    def settle(self) -> None:
        """Do nothing: the functions are up to date."""

    def reset(self) -> None:
        """Abandon all calls under way."""
        for thread in (self._thread, *self._interrupted, *self._suspended.values()):
            if thread is not None:
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
            self._accounting.stacks.take_lowest()
            thread.resumed_behind = self._accounting.instructions
            self._paused_cycles += self._processor.cycles - began
            self._paused_cycles += emptied_pipeline_costs(self._processor, thread.state)

    @property
    def is_paused(self) -> bool:
        """Whether what runs is not seen."""
        return self._is_paused

    def now(self) -> int:
        """Cycles since power-on without those that were paused, while nothing runs."""
        return self._accounting.cycles - self._paused_cycles

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
            accounting, thread = self._accounting, self._thread
            accounting.end_watch()  # each call is seen
            stack, link = self._stack_and_link.read()
            cycles = accounting.now(address)
            begins_block = cycles == accounting.cycles
            self._take_lowest(thread, has_ended=not begins_block)
            if thread.open or thread.given_up:
                self._arrives(address, stack, cycles - self._paused_cycles, begins_block=begins_block)
            function = self._functions.get(address)
            if function is not None:
                # What it waits because a branch led to it is the caller's.
                now = cycles - self._paused_cycles + (accounting.late if begins_block else 0)
                self._enters(function, stack, link & ~1, now, begins_block=begins_block)
        except BaseException as error:  # re-raised by the processor; ctypes would print and drop it
            self._processor.abort(error)

    def _last(self, *, begins_block: bool) -> Instruction | None:
        """Return what this thread executed last, if it ended a block."""
        thread, accounting = self._thread, self._accounting
        before = thread.before if accounting.instructions == thread.resumed_behind else accounting.before
        return before.instructions[-1] if before is not None and begins_block else None

    def _enters(
        self, function: WatchedFunction, stack: int, return_address: int, now: int, *, begins_block: bool
    ) -> None:
        thread = self._thread
        calls = thread.open
        for index in range(self._first_with(stack), len(calls)):
            each, last = calls[index], self._last(begins_block=begins_block)
            is_called = last is not None and last.calls
            if each.function is function and (each.entered == now or not is_called):
                return  # the emulator was stopped there and comes to it again, or it jumps to its own beginning
            if is_called and (each.function is function or each.return_address == return_address):
                self._abandon(thread, index)
                break
        outermost = not function.open or all(each.function is not function for each in calls)
        if thread.given_up:
            thread.given_up.pop((return_address, stack), None)
        calls.append(_Open(function, now, stack, stack, return_address, outermost, thread.apart))
        self._count(function, 1)
        if return_address not in self._hooked and return_address < _EXC_RETURN:
            self._processor.between_blocks(partial(self._hook, return_address))

    def _first_with(self, stack: int) -> int:
        """Return the index of the first call that began with a stack pointer; no call is below it."""
        calls = self._thread.open
        first = len(calls)
        while first and calls[first - 1].stack == stack:
            first -= 1
        return first

    def _arrives(self, address: int, stack: int, now: int, *, begins_block: bool) -> None:
        """Take note of an instruction that calls return to, or that begins a function."""
        thread = self._thread
        calls = thread.open
        while calls and calls[-1].stack < stack:
            thread.given_up[calls[-1].return_address, calls[-1].stack] = calls[-1].function
            self._abandon(thread, len(calls) - 1)
        first = self._first_with(stack)
        while first < len(calls) and calls[first].return_address != address:
            first += 1
        if first == len(calls) and (address, stack) not in thread.given_up:
            return
        last = self._last(begins_block=begins_block)
        place = last.address if last is not None and last.may_return else None
        if place is not None and first == len(calls):
            thread.given_up.pop((address, stack)).came_back += 1
        self._lower_outer(calls, first)
        for each in calls[first:]:
            if place is not None and each.return_address == address:
                self._close(each, now, place)
            else:  # where the call would have returned to was jumped to
                each.function.abandoned += 1
            self._count(each.function, -1)
        del calls[first:]

    def _count(self, function: WatchedFunction, more: int) -> None:
        function.open += more
        self._open_calls += more
        self.listens = self._open_calls > 0

    def _close(self, call: _Open, now: int, place: int) -> None:
        times, interrupts, elsewhere = self._thread.apart
        times_before, interrupts_before, elsewhere_before = call.apart
        call.function.calls.append(Call(
            call.entered, now, times - times_before, interrupts - interrupts_before, elsewhere - elsewhere_before,
            call.outermost, place, self._left_by(call.function),
            self._accounting.stacks.used_from(call.stack, call.lowest),
        ))  # fmt: skip

    def _left_by(self, function: WatchedFunction) -> int:
        if function.looks_at is None:
            return 0
        return int.from_bytes(self._processor.memory.read(*function.looks_at), "little")

    def _take_lowest(self, thread: _Thread, *, has_ended: bool = True) -> None:
        """Give what the stack pointer has been to the innermost call."""
        lowest = self._accounting.stacks.take_lowest(has_ended=has_ended)
        if thread.open:
            thread.open[-1].lowest = min(thread.open[-1].lowest, lowest)

    @staticmethod
    def _lower_outer(calls: list[_Open], first: int) -> None:
        """Give what calls from an index on have been to those around them."""
        for at in range(len(calls) - 1, max(first, 1) - 1, -1):
            calls[at - 1].lowest = min(calls[at - 1].lowest, calls[at].lowest)

    def _abandon(self, thread: _Thread, first: int) -> None:
        """Close calls from an index on that will not return."""
        self._lower_outer(thread.open, first)
        for each in thread.open[first:]:
            each.function.abandoned += 1
            self._count(each.function, -1)
        del thread.open[first:]

    # -- called by the processor between blocks -----------------------------------------------

    def entered(self, frame: int, /) -> None:
        """Take note of an exception."""
        if self._is_paused:
            return
        thread, from_thread = self._thread, frame & OF_THREAD
        if from_thread:
            self._interrupted.clear()
            if frame in self._suspended:  # its stack is another's now
                self._abandon(self._suspended.pop(frame), 0)
        if not thread.open:  # there is nothing to keep: the handler takes it over
            self._interrupted.append(None)
            return
        self._leave(thread)
        if from_thread:
            self._suspended[frame] = thread
        self._interrupted.append(thread)
        self._thread = self._spare or _Thread()
        self._spare = None

    def left(self, frame: int, cycles: int, /) -> None:
        """Take note of a return from an exception, which takes some cycles."""
        if self._is_paused:
            return
        handler = self._thread
        if handler.open:
            self._end_handler()
        interrupted = self._interrupted.pop() if self._interrupted else None
        thread = self._suspended.pop(frame, None) if frame & OF_THREAD else interrupted
        if thread is None:  # one without calls, or that begins
            return
        accounting = self._accounting
        gone = accounting.cycles - self._paused_cycles + cycles - thread.left_at
        gone += emptied_pipeline_costs(self._processor, thread.state)
        times, interrupts, elsewhere = thread.apart
        is_back = thread is interrupted
        thread.apart = (times + 1, interrupts + gone, elsewhere) if is_back else (times, interrupts, elsewhere + gone)
        accounting.stacks.take_lowest()  # the handler's
        thread.resumed_behind = accounting.instructions
        handler.given_up.clear()
        self._thread, self._spare = thread, handler

    def _leave(self, thread: _Thread) -> None:
        """Keep what a thread needs to go on."""
        accounting = self._accounting
        self._take_lowest(thread)
        thread.left_at = accounting.cycles - self._paused_cycles
        thread.state = NEUTRAL
        if accounting.instructions != thread.resumed_behind:  # else it was left before it ran, and loses nothing more
            thread.before, thread.state = accounting.before, accounting.left

    def _end_handler(self) -> None:
        """Close the calls of an exception: of its handler, and of what that tail-called."""
        calls, before = self._thread.open, self._accounting.before
        self._take_lowest(self._thread)
        while calls and calls[-1].return_address >= _EXC_RETURN:
            self._lower_outer(calls, len(calls) - 1)
            call = calls.pop()
            self._count(call.function, -1)
            self._close(call, self.now(), before.instructions[-1].address if before is not None else 0)
        self._abandon(self._thread, 0)


def emptied_pipeline_costs(processor: Processor, state: PipelineState) -> int:
    """Return how much longer the code at the PC takes because a pipeline was emptied of `state`."""
    if state is NEUTRAL:
        return 0
    lost, emptied, profile = 0, NEUTRAL, processor.profile
    pc = processor.registers.pc.get() & ~1
    while state != emptied:
        instruction = decode(pc, processor.memory.read(pc, 4))[0]
        cycles, emptied = profile.step(instruction, emptied)
        overlapping, state = profile.step(instruction, state)
        lost += cycles - overlapping
        pc += instruction.size
    return lost
