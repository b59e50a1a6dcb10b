"""Counting of clock cycles while the emulator runs.

Two ways that give the same totals. `BlockAccounting` prices a whole translated
block once, caches it, and adds the cost each time the block runs: fast enough
for daily work. `InstructionAccounting` prices one instruction at a time: slow,
plain, and what the other one is checked against.

Both learn whether a branch was taken from where execution goes on, so a cost
is added when the *next* block (or instruction) begins.
"""

from __future__ import annotations

import math
from array import array
from collections.abc import Callable
from typing import ClassVar, Protocol

from hiltest.virtual.blocks import (
    BLOCKS_KEPT,
    NO_BLOCK,
    CodeBlock,
    ReadCode,
    conditions_at,
    price_block,
    priced_block,
    reached_by,
    reached_state,
)
from hiltest.virtual.code_hook import CODE_CALLBACK, CodeHook, Totals
from hiltest.virtual.executions import Entered, Snapshot
from hiltest.virtual.instructions import Instruction, decode
from hiltest.virtual.pipeline import NEUTRAL, REACHED, PipelineState, Reached
from hiltest.virtual.stacks import Stacks
from hiltest.virtual.timing import TimingProfile
from hiltest.virtual.turn import PassOver


class Accounting(Protocol):
    """Interface of both ways of counting to the processor.

    Attributes
    ----------
    per_instruction : bool
        Whether `begins` wants every instruction rather than every block.
    passes_waits : bool
        Whether turns of loops that only wait are passed over at once, where this way of counting can do that; to be
        set before anything runs.
    sees_all : bool
        Whether all that an IT block skips is seen, and not only what costs another time; to be set before anything
        runs. Turns of a loop with an IT block are then not proved to go alike, and no count depends on it.
    code_forgotten : callable
        To be set: told how often every block has run, before that is dropped with the code.
    pass_over : PassOver
        Asked about turns of a loop that changes something, where this way of counting asks.
    stacks : Stacks
        Where the stack pointer has been.
    read_stack_pointer : callable
        To be set: reads it.
    stopped : bool
        Set by `settle`: whether the emulator was stopped without the `stop` that was given.
    """

    per_instruction: ClassVar[bool]
    cycles: int
    instructions: int
    deadline: float
    passes_waits: bool
    sees_all: bool
    code_forgotten: Callable[[Snapshot], None]
    pass_over: PassOver
    stacks: Stacks
    read_stack_pointer: Callable[[], int]
    stopped: bool

    @property
    def before(self) -> CodeBlock | None:
        """What ran before the block (or instruction) that runs, or last, while nothing does."""

    @property
    def left(self) -> PipelineState:
        """What the code that ran last left in the pipeline, while nothing runs."""
        ...

    def hook(self, outside: int, abort: Callable[[BaseException], None]) -> CodeHook:
        """Return the hook for the emulator where code begins, except at the address `outside`."""
        ...

    def data_hook(
        self, forget_condition: Callable[[], None], abort: Callable[[BaseException], None]
    ) -> CodeHook | None:
        """Return the hook for the emulator where data is accessed, or None."""
        ...

    def watched_hook(self, abort: Callable[[BaseException], None]) -> CodeHook | None:
        """Return the hook for watched instructions of IT blocks, or None where all that is executed is seen."""

    @property
    def jumped_from(self) -> int | None:
        """Address of the last instruction that began, while nothing has begun behind it."""
        ...

    def now(self, pc: int) -> int:
        """Virtual time [cycles] of the instruction at `pc`, which is being executed."""
        ...

    def instructions_now(self, pc: int) -> int:
        """Instructions before the one at `pc`, which is being executed."""
        ...

    @property
    def late(self) -> int:
        """Cycles that the block (or instruction) which runs waits because of how execution came to it."""
        ...

    def settle(self, pc: int) -> None:
        """Add what has run to the totals: the emulator stopped, and `pc` is next."""
        ...

    def begins(self, address: int, size: int) -> None:
        """Note that the emulator is about to run the code at `address`."""
        ...

    def translated(self, address: int, size: int) -> None:
        """Take note that the emulator has translated a block; not for the first time where it was written to."""
        ...

    def snapshot(self, pc: int) -> Snapshot | None:
        """Return how often every block has run before the instruction at `pc`; None where it is not counted."""
        ...

    def end_watch(self) -> None:
        """Take the turn of a loop that runs for one that does more than wait."""
        ...

    def steady_until(self, cycle: float) -> None:
        """Take note that what was read of a peripheral changes by itself, at that cycle."""
        ...

    def stack_begins(self, top: int) -> None:
        """Take note of where the stack pointer is at a reset."""
        ...

    def stacked(self, above: int, lowest: int) -> None:
        """Take note of an exception's frame, from `lowest` to where the stack pointer was, `above`."""
        ...

    def flush_pipeline(self) -> None:
        """Empty the pipeline: nothing overlaps across an exception."""
        ...

    def forget_code(self) -> None:
        """Drop cached code: memory was loaded anew."""
        ...


# Begins to count at zero; the parameters are those of `Totals`.
AccountingFactory = Callable[[TimingProfile, ReadCode, Callable[[CodeBlock], bool], Callable[[], None]], Accounting]


class BlockAccounting(Totals):
    """Counts by translated block."""

    per_instruction: ClassVar[bool] = False

    def __init__(
        self, profile: TimingProfile, read_code: ReadCode, attend: Callable[[CodeBlock], bool], stop: Callable[[], None]
    ) -> None:
        super().__init__(profile, read_code, attend, stop)
        self._running: CodeBlock | None = None
        self._number = NO_BLOCK  # of the block that runs
        self._fell_from = NO_BLOCK  # number of the block that left its pipeline state, or `reached_by`; while none runs
        self._entered: list[Entered] = []
        self._runs = array("q")
        self.forget_code()

    def begins(self, address: int, size: int) -> None:
        """Take note that the emulator is about to run a block (its block hook)."""
        if self._running is not None:
            self._finish(address)
        if self.cycles >= self.deadline:
            self._running = None
            self._stop()
            return
        before = self._fell_from
        known = self._jumped_to[before].get(address) if before < 0 else self._known.get((address, size, before))
        if known is None or known[0].end != address + size:
            known = self._enter(address, size, before)
        block, self._number = known
        self._running = block
        if block.needs_attention and not self._attend(block):
            self._running = None
            self._stop()
            return
        self._look_at_stack(block)
        self._fell_from = NO_BLOCK
        if block.loops_to_itself and block.away in (NO_BLOCK, before):
            # Nothing but an interrupt ends it: pass whole rounds at once, up to the next event.
            rounds = max(math.ceil((self.deadline - self.cycles) / block.taken) - 1, 0)
            self.cycles += rounds * block.taken
            self.instructions += rounds
            self._runs[2 * self._number + 1] += rounds

    def watched_hook(self, abort: Callable[[BaseException], None]) -> CodeHook:
        """Return a callback that calls `executes`, and `abort` with whatever that raises."""

        def on_executed(_engine: int, address: int, _size: int, _data: int) -> None:
            """Take note of an instruction; what goes wrong ends the run, for the emulator takes no exception."""
            try:
                self.executes(address)
            except BaseException as error:  # re-raised by the processor; ctypes would print and drop it
                abort(error)

        return CodeHook(CODE_CALLBACK(on_executed), None)

    def executes(self, address: int) -> None:
        """Take note that an instruction which is watched is executed: from here on it is the block with that one."""
        if self._running is None:
            return
        known = self._executing.get((self._number, address))
        if known is None:
            block, number = self._running.executing(address, self._profile), self._number
            if block is not self._running:
                number = len(self._entered)
                self._entered.append(Entered(block, self._entered[self._number].before))
                self._runs.extend((0, 0))
            known = self._executing[self._number, address] = block, number
        self._running, self._number = known

    def _finish(self, address: int) -> None:
        """Add the block that runs; `address` is where execution goes on."""
        block = self._running
        assert block is not None
        self.before = block
        self.instructions += block.count
        if address == block.end:
            self.cycles += block.through
            self._runs[2 * self._number] += 1
            self._fell_from = block.past if block.transfers else self._number
        else:
            self.cycles += block.taken
            self._runs[2 * self._number + 1] += 1
            self._fell_from = block.away

    def _enter(self, address: int, size: int, before: int) -> tuple[CodeBlock, int]:
        """Price a block behind the one that execution fell out of, and give it a number."""
        self._running = None  # the block before is added already, should reading the code fail
        known = self._known.get((address, size, before))
        if known is None:
            state = self._state_of(before)
            known = self._known[address, size, before] = self._price(address, size, state), len(self._entered)
            self._entered.append(Entered(known[0], before))
            self._runs.extend((0, 0))
        if before < 0:
            self._jumped_to[before][address] = known  # found by the address alone, which is quicker
        return known

    def _state_of(self, before: int) -> PipelineState:
        return reached_state(before) if before < 0 else self._entered[before].block.exit_state

    @property
    def left(self) -> PipelineState:
        """What the block that ended last left in the pipeline, while none runs."""
        return self._state_of(self._fell_from)

    def _price(self, address: int, size: int, state: PipelineState) -> CodeBlock:
        code = self._priced_code[address, size] = self._read_code(address, size)
        block = priced_block(self._profile, address, code, state, sees_all=self.sees_all)
        conditions = conditions_at(self._profile, address, block, self._read_code, sees_all=self.sees_all)
        if not conditions:
            return block
        return priced_block(self._profile, address, code, state, conditions, sees_all=self.sees_all)

    def translated(self, address: int, size: int) -> None:
        """Take note that the emulator has translated a block; not for the first time where it was written to."""
        priced = self._priced_code.get((address, size))
        if priced is not None and priced != self._read_code(address, size):
            self.forget_code()

    @property
    def late(self) -> int:
        """Cycles that the block which runs waits because of how execution came to it."""
        return 0 if self._running is None else self._running.late

    @property
    def jumped_from(self) -> int | None:
        """Address of the last instruction of the block that runs."""
        return None if self._running is None else self._running.instructions[-1].address

    def now(self, pc: int) -> int:
        """Virtual time [cycles] at the start of the instruction at `pc`."""
        block = self._running
        return self.cycles if block is None else self.cycles + block.cycles_before(pc, self._profile)

    def instructions_now(self, pc: int) -> int:
        """Instructions before the one at `pc`."""
        running = () if self._running is None else self._running.instructions
        return self.instructions + sum(1 for instruction in running if instruction.address < pc & ~1)

    def snapshot(self, pc: int) -> Snapshot:
        """Say how often every block has run before the instruction at `pc`."""
        running = NO_BLOCK if self._running is None else self._number
        return Snapshot(self._entered, self._runs[:], running, pc & ~1)

    def settle(self, pc: int) -> None:
        """Add the block that just ended; `pc` is where execution goes on."""
        if (running := self._running) is not None:
            before = self.before if pc & ~1 == running.address else running  # it may not have begun
            self._finish(pc & ~1)
            self.before = before
        self._running = None
        if len(self._entered) > BLOCKS_KEPT:  # a block has as many versions as ways through its IT blocks
            self.forget_code()

    def flush_pipeline(self) -> None:
        """Empty the pipeline: an exception was entered or left."""
        self._fell_from = NO_BLOCK

    def forget_code(self) -> None:
        """Drop cached blocks, but not the one that is not over: its end is to be counted, or what it leaves is."""
        self.code_forgotten(self.snapshot(0))
        kept = self._running
        if kept is not None:
            self._number = 0
        elif self._fell_from >= 0:
            kept, self._fell_from = self._entered[self._fell_from].block, 0
        self._entered = [] if kept is None else [Entered(kept, NO_BLOCK)]
        self._runs = array("q", [0, 0] * len(self._entered))
        self._jumped_to: dict[int, dict[int, tuple[CodeBlock, int]]] = {reached_by(how): {} for how in Reached}
        self._known: dict[tuple[int, int, int], tuple[CodeBlock, int]] = {}
        self._executing: dict[tuple[int, int], tuple[CodeBlock, int]] = {}  # by number, and what is executed in it
        self._priced_code: dict[tuple[int, int], bytes] = {}


class InstructionAccounting(Totals):
    """Counts instruction by instruction: the reference for `BlockAccounting`."""

    per_instruction: ClassVar[bool] = True

    def __init__(
        self, profile: TimingProfile, read_code: ReadCode, attend: Callable[[CodeBlock], bool], stop: Callable[[], None]
    ) -> None:
        super().__init__(profile, read_code, attend, stop)
        self._last: Instruction | None = None
        self._runs: CodeBlock | None = None  # the same, as a block
        self._state = NEUTRAL

    def begins(self, address: int, size: int) -> None:
        """Take note that the emulator is about to run an instruction (its code hook)."""
        self._finish(address)
        if self.cycles >= self.deadline:
            self._stop()
            return
        block = self._look(address, size)
        if block.needs_attention and not self._attend(block):
            self._stop()
            return
        self._look_at_stack(block)
        self._last, self._runs = block.instructions[0], block

    def _look(self, address: int, size: int) -> CodeBlock:
        return price_block(self._profile, decode(address, self._read_code(address, size))[:1], self._state)

    def _finish(self, next_address: int) -> None:
        last, self._last = self._last, None
        if last is None:
            return
        if next_address != last.address:  # else it was stopped before it ran
            self.before = self._runs
        self._add(last)
        end = last.address + last.size
        if last.transfer:
            if next_address != end or not last.conditional:
                self._jumps(last)
            return
        # The code hook is silent for instructions that an IT block skips.
        while end < next_address <= end + 16:
            skipped = decode(end, self._read_code(end, 4))[0]
            self._add(skipped.skipped() if self._profile.prices_skipped else skipped)
            end += skipped.size

    def _jumps(self, last: Instruction) -> None:
        self.cycles += self._profile.taken(last)
        self._state = REACHED[self._profile.reached(last)]

    def _add(self, instruction: Instruction) -> None:
        cycles, self._state = self._profile.step(instruction, self._state)
        self.cycles += cycles
        self.instructions += 1

    @property
    def left(self) -> PipelineState:
        """What the instruction that ended last left in the pipeline, while none runs."""
        return self._state

    @property
    def late(self) -> int:
        """Cycles that the instruction which runs waits because of how execution came to it."""
        return 0 if self._last is None or self._runs is None else self._runs.late

    @property
    def jumped_from(self) -> int | None:
        """Address of the instruction that runs."""
        return None if self._last is None else self._last.address

    def now(self, pc: int) -> int:
        """Virtual time [cycles] at the start of the instruction at `pc`."""
        self._reach(pc & ~1)
        return self.cycles

    def instructions_now(self, pc: int) -> int:
        """Instructions before the one at `pc`."""
        self._reach(pc & ~1)
        return self.instructions

    def _reach(self, address: int) -> None:
        # The code hook is silent at an even address: the jump there is over, and nothing else has begun.
        if self._last is not None and self._last.address != address:
            self._finish(address)

    def settle(self, pc: int) -> None:
        """Add the instruction that just ended; `pc` is where execution goes on."""
        self._finish(pc & ~1)

    def snapshot(self, _pc: int) -> None:
        """Return None: blocks are not counted."""

    def flush_pipeline(self) -> None:
        """Empty the pipeline: an exception was entered or left."""
        self._state = NEUTRAL

    def forget_code(self) -> None:
        """Do nothing: no code is cached."""
