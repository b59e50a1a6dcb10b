"""Classes of cycles: the work of a class of instructions, or a stall.

The work of an instruction is what it costs when nothing before it makes it wait; what is above that is a
stall, and its cause is found by taking away, one after the other, what the pipeline remembers: the parts
therefore always add up to the whole.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from enum import StrEnum

from hiltest.virtual.blocks import CodeBlock, passed
from hiltest.virtual.instructions import Instruction
from hiltest.virtual.pipeline import NEUTRAL, Late, PipelineState, Reached
from hiltest.virtual.timing import TimingProfile


class Work(StrEnum):
    """Class of an instruction."""

    FLOATING_POINT = "floating_point"
    LOAD_STORE = "load_store"
    BRANCH = "branch"
    INTEGER = "integer"
    SYSTEM = "system"


class Stall(StrEnum):
    """Reason why an instruction cost more than its work."""

    TAKEN_BRANCH = "taken_branch"
    """The pipeline refills behind a transfer that is taken."""
    FP_RESULT = "fp_result"
    """It uses what the floating-point instruction right before it computes."""
    DIVISION = "division"
    """VDIV or VSQRT still occupies the FPU, or its result is not there yet; a multiply-accumulate, in a timing
    profile that hides some of its cycles."""
    LOAD_USE = "load_use"
    """A load takes its address from the load right before it, so the two do not overlap."""
    STORE_BUFFER = "store_buffer"
    """A load right behind a store waits for it."""
    ADDRESS = "address"
    """It makes an address of what the instruction right before it computes; in a profile that knows that."""
    FETCH = "fetch"
    """Its four bytes do not begin at a multiple of four, and are not fetched yet; in a profile that knows that."""


WORK_OF_ROW = {
    "data": Work.INTEGER, "divide": Work.INTEGER, "it": Work.INTEGER, "it_skipped": Work.INTEGER,
    "load": Work.LOAD_STORE, "store": Work.LOAD_STORE, "store_register_offset": Work.LOAD_STORE,
    "multiple_base": Work.LOAD_STORE, "exclusive": Work.LOAD_STORE, "fp_load": Work.LOAD_STORE,
    "fp_store": Work.LOAD_STORE,
    "branch": Work.BRANCH, "table_branch": Work.BRANCH,
    "barrier": Work.SYSTEM, "system": Work.SYSTEM,
    "fp": Work.FLOATING_POINT, "fp_accumulate": Work.FLOATING_POINT, "fp_divide": Work.FLOATING_POINT,
    "fp_move_pair": Work.FLOATING_POINT,
}  # fmt: skip
"""Class of each row of a timing profile that prices instructions."""


@dataclass(frozen=True, slots=True)
class InstructionCost:
    """Cost of one execution of one instruction [cycles]; `stalls` has only causes that cost something."""

    instruction: Instruction
    work: Work
    work_cycles: int
    stalls: tuple[tuple[Stall, int], ...]


def instruction_costs(profile: TimingProfile, block: CodeBlock, *, went_on: bool) -> Iterator[InstructionCost]:
    """Split the cost of a block among its instructions.

    Parameters
    ----------
    profile : TimingProfile
        Profile that priced the block.
    block : CodeBlock
    went_on : bool
        Whether execution went on at the end of the block, rather than jumped.

    Yields
    ------
    InstructionCost
        In order; together exactly ``block.through`` when it went on, else ``block.taken``.
    """
    state = block.entry
    last = block.instructions[-1]
    refilled = last.transfer and not (went_on and last.conditional)
    for instruction, priced in zip(block.instructions, block.priced, strict=True):
        each = passed(profile, priced) if instruction is last and not refilled else priced
        work_cycles, stalls = _split(profile, each, state)
        if instruction is last and refilled:
            stalls.append((Stall.TAKEN_BRANCH, profile.taken(last)))
        yield InstructionCost(instruction, WORK_OF_ROW[each.row], work_cycles, tuple(stalls))
        _, state = profile.step(each, state)


def _split(
    profile: TimingProfile, instruction: Instruction, state: PipelineState
) -> tuple[int, list[tuple[Stall, int]]]:
    """Split what a step costs into the work and the stalls of each cause."""
    cycles, _ = profile.step(instruction, state)
    stalls = []
    for cause, less_remembered in _without_one_after_the_other(state):
        less, _ = profile.step(instruction, less_remembered)
        if less < cycles:
            stalls.append((cause, cycles - less))
            cycles = less
    return cycles, stalls


def _without_one_after_the_other(state: PipelineState) -> Iterator[tuple[Stall, PipelineState]]:
    """Take away what an instruction can wait for, until nothing is left of it."""
    if state == NEUTRAL:
        return
    state = state._replace(late=Late.NOTHING, misplaced=0, reached=Reached.ANYHOW)
    yield Stall.FETCH, state
    state = state._replace(computed=0)
    yield Stall.ADDRESS, state
    state = state._replace(fpu_busy=0, divided=0)
    yield Stall.DIVISION, state
    state = state._replace(fp_result=0)
    yield Stall.FP_RESULT, state
    state = state._replace(loaded=0)
    yield Stall.LOAD_USE, state
    if state.before == "store":
        yield Stall.STORE_BUFFER, state._replace(before="")
