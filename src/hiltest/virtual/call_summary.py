"""Calls of a function that ran, and what they come to together."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from statistics import median_low
from typing import NamedTuple


class Call(NamedTuple):
    """One call that has returned.

    Attributes
    ----------
    entered, returned : int
        Cycles since power-on at the function's first instruction, and behind its return.
    interrupted : int
        How often an exception entered.
    interrupts : int
        Cycles of those.
    elsewhere : int
        Cycles of other tasks, and of the switches to them and back.
    outermost : bool
        Whether no other call of the same function was open: the cycles of one within are those of the outer one too.
    ended_in : int
        Address of the instruction that returned, which a tail call has put into another function.
    left : int
        What the word in memory held then that was asked for, or 0.
    """

    entered: int
    returned: int
    interrupted: int = 0
    interrupts: int = 0
    elsewhere: int = 0
    outermost: bool = True
    ended_in: int = 0
    left: int = 0

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
    """What the calls of a function come to.

    Attributes
    ----------
    function : str
    calls : int
        How many began and returned.
    least, median, most : int or None
        Cycles of a call, without exceptions and other tasks; None without a call, and where `refusal` says why. The
        median is that of a call: of the middle two the lower.
    share : float or None
        Part of all cycles that passed, asleep ones included; of calls within one of the same function only the outer
        one counts.
    interrupted : int
        Calls that an exception entered.
    interrupts, elsewhere : int
        Cycles of exceptions, and of other tasks, within calls.
    abandoned : int
        Calls that never returned.
    open : int
        Calls that are under way.
    ended_in : tuple of str
        Other functions that returned for it: it ends in tail calls, and its cycles contain those of what it jumped to.
    refusal : str
        Why its cycles cannot be told; empty where they can.
    """

    function: str
    calls: int
    least: int | None
    median: int | None
    most: int | None
    share: float | None
    interrupted: int = 0
    interrupts: int = 0
    elsewhere: int = 0
    abandoned: int = 0
    open: int = 0
    ended_in: tuple[str, ...] = ()
    refusal: str = ""


def summarised(
    function: str, calls: Sequence[Call], passed: int, *, abandoned: int = 0, open_calls: int = 0, came_back: int = 0,
    ended_in: tuple[str, ...] = (),
) -> CallSummary:  # fmt: skip
    """Sum up calls.

    Parameters
    ----------
    function : str
        Its name.
    calls : sequence of Call
    passed : int
        Cycles in which they were made.
    abandoned, open_calls : int
        Calls that never returned, and that are under way.
    came_back : int
        Calls that returned after their stack had been given up.
    ended_in : tuple of str
        Other functions that returned for it.
    """
    refusal = came_back and (
        f"{function}: {came_back} calls returned on a stack that had been left without an exception (coroutines?), so "
        "whose cycles are whose cannot be told; watch functions that do not switch stacks"
    )
    cycles = sorted(each.cycles for each in calls) if not refusal else []
    within = sum(each.cycles for each in calls if each.outermost)
    return CallSummary(
        function, len(calls),
        cycles[0] if cycles else None, median_low(cycles) if cycles else None, cycles[-1] if cycles else None,
        within / passed if passed > 0 and not refusal else None,
        sum(each.interrupted > 0 for each in calls), sum(each.interrupts for each in calls),
        sum(each.elsewhere for each in calls), abandoned, open_calls, ended_in, refusal or "",
    )  # fmt: skip
