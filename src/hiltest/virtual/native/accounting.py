"""Counting by block in C: the same numbers as `BlockAccounting`, from block_hook.c."""

from __future__ import annotations

import ctypes
import math
from collections.abc import Callable, Sequence
from functools import lru_cache
from typing import ClassVar

from unicorn.unicorn_py3.unicorn import uclib

from hiltest.virtual.blocks import BLOCKS_KEPT, NO_BLOCK, CodeBlock, ReadCode, conditions_at, priced_block
from hiltest.virtual.code_hook import CodeHook
from hiltest.virtual.executions import Entered, Snapshot
from hiltest.virtual.instructions import Instruction
from hiltest.virtual.native import library as native
from hiltest.virtual.pipeline import NEUTRAL, REACHED, PipelineState
from hiltest.virtual.registers import register_number
from hiltest.virtual.stack_moves import Moves
from hiltest.virtual.stacks import Stack, Stacks
from hiltest.virtual.timing import TimingProfile
from hiltest.virtual.turn import LoopTurn, PassOver

_PLACES = 4096  # of the table at first: the shipped firmware has about a thousand blocks
_NEVER = (1 << 63) - 1
_FIRST_WAIT = 2  # jumps backward from a block before a loop is watched
_ASKED_ABOUT = (
    native.USES_FPU | native.ALIGNMENT_INSIDE | native.WATCHED_INSIDE | native.CHANGES_MASKS | native.LOOPS_TO_ITSELF
    | native.LOWERS_STACK | native.MOVES_STACK_BY | native.MOVES_STACK
)
_MOVES = {Moves.AS_IT_SAYS: 0, Moves.BY_A_REGISTER: native.MOVES_STACK_BY, Moves.ELSEWHERE: native.MOVES_STACK}
_REACHED = len(REACHED)  # entries that are a `Reached`; above are the numbers of blocks, from here on
_CYCLES, _INSTRUCTIONS, _DEADLINE, _RUNNING, _BEFORE = range(5)  # words at the start of the counter
_REASONS, _LOWERED_FROM = (getattr(native.Counter, name).offset // 4 for name in ("reasons", "lowered_from"))


def _kept(instructions: Sequence[Instruction]) -> int:
    """Find the registers r0 to r12 that stay multiples of four: not written, or moved by whole words."""
    kept = 0x1FFF
    for instruction in instructions:
        moved = sum(1 << written for written, source in instruction.derived if written == source)
        kept &= ~instruction.core_writes | moved
    return kept


@lru_cache(maxsize=BLOCKS_KEPT)
def _reasons_and_registers(
    profile: TimingProfile, address: int, code: bytes, entry: PipelineState, conditions: int = 0, *,
    sees_all: bool = False,
) -> tuple[CodeBlock, int, int, int]:  # fmt: skip
    """Price a block, and return what the hook needs besides the numbers: reasons, aligned, kept."""
    block = priced_block(profile, address, code, entry, conditions, sees_all=sees_all)
    reasons = (
        (native.USES_FPU if block.uses_fpu else 0)
        | (native.ALIGNMENT_INSIDE if block.alignment.inside else 0)
        | (native.WATCHED_INSIDE if block.watched else 0)
        | (native.CHANGES_MASKS if block.changes_masks or block.sends_event else 0)
        | (native.LOOPS_TO_ITSELF if block.loops_to_itself else 0)
        | (native.MAY_WAIT if all(each.may_wait for each in block.instructions) else 0)
        | (native.MAY_BE_PROVED if all(each.may_be_proved for each in block.instructions) else 0)
        | (native.LOWERS_STACK if block.lowers_stack else 0) | _MOVES[block.moves_stack]
        | native.WATCHED | native.STACK_MOVED
    )
    aligned = sum(1 << register for register in block.alignment.registers)
    return block, reasons, aligned, _kept(block.instructions)


TellPassed = Callable[[Sequence[int], int], None]


class NativeBlockAccounting:
    """Counts by translated block, in C.

    Parameters
    ----------
    profile, read_code, attend, stop
        As for `BlockAccounting`; `stop` is not called, `stopped` says so instead.
    """

    per_instruction: ClassVar[bool] = False

    def __init__(
        self, profile: TimingProfile, read_code: ReadCode, attend: Callable[[CodeBlock], bool], stop: Callable[[], None]
    ) -> None:
        self.stopped = False
        self.passes_waits, self.sees_all = True, False
        self.code_forgotten: Callable[[Snapshot], None] = lambda _runs: None
        self.pass_over: PassOver = lambda _turn: 0
        self.stacks = Stacks()
        self._on = (Stack(0, 0, 0), Stack(0, 0, 0))  # those that the stack pointer was on last
        self.read_stack_pointer: Callable[[], int] = lambda: 0  # C reads it itself
        self._tell_passed: TellPassed = lambda _addresses, _turns: None
        self._profile = profile
        self._read_code = read_code
        self._attend = attend
        self._abort: Callable[[BaseException], None] = lambda _error: stop()
        self._library = native.library()
        self._counter = native.Counter(
            running_number=-1, before_number=-1, reasons=_ASKED_ABOUT,
            registers=(*(register_number(f"R{number}") for number in range(native.CORE_REGISTERS)),
                       register_number("XPSR")),
            stop=ctypes.cast(uclib.uc_emu_stop, ctypes.c_void_p),
            read_register=ctypes.cast(uclib.uc_reg_read, ctypes.c_void_p),
            read_registers=ctypes.cast(uclib.uc_reg_read_batch, ctypes.c_void_p),
            price=native.PRICE(self._on_price), execute=native.EXECUTE(self._on_execute),
            attend=native.ATTEND(self._on_attend), stack=native.STACK(self._on_stack),
            passed=native.PASSED(self._on_passed), prove=native.PROVE(self._on_prove),
        )  # fmt: skip
        self._address = ctypes.addressof(self._counter)
        self._words = memoryview(self._counter).cast("B").cast("q")
        self._halves = memoryview(self._counter).cast("B").cast("I")
        self._settle = self._library.hiltest_settle
        self._runs, self._ends = (ctypes.c_int64 * 0)(), (ctypes.c_uint32 * 0)()
        self._ran_before: CodeBlock | None = None  # of code that was forgotten
        self._entered: list[Entered] = []
        self.forget_code()

    # -- totals, which the hook writes --------------------------------------------------------

    @property
    def cycles(self) -> int:
        """Clock cycles of all blocks that have ended."""
        return self._words[_CYCLES]

    @cycles.setter
    def cycles(self, value: int) -> None:
        self._words[_CYCLES] = value

    @property
    def instructions(self) -> int:
        """Instructions of all blocks that have ended."""
        return self._words[_INSTRUCTIONS]

    @instructions.setter
    def instructions(self, value: int) -> None:
        self._words[_INSTRUCTIONS] = value

    @property
    def deadline(self) -> float:
        """Time to stop [cycles]."""
        return self._words[_DEADLINE]

    @deadline.setter
    def deadline(self, value: float) -> None:
        # Totals are whole cycles: they reach a fraction when they reach the next whole one.
        self._words[_DEADLINE] = _NEVER if value >= _NEVER else math.ceil(value)

    # -- called by the emulator ---------------------------------------------------------------

    def hook(self, outside: int, abort: Callable[[BaseException], None]) -> CodeHook:
        """Return the function in C and the counter that it is to be given."""
        self._abort = abort
        self._counter.outside = outside
        return CodeHook(self._library.hiltest_block_begins, ctypes.c_void_p(self._address))

    def data_hook(self, _forget_condition: Callable[[], None], _abort: Callable[[BaseException], None]) -> None:
        """Return None: accesses to data cost nothing by themselves."""

    def watched_hook(self, _abort: Callable[[BaseException], None]) -> CodeHook:
        """Return the function in C for instructions of IT blocks that are watched, and the counter."""
        return CodeHook(self._library.hiltest_executes, ctypes.c_void_p(self._address))

    def _on_price(self, address: int, size: int, entry: int) -> int:
        try:
            self._add(address, self._read_code(address, size), entry)
        except BaseException as error:  # re-raised by the processor; ctypes would print and drop it
            self._abort(error)
            return 0
        return 1

    def _on_execute(self, address: int) -> int:
        try:
            self._add_executing(address)
        except BaseException as error:  # as above
            self._abort(error)
            return 0
        return 1

    def _on_attend(self, number: int) -> int:
        try:
            return self._attend(self._entered[number].block)
        except BaseException as error:  # as above
            self._abort(error)
            return 0

    def _on_stack(self, above: int, lowest: int) -> None:
        try:
            self._reaches(above, lowest)
        except BaseException as error:  # as above
            self._abort(error)

    def _on_passed(self, turns: int) -> None:
        watch = self._counter.watch
        try:
            self._tell_passed(watch.read[: watch.reads], turns)
        except BaseException as error:  # as above
            self._abort(error)

    def _on_prove(self) -> int:
        counter = self._counter
        watch = counter.watch
        blocks = [(self._entered[ran >> 1].block, bool(ran & 1)) for ran in watch.ran[: watch.blocks]]
        until = min(counter.deadline, watch.until)
        if any(block.watched for block, _ in blocks):
            return -1  # turns that are proved to go alike may yet differ in what they skip
        try:
            return self.pass_over(LoopTurn(blocks, counter.cycles, counter.cycles - watch.cycles, until))
        except BaseException as error:  # as above
            self._abort(error)
            return 0

    # -- the stack ----------------------------------------------------------------------------

    def stack_begins(self, top: int) -> None:
        """Take note of where the stack pointer is at a reset."""
        self._halves[_LOWERED_FROM] = 0
        self._reaches(top, top)

    def stacked(self, above: int, lowest: int) -> None:
        """Take note of an exception's frame."""
        halves = self._halves
        halves[_REASONS] |= native.STACK_MOVED  # the handler's stack may be another
        if halves[_LOWERED_FROM]:
            above, halves[_LOWERED_FROM] = max(halves[_LOWERED_FROM], above), 0
        for stack in self._on:
            if stack.lowest <= lowest and above <= stack.top:
                return
        self._reaches(above, lowest)

    def _reaches(self, above: int, lowest: int) -> None:
        stack = self.stacks.reaches(above, lowest)
        if stack is not self._on[0]:
            self._on = (stack, self._on[0])
        self._counter.stacks = tuple(end for each in self._on for end in (each.lowest, each.top))

    # -- the table of blocks ------------------------------------------------------------------

    def _add(self, address: int, code: bytes, entry: int) -> None:
        self._priced_code[address, len(code)] = code
        known = self._profile, address, code, self.left_by(entry)
        seen = self.sees_all
        priced_alike = _reasons_and_registers(*known, sees_all=seen)
        if conditions := conditions_at(self._profile, address, priced_alike[0], self._read_code, sees_all=seen):
            priced_alike = _reasons_and_registers(*known, conditions, sees_all=seen)
        block, reasons, aligned, kept = priced_alike
        number = len(self._entered)
        self._entered.append(Entered(block, NO_BLOCK - entry if entry < _REACHED else entry - _REACHED))
        self._put(native.PricedBlock(
            address, block.late, block.lowers_stack, len(code), entry,
            reasons=reasons, aligned=aligned, kept=kept, number=number,
        ), block)  # fmt: skip

    def _add_executing(self, address: int) -> None:
        """Put the block that runs into the table once more, as it is when the instruction at `address` is executed."""
        running = native.PricedBlock.from_buffer_copy(native.PricedBlock.from_address(self._counter.running))
        block, before = self._entered[running.number]
        executing = block.executing(address, self._profile)
        running.entry, running.executed = native.EXECUTING | running.number, address
        if executing is not block:
            running.number = len(self._entered)
            self._entered.append(Entered(executing, before))
        self._put(running, executing)

    def _put(self, priced: native.PricedBlock, block: CodeBlock) -> None:
        """Put a block into the table, with its prices."""
        number = priced.number
        priced.leaves = NO_BLOCK - block.past if block.transfers else number + _REACHED
        priced.jumps, priced.count = NO_BLOCK - block.away, block.count
        priced.through, priced.taken, priced.wait = block.through, block.taken, _FIRST_WAIT
        jumps_back = self.passes_waits and block.instructions[-1].jumps_back(block.address)
        priced.next = _FIRST_WAIT if jumps_back else _NEVER
        self._priced.append(priced)
        if 2 * (len(self._priced) + 1) > len(self._table):  # numbers are no more
            self._spread(2 * len(self._table))
        else:
            self._library.hiltest_add_block(self._address, ctypes.addressof(priced))
        self._note_end(number, block)

    def _note_end(self, number: int, block: CodeBlock) -> None:
        last = block.instructions[-1]
        does = (native.CALLS if last.calls else 0) | (native.RETURNS if last.may_return else 0)
        does |= native.LEAVES_NOTHING if block.exit_state == NEUTRAL and block.away == NO_BLOCK else 0
        self._ends[2 * number : 2 * number + 2] = [last.address, does]

    def _spread(self, places: int) -> None:
        """Put every block into a table of that many places, and count on."""
        runs = (ctypes.c_int64 * places)()  # two for each block, of which the table has half as many as places
        ctypes.memmove(runs, self._runs, ctypes.sizeof(self._runs))
        ends = (ctypes.c_uint32 * places)()
        ctypes.memmove(ends, self._ends, ctypes.sizeof(self._ends))
        self._table, self._runs, self._ends = (native.PricedBlock * places)(), runs, ends
        self._counter.ends = ctypes.addressof(ends)
        self._counter.table = ctypes.addressof(self._table)
        self._counter.runs = ctypes.addressof(runs)
        self._counter.places_mask = places - 1
        self._counter.watch.trigger = None  # it was a place of the other table
        for priced in self._priced:
            self._library.hiltest_add_block(self._address, ctypes.addressof(priced))

    def translated(self, address: int, size: int) -> None:
        """Take note that the emulator has translated a block; not for the first time where it was written to."""
        priced = self._priced_code.get((address, size))
        if priced is not None and priced != self._read_code(address, size):
            self.forget_code()

    def forget_code(self) -> None:
        """Drop cached blocks, but not the one that is not over: its end is to be counted, or what it leaves is."""
        self.code_forgotten(self.snapshot(0))
        running, counter = self._running, self._counter
        self._ran_before, self._words[_BEFORE] = self.before, -1
        fallen_out_of = None if counter.state < _REACHED else self._entered[counter.state - _REACHED].block
        self._entered = []
        self._priced: list[native.PricedBlock] = []
        self._priced_code: dict[tuple[int, int], bytes] = {}
        self._runs, self._ends = (ctypes.c_int64 * 0)(), (ctypes.c_uint32 * 0)()
        counter.watch.trigger = None  # it will be no place of the table
        self.end_watch()
        if running is not None:
            self._last = native.PricedBlock.from_buffer_copy(native.PricedBlock.from_address(counter.running))
            self._last.number, self._last.leaves = 0, min(self._last.leaves, _REACHED)
            self._words[_RUNNING] = 0
            counter.running = ctypes.addressof(self._last)
        elif fallen_out_of is not None:
            counter.state = _REACHED
        if kept := running or fallen_out_of:
            self._entered.append(Entered(kept, NO_BLOCK))
        self._spread(_PLACES)
        if kept:
            self._note_end(0, kept)

    def words(self, field: str) -> int:
        """Return where a field of the counter is, for other hooks in C."""
        return self._address + int(getattr(native.Counter, field).offset)

    def left_by(self, entry: int) -> PipelineState:
        """Return the pipeline state that an entry of the table stands for."""
        return REACHED[entry] if entry < _REACHED else self._entered[entry - _REACHED].block.exit_state

    @property
    def left(self) -> PipelineState:
        """What the block that ended last left in the pipeline, while none runs."""
        return self.left_by(self._counter.state)

    # -- where execution is -------------------------------------------------------------------

    def permission_counter(self, tell_passed: TellPassed) -> int:
        """Return the address of the counter, for hooks that take note of accesses to peripherals.

        Parameters
        ----------
        tell_passed : callable
            Told the addresses of registers that were read in a turn of a loop, and how many such turns were passed
            over, where one of the registers is counted.
        """
        self._tell_passed = tell_passed
        return self._address

    def end_watch(self) -> None:
        """Take the turn of a loop that runs for one that does more than wait."""
        self._library.hiltest_end_watch(self._address)

    def steady_until(self, cycle: float) -> None:
        """Take note that what was read of a peripheral changes by itself, at that cycle."""
        if cycle < _NEVER:  # a clock that stands still brings no change
            watch = self._counter.watch
            watch.until = min(watch.until, math.floor(cycle))

    @property
    def _running(self) -> CodeBlock | None:
        number = self._words[_RUNNING]
        return None if number < 0 else self._entered[number].block

    @property
    def before(self) -> CodeBlock | None:
        """What ran before the block that runs, or last, while none does."""
        number = self._words[_BEFORE]
        return self._ran_before if number < 0 else self._entered[number].block

    @property
    def late(self) -> int:
        """Cycles that the block which runs waits because of how execution came to it."""
        block = self._running
        return 0 if block is None else block.late

    @property
    def jumped_from(self) -> int | None:
        """Address of the last instruction of the block that runs."""
        block = self._running
        return None if block is None else block.instructions[-1].address

    def now(self, pc: int) -> int:
        """Virtual time [cycles] at the start of the instruction at `pc`."""
        block = self._running
        return self.cycles if block is None else self.cycles + block.cycles_before(pc, self._profile)

    def instructions_now(self, pc: int) -> int:
        """Instructions before the one at `pc`."""
        block = self._running
        running = () if block is None else block.instructions
        return self.instructions + sum(1 for instruction in running if instruction.address < pc & ~1)

    def snapshot(self, pc: int) -> Snapshot:
        """Say how often every block has run before the instruction at `pc`."""
        runs = ctypes.string_at(self._runs, 16 * len(self._entered))
        return Snapshot(self._entered, memoryview(runs).cast("q"), self._words[_RUNNING], pc & ~1)

    def settle(self, pc: int) -> None:
        """Add the block that just ended; `pc` is where execution goes on."""
        self.stopped = bool(self._settle(self._address, pc & ~1))
        if len(self._entered) > BLOCKS_KEPT:  # a block has as many versions as ways through its IT blocks
            self.forget_code()

    def begins(self, address: int, size: int) -> None:
        """Take note that a block is about to run; the emulator calls the hook itself."""
        self._library.hiltest_block_begins(None, address, size, self._address)

    def flush_pipeline(self) -> None:
        """Empty the pipeline: an exception was entered or left."""
        self._counter.state = native.NEUTRAL_ENTRY
