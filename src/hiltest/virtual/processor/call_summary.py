"""Completed calls of watched functions, and their statistics."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from statistics import median_low
from typing import NamedTuple


class Call(NamedTuple):
    """One call that has returned."""

    entered: int
    returned: int
    """Cycles since power-on at the function's first instruction and after its return."""
    interrupted: int = 0
    """Number of exceptions during the call."""
    interrupts: int = 0
    """Cycles of those exceptions."""
    elsewhere: int = 0
    """Cycles of other tasks and of task switches."""
    outermost: bool = True
    """False if an outer call of the same function, whose cycles include this call, was open."""
    ended_in: int = 0
    """Address of the return instruction, which is in another function after a tail call."""
    word: int = 0
    """Value of the watched word in memory at the return, or 0."""
    stack: int | None = None
    """Largest stack use [bytes], including callees but not exceptions; None if the call used two stacks."""

    @property
    def elapsed(self) -> int:
        """Cycles from the first instruction to the return, including exceptions and other tasks."""
        return self.returned - self.entered

    @property
    def cycles(self) -> int:
        """Elapsed cycles without exceptions and other tasks."""
        return self.elapsed - self.interrupts - self.elsewhere


@dataclass(frozen=True, slots=True)
class CallSummary:
    """Statistics of a function's calls."""

    function: str
    calls: int
    """Number of calls that began and returned."""
    least: int | None
    median: int | None
    most: int | None
    """Cycles of a call, without exceptions and other tasks; None if there are no calls, or if `refusal` has a reason.
    The median of an even number of calls is the lower of the middle two."""
    share: float | None
    """Share of all cycles, including sleep; nested calls of the same function count only once."""
    interrupted: int = 0
    """Calls during which an exception was taken."""
    interrupts: int = 0
    elsewhere: int = 0
    """Cycles of exceptions and of other tasks within calls."""
    abandoned: int = 0
    """Calls that never returned."""
    open: int = 0
    """Calls that have not returned yet."""
    ended_in: tuple[str, ...] = ()
    """Other functions that returned for this one because it ends in tail calls; its cycles include theirs."""
    refusal: str = ""
    """Reason why its cycles are unknown; empty if they are known."""


def summarise_calls(
    function: str,
    calls: Sequence[Call],
    passed: int,
    *,
    abandoned: int = 0,
    open_calls: int = 0,
    came_back: int = 0,
    lost: int = 0,
    ended_in: tuple[str, ...] = (),
) -> CallSummary:
    """Compute the statistics of calls.

    Parameters
    ----------
    passed
        Cycles during which the calls were made.
    abandoned, open_calls
        Calls that never returned, and calls that have not returned yet.
    came_back
        Calls that returned after they had been counted as abandoned.
    lost
        Calls that were not recorded because a table was full.
    ended_in
        Other functions that returned for this one.
    """
    refusal = ""
    if came_back:
        refusal = (
            f"{function}: {came_back} calls returned on a stack that had been left without an exception (coroutines?), "
            "so cycles cannot be attributed to calls; watch functions that do not switch stacks"
        )
    elif lost:
        refusal = (
            f"{function}: {lost} calls were not recorded: too many were open (256 in a task, 32 tasks), came from too "
            "many places (8192) or had not been read (4 million); watch fewer functions"
        )
    cycles = sorted(call.cycles for call in calls) if not refusal else []
    within = sum(call.cycles for call in calls if call.outermost)
    return CallSummary(
        function,
        len(calls),
        cycles[0] if cycles else None,
        median_low(cycles) if cycles else None,
        cycles[-1] if cycles else None,
        within / passed if passed > 0 and not refusal else None,
        sum(call.interrupted > 0 for call in calls),
        sum(call.interrupts for call in calls),
        sum(call.elsewhere for call in calls),
        abandoned,
        open_calls,
        ended_in,
        refusal,
    )


class Solution(NamedTuple):
    """Cost of a solution, which several slices compute."""

    cycles: int
    longest: int
    """Cycles of the longest slice."""
    slices: int


@dataclass(frozen=True, slots=True)
class SolutionSummary:
    """Statistics of a function that computes solutions in slices."""

    solutions: int
    """Number of solutions that began and ended."""
    least: int | None
    median: int | None
    most: int | None
    """Cycles of all slices of a solution, without exceptions and other tasks; None without a solution."""
    fewest_slices: int | None
    most_slices: int | None
    longest_slice: int | None
    """Cycles of the longest slice of any solution."""


def sum_solutions(
    slices: Sequence[Call], ends: Callable[[Call, int], bool], *, before: int, is_whole: bool
) -> list[Solution]:
    """Sum up the cycles of slices, by solution.

    Parameters
    ----------
    slices
        In the order of their entry; a nested slice counts with the outer one.
    ends
        Returns whether a slice completed a solution, from the slice and the word after the previous slice.
    before
        Value of the word before the first slice.
    is_whole
        True if the first slice begins a solution; otherwise its solution is ignored.
    """
    solutions: list[Solution] = []
    cycles: list[int] = []
    outer_returned = -1
    for part in slices:
        if part.entered < outer_returned:
            continue
        outer_returned = part.returned
        cycles.append(part.cycles)
        if ends(part, before):
            if is_whole:
                solutions.append(Solution(sum(cycles), max(cycles), len(cycles)))
            cycles, is_whole = [], True
        before = part.word
    return solutions


def summarise_solutions(solutions: Sequence[Solution]) -> SolutionSummary:
    """Compute the statistics of solutions."""
    if not solutions:
        return SolutionSummary(0, None, None, None, None, None, None)
    cycles, slices = (sorted(column) for column in ([s.cycles for s in solutions], [s.slices for s in solutions]))
    return SolutionSummary(
        len(solutions),
        cycles[0],
        median_low(cycles),
        cycles[-1],
        slices[0],
        slices[-1],
        max(solution.longest for solution in solutions),
    )
