"""Calls of a function that ran, and what they come to together."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from statistics import median_low
from typing import NamedTuple


class Call(NamedTuple):
    """One call that has returned."""

    entered: int
    returned: int
    """Cycles since power-on at the function's first instruction, and behind its return."""
    interrupted: int = 0
    """How often an exception entered."""
    interrupts: int = 0
    """Cycles of those."""
    elsewhere: int = 0
    """Cycles of other tasks, and of the switches to them and back."""
    outermost: bool = True
    """Whether no other call of the same function was open: the cycles of one within are those of the outer one too."""
    ended_in: int = 0
    """Address of the instruction that returned, which a tail call has put into another function."""
    left: int = 0
    """What the word in memory held then that was asked for, or 0."""
    stack: int | None = None
    """Bytes of its stack that it has taken at most, those of what it called included and of exceptions not; None
    where it has been on two stacks."""

    @property
    def elapsed(self) -> int:
        """Cycles from the first instruction to the return, whatever else ran."""
        return self.returned - self.entered

    @property
    def cycles(self) -> int:
        """The same without exceptions and other tasks."""
        return self.elapsed - self.interrupts - self.elsewhere


@dataclass(frozen=True, slots=True)
class CallSummary:
    """What the calls of a function come to."""

    function: str
    calls: int
    """How many began and returned."""
    least: int | None
    median: int | None
    most: int | None
    """Cycles of a call, without exceptions and other tasks; None without a call, and where `refusal` says why. The
    median is that of a call: of the middle two the lower."""
    share: float | None
    """Part of all cycles that passed, asleep ones included; of calls within one of the same function only the outer
    one counts."""
    interrupted: int = 0
    """Calls that an exception entered."""
    interrupts: int = 0
    elsewhere: int = 0
    """Cycles of exceptions, and of other tasks, within calls."""
    abandoned: int = 0
    """Calls that never returned."""
    open: int = 0
    """Calls that are under way."""
    ended_in: tuple[str, ...] = ()
    """Other functions that returned for it: it ends in tail calls, and its cycles contain those of what it jumped
    to."""
    refusal: str = ""
    """Why its cycles cannot be told; empty where they can."""


def summarised(
    function: str, calls: Sequence[Call], passed: int, *, abandoned: int = 0, open_calls: int = 0, came_back: int = 0,
    lost: int = 0, ended_in: tuple[str, ...] = (),
) -> CallSummary:  # fmt: skip
    """Sum up calls.

    Parameters
    ----------
    function
        Its name.
    passed
        Cycles in which they were made.
    abandoned, open_calls
        Calls that never returned, and that are under way.
    came_back
        Calls that returned after their stack had been given up.
    lost
        Calls that there was no room for.
    ended_in
        Other functions that returned for it.
    """
    refusal = ""
    if came_back:
        refusal = (
            f"{function}: {came_back} calls returned on a stack that had been left without an exception (coroutines?), "
            "so whose cycles are whose cannot be told; watch functions that do not switch stacks"
        )
    elif lost:
        refusal = (
            f"{function}: {lost} calls were not followed: too many were under way (256 in a task, 32 tasks), came from "
            "too many places (8192) or had not been read (4 million); watch fewer"
        )
    cycles = sorted(call.cycles for call in calls) if not refusal else []
    within = sum(call.cycles for call in calls if call.outermost)
    return CallSummary(
        function, len(calls),
        cycles[0] if cycles else None, median_low(cycles) if cycles else None, cycles[-1] if cycles else None,
        within / passed if passed > 0 and not refusal else None,
        sum(call.interrupted > 0 for call in calls), sum(call.interrupts for call in calls),
        sum(call.elsewhere for call in calls), abandoned, open_calls, ended_in, refusal,
    )  # fmt: skip


class Solution(NamedTuple):
    """Slices that came to a solution."""

    cycles: int
    longest: int
    """Of all slices, and of the longest."""
    slices: int


@dataclass(frozen=True, slots=True)
class SolutionSummary:
    """What a function that works in slices takes for a solution."""

    solutions: int
    """How many began and ended."""
    least: int | None
    median: int | None
    most: int | None
    """Cycles of a solution's slices together, without exceptions and other tasks; None without a solution."""
    fewest_slices: int | None
    most_slices: int | None
    longest_slice: int | None
    """Most cycles of a slice."""


def solved(slices: Sequence[Call], ends: Callable[[Call, int], bool], *, before: int, is_whole: bool) -> list[Solution]:
    """Sum up slices by the solution that they came to.

    Parameters
    ----------
    slices
        In the order of their entry; one within another counts with that one.
    ends
        Whether a slice was the last of a solution, by the slice and by what the one before it left.
    before
        What was left before the first.
    is_whole
        Whether the first slice is the first of a solution; otherwise its solution is left out.
    """
    found: list[Solution] = []
    cycles: list[int] = []
    outer_returned = -1
    for each in slices:
        if each.entered < outer_returned:
            continue
        outer_returned = each.returned
        cycles.append(each.cycles)
        if ends(each, before):
            if is_whole:
                found.append(Solution(sum(cycles), max(cycles), len(cycles)))
            cycles, is_whole = [], True
        before = each.left
    return found


def solutions_summarised(solutions: Sequence[Solution]) -> SolutionSummary:
    """Sum up solutions."""
    if not solutions:
        return SolutionSummary(0, None, None, None, None, None, None)
    cycles, slices = (sorted(column) for column in ([s.cycles for s in solutions], [s.slices for s in solutions]))
    return SolutionSummary(
        len(solutions), cycles[0], median_low(cycles), cycles[-1], slices[0], slices[-1],
        max(solution.longest for solution in solutions),
    )  # fmt: skip
