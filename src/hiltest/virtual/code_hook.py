"""What both ways of counting cycles share: how the emulator calls them where code begins, totals and settings."""

from __future__ import annotations

import ctypes
from collections.abc import Callable
from typing import Any, NamedTuple

from hiltest.virtual.blocks import CodeBlock, ReadCode
from hiltest.virtual.executions import Snapshot
from hiltest.virtual.stack_moves import Moves
from hiltest.virtual.stacks import Stack, Stacks
from hiltest.virtual.timing import TimingProfile
from hiltest.virtual.turn import PassOver

CODE_CALLBACK = ctypes.CFUNCTYPE(None, ctypes.c_void_p, ctypes.c_uint64, ctypes.c_uint32, ctypes.c_void_p)


class CodeHook(NamedTuple):
    """A C function for the emulator to call where code begins (None: nothing), and the argument that it wants."""

    function: Any
    data: Any


class Totals:
    """Counts and settings that both ways of counting share.

    Parameters
    ----------
    profile : TimingProfile
        The prices.
    read_code : callable
        ``read_code(address, size)`` reads target memory.
    attend : callable
        Called with a block that `needs_attention` before it runs; False stops.
    stop : callable
        Stops the emulator before the block that begins.
    """

    def __init__(
        self, profile: TimingProfile, read_code: ReadCode, attend: Callable[[CodeBlock], bool], stop: Callable[[], None]
    ) -> None:
        self.cycles = 0
        self.instructions = 0
        self.deadline: float = 0.0
        self._profile = profile
        self._read_code = read_code
        self._attend = attend
        self._stop = stop
        self.passes_waits = self.sees_all = False
        self.code_forgotten: Callable[[Snapshot], None] = lambda _runs: None
        self.pass_over: PassOver = lambda _turn: 0
        self.stopped = False
        self.before: CodeBlock | None = None
        self.stacks = Stacks()
        self.read_stack_pointer: Callable[[], int] = lambda: 0
        self._stack = Stack(0, 0, 0)  # that the stack pointer was on last
        self._stack_moved, self._lowered_from = False, 0

    # -- the stack ----------------------------------------------------------------------------

    def stack_begins(self, top: int) -> None:
        """Take note of where the stack pointer is at a reset."""
        self._lowered_from = 0
        self._stack = self.stacks.reaches(top, top)

    def stacked(self, above: int, lowest: int) -> None:
        """Take note of an exception's frame."""
        above, self._lowered_from = max(self._lowered_from, above), 0
        self._stack_moved = True  # the handler's stack may be another
        if lowest < self._stack.lowest or above > self._stack.top:
            self._stack = self.stacks.reaches(above, lowest)

    def _look_at_stack(self, block: CodeBlock) -> None:
        """Take note of where the stack pointer is, and gets to in a block."""
        self.stacks.block_begins()
        if not (block.lowers_stack or block.moves_stack or self._stack_moved):
            return
        at, moves = self.read_stack_pointer(), block.moves_stack
        above, self._lowered_from = max(self._lowered_from, at), at if moves is Moves.BY_A_REGISTER else 0
        self._stack_moved = moves is not Moves.AS_IT_SAYS
        lowest = at - block.lowers_stack
        self.stacks.in_block(lowest)
        if lowest < self._stack.lowest or above > self._stack.top:
            self._stack = self.stacks.reaches(above, lowest)

    # -- called by the emulator ---------------------------------------------------------------

    def begins(self, address: int, size: int) -> None:
        raise NotImplementedError

    def data_hook(
        self, _forget_condition: Callable[[], None], _abort: Callable[[BaseException], None]
    ) -> CodeHook | None:
        """Return None: accesses to data cost nothing by themselves."""
        return None

    def watched_hook(self, _abort: Callable[[BaseException], None]) -> CodeHook | None:
        """Return None: all that is executed is seen."""
        return None

    def translated(self, address: int, size: int) -> None:
        """Do nothing: no code is cached."""

    def end_watch(self) -> None:
        """Do nothing: no loop is watched."""

    def steady_until(self, cycle: float) -> None:
        """Do nothing, as above."""

    def hook(self, outside: int, abort: Callable[[BaseException], None]) -> CodeHook:
        """Return a callback that calls `begins`, and `abort` with whatever that raises."""
        begins = self.begins

        def on_code(_engine: int, address: int, size: int, _data: int) -> None:
            """Take note of a block; what goes wrong ends the run, for the emulator takes no exception."""
            if address == outside:
                return
            try:
                begins(address, size)
            except BaseException as error:  # re-raised by the processor; ctypes would print and drop it
                abort(error)

        return CodeHook(CODE_CALLBACK(on_code), None)
