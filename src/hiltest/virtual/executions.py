"""The blocks that ran between two moments, so that the same executions can be priced again by another table.

What a block costs depends on the pipeline state that the code before it leaves, and that on the table. What a transfer
leaves no table changes; only a block that execution *fell into* from the one before it has to be priced behind that
one. So an execution is kept by the block and by the blocks it was fallen into from, and not by a state.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from hiltest.virtual.blocks import NO_BLOCK, CodeBlock, prices
from hiltest.virtual.instructions import Instruction
from hiltest.virtual.pipeline import PipelineState
from hiltest.virtual.timing import TimingProfile

# What prices an instruction beside the row that it is of.
_ALSO = {
    "load": ("load_behind_load", "load_behind_store", "refill_load"),
    "store": ("store_behind_load",),
    "table_branch": ("refill_table",),
    "it": ("it_folded",),
    "fp_accumulate": ("fp_accumulate_hidden",),
    "fp_divide": ("fp_divide_use",),
}
_OF_MISPLACED = ("target_misplaced", "return_misplaced", "fetch_late", "fetch_late_fp", "fetch_late_integer")
_REFILLS = {"direct": "refill_direct", "indirect": "refill_indirect"}


class Entered(NamedTuple):
    """A block, and the number of the one that execution fell into it from; one below zero where it was jumped to."""

    block: CodeBlock
    before: int


@dataclass(frozen=True, slots=True)
class Snapshot:
    """Counts of the runs of every block at one moment.

    Attributes
    ----------
    entered : sequence of Entered
        Blocks by number; shared by all snapshots until code is forgotten, and only added to.
    runs : sequence of int
        Twice as many: how often each went on behind its end, and jumped away.
    running : int
        Number of the block that is in the middle of running, which is not in `runs` yet, or `NO_BLOCK`.
    pc : int
        The instruction that is being executed.
    """

    entered: Sequence[Entered]
    runs: Sequence[int]
    running: int
    pc: int


@dataclass(frozen=True, slots=True)
class Executions:
    """Executions between two snapshots.

    Attributes
    ----------
    entered : sequence of Entered
    times : tuple of (int, int, int)
        Number of a block, how often it went on behind its end, and how often it jumped away.
    parts : tuple of (int, int, int)
        Number of a block, address of one of its instructions, and how often the part before that was executed: -1
        for the part that ran before the first snapshot.
    """

    entered: Sequence[Entered]
    times: tuple[tuple[int, int, int], ...]
    parts: tuple[tuple[int, int, int], ...]


def between(first: Snapshot | None, second: Snapshot | None) -> Executions | None:
    """Return what ran from the instruction of the first snapshot to that of the second; None where that is unknown."""
    return in_all([(first, second)])


def in_all(spans: Sequence[tuple[Snapshot | None, Snapshot | None]]) -> Executions | None:
    """Return what ran in some spans together, each between two snapshots; None where unknown, or without any."""
    known = [(first, second) for first, second in spans if first is not None and second is not None]
    if not known or len(known) < len(spans) or len({id(each.entered) for span in known for each in span}) > 1:
        return None
    runs = np.zeros(max(len(second.runs) for _, second in known), dtype=np.int64)
    parts: Counter[tuple[int, int]] = Counter()
    for span in known:
        for each, sign in zip(span, (-1, 1), strict=True):
            runs[: len(each.runs)] += sign * np.asarray(each.runs, dtype=np.int64)
            if each.running != NO_BLOCK:
                parts[each.running, each.pc] += sign
    by_block = runs.reshape(-1, 2)
    numbers = np.flatnonzero(by_block.any(axis=1)).tolist()
    times = tuple((number, *by_block[number].tolist()) for number in numbers)
    return Executions(known[0][1].entered, times, _not_zero(parts))


def together(executions: Sequence[Executions]) -> Executions | None:
    """Return all of some executions; None where code was forgotten between two of them, or there are none."""
    if not executions or any(each.entered is not executions[0].entered for each in executions):
        return None
    times: dict[int, list[int]] = {}
    for each in executions:
        for number, went_on, jumped in each.times:
            sums = times.setdefault(number, [0, 0])
            sums[0] += went_on
            sums[1] += jumped
    parts: Counter[tuple[int, int]] = Counter()
    for each in executions:
        for number, address, count in each.parts:
            parts[number, address] += count
    counted = tuple((number, sums[0], sums[1]) for number, sums in times.items())
    return Executions(executions[0].entered, counted, _not_zero(parts))


def _not_zero(parts: Counter[tuple[int, int]]) -> tuple[tuple[int, int, int], ...]:
    return tuple((number, address, count) for (number, address), count in parts.items() if count)


class Pricing:
    """Prices executions by one table, pipeline states included.

    Parameters
    ----------
    profile : TimingProfile
        The table.
    entered : sequence of Entered
        Blocks by number, as the executions name them.
    """

    def __init__(self, profile: TimingProfile, entered: Sequence[Entered]) -> None:
        self._profile = profile
        self._entered = entered
        self._ends: dict[int, tuple[int, int, PipelineState]] = {}
        self._rows: dict[int, frozenset[str]] = {}

    def moved(self, profile: TimingProfile, rows: frozenset[str]) -> Pricing:
        """Return prices by a table that differs in these rows alone; what they do not price is not priced again."""
        other = Pricing(profile, self._entered)
        for number, end in self._ends.items():
            if self._entered[number].before < 0 and not rows & self._rows_of(number):
                other._ends[number] = end
        return other

    def rows_used(self) -> set[str]:
        """Return the rows that may have entered what was priced so far, refills included."""
        return set().union(*map(self._rows_of, self._ends))

    def _rows_of(self, number: int) -> frozenset[str]:
        if number not in self._rows:
            self._rows[number] = rows_of(self._entered[number].block.priced)
        return self._rows[number]

    def total(self, executions: Executions) -> int:
        """Return the cycles of all of it."""
        cycles = sum(times * self._until(number, address) for number, address, times in executions.parts)
        for number, went_on, jumped in executions.times:
            through, taken = self.costs(number)
            cycles += went_on * through + jumped * taken
        return cycles

    def costs(self, number: int) -> tuple[int, int]:
        """Return what a block costs when execution goes on behind its end, and when it jumps away."""
        through, taken, _ = self._end(number)
        return through, taken

    def _end(self, number: int) -> tuple[int, int, PipelineState]:
        """Return the cycles of a block when execution goes on behind its end and when it jumps, and what it leaves."""
        # From the first that is not known yet: code without a branch may be cut into more blocks than calls may nest.
        unknown = []
        while number >= 0 and number not in self._ends:
            unknown.append(number)
            number = self._entered[number].before
        for each in reversed(unknown):
            self._ends[each] = prices(self._profile, self._entered[each].block.priced, self._entry(each))
        return self._ends[unknown[0] if unknown else number]

    def _entry(self, number: int) -> PipelineState:
        block, before = self._entered[number]
        return block.entry if before < 0 else self._end(before)[2]

    def _until(self, number: int, address: int) -> int:
        """Return the cycles from the start of a block to one of its instructions."""
        cycles, state = 0, self._entry(number)
        for instruction in self._entered[number].block.priced:
            if instruction.address >= address:
                break
            more, state = self._profile.step(instruction, state)
            cycles += more
        return cycles


def rows_of(instructions: tuple[Instruction, ...]) -> frozenset[str]:
    """Return the rows that may price some of these instructions, whatever stands before them."""
    rows: set[str] = set()
    for instruction in instructions:
        rows.add(instruction.row)
        rows.update(_ALSO.get(instruction.row, ()))
        if instruction.uses_fpu:
            rows.add("fp_use")
        if instruction.predicated and instruction.transfer:
            rows.add("it_skipped")
        if instruction.address_registers:
            rows.add("address_use")
        if instruction.misplaced:
            rows.update(_OF_MISPLACED)
        if instruction.transfer:
            rows.add(_REFILLS[instruction.transfer])
    return frozenset(rows)
