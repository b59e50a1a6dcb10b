"""IT blocks: which of their instructions must be watched, because it matters whether they are skipped.

Most are moves and additions, which take one cycle either way and leave nothing that anything waits for.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence

from hiltest.virtual.instructions import Instruction
from hiltest.virtual.pipeline import REACHED, PipelineState
from hiltest.virtual.timing import TimingProfile

_BUSY = ("fp_divide", "fp_accumulate")  # they may occupy the FPU while other instructions go on


def choices(profile: TimingProfile, instructions: Sequence[Instruction], entry: PipelineState) -> frozenset[int]:
    """Find the instructions of a block that are to be watched: by no table they cost the same skipped and executed.

    Parameters
    ----------
    profile : TimingProfile
        Where it does not price what is skipped, nothing matters.
    instructions : sequence of Instruction
        The block. Whether a transfer at its end is skipped shows in where execution goes on.
    entry : PipelineState
        What the block is priced from.

    Returns
    -------
    frozenset of int
        Addresses.
    """
    if not profile.prices_skipped:
        return frozenset()
    return frozenset(
        each.address for place, each in enumerate(instructions)
        if each.predicated and not each.transfer and _matters(profile, instructions, place, entry)
    )  # fmt: skip


def _matters(
    profile: TimingProfile, instructions: Sequence[Instruction], place: int, entry: PipelineState
) -> bool:
    this, behind = instructions[place], list(_next_to(instructions[place + 1 :]))
    if this.row not in ("data", "fp") or not all(profile.takes_one_cycle(row) for row in (this.row, "it_skipped")):
        return True
    if not behind or any(each.address_registers & this.core_writes for each in behind):
        return True
    if this.row == "data":
        return False
    before, written = list(_next_to(instructions[:place][::-1])), this.fp_writes
    read = this.fp_reads | this.fp_addend
    return (
        behind[0].misplaced  # its fetch may be late
        or any((each.fp_reads | each.fp_addend) & written for each in behind)
        or any(each.fp_writes & read for each in before)
        or _may_wait(instructions[:place], entry)
    )


def _next_to(instructions: Sequence[Instruction]) -> Iterator[Instruction]:
    """Yield the first of some instructions, and what is next to it through an IT that takes no time."""
    yield from instructions[: 2 if instructions and instructions[0].row == "it" else 1]


def _may_wait(before: Sequence[Instruction], entry: PipelineState) -> bool:
    """Whether the FPU may be busy, or a result not be there, behind some instructions."""
    for each in reversed(before):
        if each.uses_fpu and (each.row in _BUSY or not each.predicated):
            return each.row in _BUSY
    return entry not in REACHED
