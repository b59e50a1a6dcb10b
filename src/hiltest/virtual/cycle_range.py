"""Uncertainty range of a count: the same executions, priced with the rows of the timing profile moved.

The blocks that ran are known, and so is what each costs under any table; a count under a moved table is what the board
would have counted, had it been made with that table. What no row explains is a part of the count, by a row of its own.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass

from hiltest.measurement import DOUBT, CycleRange, RowEffect, in_flash
from hiltest.virtual.executions import Executions, Pricing, together
from hiltest.virtual.peripherals.cycle_counter import CycleCounter
from hiltest.virtual.timing import TimingProfile, moved

# The result is usable when the FPU is free, or a cycle later: they are uncertain together.
_TOGETHER = {"fp_divide": "fp_divide_use"}


@dataclass(frozen=True, slots=True)
class Move:
    """One uncertainty of a profile: the values of its rows at either end."""

    row: str
    low: dict[str, int]
    high: dict[str, int]


def moves(profile: TimingProfile) -> Iterator[Move]:
    """Yield what can move in a profile: each uncertain row, or two rows that only move together."""
    rows = profile.rows
    second = {row.against for row in rows.values()} | set(_TOGETHER.values())
    for name, row in rows.items():
        if name in second:
            continue
        low, high = {name: row.band[0]}, {name: row.band[1]}
        if row.against:
            low[row.against], high[row.against] = reversed(rows[row.against].band)
        if other := _TOGETHER.get(name):
            low[other], high[other] = rows[other].band
        if low != high:
            yield Move(name, low, high)


def cycle_range(
    profile: TimingProfile, cycles: int, whole: Executions, empty: Executions | None = None
) -> CycleRange | None:
    """Return the uncertainty range of a count: every uncertain row takes any value of its own range.

    Parameters
    ----------
    profile : TimingProfile
        Profile that it was counted by.
    cycles : int
        The count.
    whole : Executions
        What was counted.
    empty : Executions or None
        What was counted and subtracted.

    Returns
    -------
    CycleRange or None
        None when these executions do not make up the count: an exception came between, or the processor slept.
    """
    if empty is not None and empty.entered is not whole.entered:
        return None
    nominal = Pricing(profile, whole.entered)

    def count(pricing: Pricing) -> int:
        """Return the count by other prices."""
        return pricing.total(whole) - (pricing.total(empty) if empty else 0)

    if count(nominal) != cycles:
        return None
    used = nominal.rows_used()
    uncertain = [move for move in moves(profile) if used.intersection(move.low)]
    effects: list[RowEffect] = []
    least: dict[str, int] = {}
    most: dict[str, int] = {}
    for move in uncertain:
        low, high = (_count_moved(count, nominal, profile, values) for values in (move.low, move.high))
        least |= move.low if low <= high else move.high
        most |= move.high if low <= high else move.low
        if low != cycles or high != cycles:
            effects.append(RowEffect(move.row, low, high))
    low, high = (_count_moved(count, nominal, profile, values) for values in (least, most))
    if doubt := _doubt(profile, cycles):
        effects.append(RowEffect(DOUBT, cycles - doubt, cycles + doubt))
    effects.sort(key=lambda each: -max(abs(each.low - cycles), abs(each.high - cycles)))
    return CycleRange(low - doubt, high + doubt, tuple(effects))


def _doubt(profile: TimingProfile, cycles: int) -> int:
    """Return by how many cycles a count may be wrong where every row is right."""
    row = profile.rows.get(DOUBT)
    return math.ceil(cycles * row.value / 1000) if row else 0


def flash_range(profile: TimingProfile, cycles: int) -> CycleRange | None:
    """Return the uncertainty range of a count of code in flash, from the memory rows of the profile.

    Returns
    -------
    CycleRange or None
        None for a profile without such rows: zero wait states were assumed, and the truth is no such band above that.
    """
    if not profile.memory:
        return None
    percent = profile.memory["flash_uncertainty"].value
    return CycleRange(round(cycles * (100 - percent) / 100), round(cycles * (100 + percent) / 100))


def range_where_it_ran(
    profile: TimingProfile, cycle_model: str, cycles: int, executed: tuple[Executions, Executions] | None
) -> CycleRange | None:
    """Return the uncertainty range of a timed count, for the memory that the code ran from.

    What code in flash waits for is of no row: its count carries the uncertainty that the profile states, whatever ran.

    Parameters
    ----------
    profile : TimingProfile
        Profile that it was counted by.
    cycle_model : str
        Its placement says where it ran.
    cycles : int
        The count.
    executed : tuple of Executions, or None
        What was counted, and what was subtracted; None where that is unknown.
    """
    if in_flash(cycle_model):
        return flash_range(profile, cycles)
    return cycle_range(profile, cycles, *executed) if executed else None


def _count_moved(
    count: Callable[[Pricing], int], nominal: Pricing, profile: TimingProfile, values: dict[str, int]
) -> int:
    if all(profile.rows[name].value == value for name, value in values.items()):
        return count(nominal)
    return count(nominal.moved(moved(profile, values), frozenset(values)))


class TimedSteps:
    """Records what ran in steps that the firmware timed one after the other.

    Parameters
    ----------
    counter : CycleCounter
        Counter that firmware reads around each step, and around the empty call in front of each.
    profile : TimingProfile
        Profile that it was counted by.
    cycle_model : str
        Its placement says where they ran.
    """

    def __init__(self, counter: CycleCounter, profile: TimingProfile, cycle_model: str) -> None:
        self._counter, self._profile, self._cycle_model = counter, profile, cycle_model
        self._cycles = 0
        self._whole: list[Executions] = []
        self._empty: list[Executions] = []
        self._known = True

    def add(self, cycles: Sequence[int], overhead_cycles: int) -> None:
        """Record the steps that were timed last, in order; after one that cannot be found nothing is known."""
        executed = self._counter.executed_in_steps(cycles, overhead_cycles)
        self._known = self._known and executed is not None
        self._cycles += sum(cycles)
        if executed:
            self._whole.append(executed[0])
            self._empty.append(executed[1])

    def band(self) -> CycleRange | None:
        """Return the uncertainty range of all steps together; None where it is unknown."""
        if not self._cycles:
            return None
        whole, empty = together(self._whole), together(self._empty)
        executed = (whole, empty) if self._known and whole and empty else None
        return range_where_it_ran(self._profile, self._cycle_model, self._cycles, executed)
