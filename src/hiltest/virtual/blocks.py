"""Straight-line code and its cost."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field, replace
from functools import lru_cache
from itertools import accumulate, takewhile

from hiltest.errors import BoardFault
from hiltest.virtual.alignment import Alignment, required_alignment
from hiltest.virtual.instructions import Instruction, conditions_left, decode
from hiltest.virtual.it_blocks import choices
from hiltest.virtual.pipeline import REACHED, PipelineState, Reached
from hiltest.virtual.stack_moves import Moves
from hiltest.virtual.timing import TimingProfile

ReadCode = Callable[[int, int], bytes]  # raises BoardFault where there is no memory

NO_BLOCK = -1  # number of no block

# Blocks of any firmware in this process: their code is in the key, so other code at the same address is another block.
BLOCKS_KEPT = 32_768


def reached_by(how: Reached) -> int:
    """Return what stands for a state that no code before decides, where else the number of a block does."""
    return NO_BLOCK - how


def reached_state(before: int) -> PipelineState:
    """Return the state that a number of no block stands for."""
    return REACHED[NO_BLOCK - before]


@dataclass(slots=True)
class CodeBlock:
    """Straight-line code as the emulator cuts it, priced from one pipeline state.

    Attributes
    ----------
    through, taken : int
        Cycles when execution falls out of its end, and when it jumps away.
    instructions : tuple of Instruction
        As they stand there.
    priced : tuple of Instruction
        As they are priced: those that are watched, see `hiltest.virtual.it_blocks`, as skipped, but for those that
        are known to have been executed.
    alignment : Alignment
        What must be word-aligned when it begins, and within it.
    transfers : bool
        Whether it ends with a transfer of control, which leaves no pipeline state, taken or not.
    late : int
        Cycles of them that the first instruction waits because of how execution comes to it.
    past, away : int
        What stands for what it leaves, `reached_by` something: where execution goes on behind a transfer, and where
        it jumps.
    watched : frozenset of int
        Addresses of instructions of IT blocks that are to be watched.
    executed : frozenset of int
        Those of them that are known to have been executed.
    needs_attention : bool
        Whether the processor must look before (FPU, hang, alignment, SEV, IT blocks) or behind it (masks).
    lowers_stack : int
        Bytes by which the stack pointer is lowest in it, below where it is when it begins.
    moves_stack : Moves
        Whether it moves it by what is not known before.
    """

    address: int
    end: int
    entry: PipelineState
    instructions: tuple[Instruction, ...]
    priced: tuple[Instruction, ...]
    count: int
    through: int
    taken: int
    late: int
    exit_state: PipelineState
    transfers: bool
    past: int
    away: int
    uses_fpu: bool
    changes_masks: bool
    sends_event: bool
    loops_to_itself: bool
    alignment: Alignment
    watched: frozenset[int]
    needs_attention: bool
    lowers_stack: int
    moves_stack: Moves
    executed: frozenset[int] = frozenset()
    _starts: dict[int, int] = field(default_factory=dict)
    _executing: dict[int, CodeBlock] = field(default_factory=dict)

    def executing(self, address: int, profile: TimingProfile) -> CodeBlock:
        """Return this block with one more of the watched instructions executed; itself where none is watched there."""
        if address not in self.watched:
            return self
        if address not in self._executing:
            pairs = zip(self.priced, self.instructions, strict=True)
            priced = tuple(this if this.address == address else each for each, this in pairs)
            through, taken, exit_state = prices(profile, priced, self.entry)
            self._executing[address] = replace(
                self, priced=priced, through=through, taken=taken, exit_state=exit_state,
                executed=self.executed | {address}, _starts={}, _executing={},
            )  # fmt: skip
        return self._executing[address]

    def cycles_before(self, address: int, profile: TimingProfile) -> int:
        """Cycles from the start of the block to the start of one of its instructions."""
        if not self._starts:
            total, state = 0, self.entry
            starts: dict[int, int] = {}
            for instruction in self.priced:
                starts[instruction.address] = total
                cycles, state = profile.step(instruction, state)
                total += cycles
            self._starts = starts  # whole at once: boards in other threads share the block
        return self._starts.get(address & ~1, 0)


def price_block(
    profile: TimingProfile, instructions: list[Instruction], entry: PipelineState, *, sees_all: bool = False
) -> CodeBlock:
    """Price straight-line code from a pipeline state on; with `sees_all` what costs the same skipped is watched too."""
    watched = choices(profile, instructions, entry)
    priced = tuple(each.skipped() if each.address in watched else each for each in instructions)
    if sees_all:
        watched |= {each.address for each in instructions if each.predicated and not each.transfer}
    through, taken, exit_state = prices(profile, priced, entry)
    last = instructions[-1]
    address, end = instructions[0].address, last.address + last.size
    away = reached_by(profile.reached(last) if last.transfer else Reached.ANYHOW)
    past = reached_by(profile.reached_past(last)) if last.conditional else away
    uses_fpu = any(instruction.uses_fpu for instruction in instructions)
    changes_masks = any(instruction.changes_masks for instruction in instructions)
    sends_event = any(instruction.sends_event for instruction in instructions)
    loops = last.jumps_to(address)
    lowers = any(instruction.lowers_stack > 0 for instruction in instructions)
    alignment = required_alignment(instructions)
    return CodeBlock(
        address, end, entry, tuple(instructions), priced, len(instructions), through, taken,
        profile.reached_late(priced[0], entry), exit_state,
        bool(last.transfer), past, away, uses_fpu, changes_masks, sends_event, loops and len(instructions) == 1,
        alignment, watched,
        bool(uses_fpu or changes_masks or sends_event or loops or alignment.registers or alignment.inside or watched),
        _lowest_stack(instructions) if lowers else 0,
        max(each.moves_stack for each in instructions),
    )  # fmt: skip


def _lowest_stack(instructions: list[Instruction]) -> int:
    """Return the most by which the stack pointer is lowered from the beginning on, as far as that is known."""
    known = takewhile(lambda each: each.moves_stack is Moves.AS_IT_SAYS, instructions)
    return max(0, *accumulate((each.lowers_stack for each in known), initial=0))


def passed(profile: TimingProfile, last: Instruction) -> Instruction:
    """Return the last instruction of a block as it is priced where execution goes on behind it."""
    return last.skipped() if last.transfer and last.predicated and profile.prices_skipped else last


def prices(
    profile: TimingProfile, priced: tuple[Instruction, ...], entry: PipelineState
) -> tuple[int, int, PipelineState]:
    """Return cycles when execution goes on behind the end and when it jumps away, and the state that is left."""
    total, state = 0, entry
    for instruction in priced[:-1]:
        cycles, state = profile.step(instruction, state)
        total += cycles
    last = priced[-1]
    cycles, left = profile.step(last, state)
    taken = total + cycles + (profile.taken(last) if last.transfer else 0)
    if last.transfer and not last.conditional:
        return taken, taken, left
    return total + profile.step(passed(profile, last), state)[0], taken, left


@lru_cache(maxsize=BLOCKS_KEPT)
def priced_block(
    profile: TimingProfile, address: int, code: bytes, entry: PipelineState, conditions: int = 0, *,
    sees_all: bool = False,
) -> CodeBlock:  # fmt: skip
    """Decode and price a block of code; one that was priced before costs nothing."""
    return price_block(profile, decode(address, code, conditions), entry, sees_all=sees_all)


def conditions_at(
    profile: TimingProfile, address: int, block: CodeBlock, read_code: ReadCode, *, sees_all: bool = False
) -> int:
    """Say how many of a block's instructions belong to an IT block that began before it, if that matters.

    The emulator cuts at the ends of pages. What matters is whether a jump at the end is always taken, and by some
    profiles what is skipped; with `sees_all` by each.
    """
    last = block.instructions[-1]
    if not (sees_all or profile.prices_skipped) and (block.count > 3 or not last.transfer or last.conditional):
        return 0
    try:
        return conditions_left(read_code(address - 14, 14))
    except BoardFault:  # a memory begins there
        return 0
