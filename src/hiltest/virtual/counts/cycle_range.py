"""Uncertainty range of a count: the errors of published counts, and other values in the uncertain rows of the profile.

The count by other values is exactly that of a board whose profile has these values. The row `doubt_permille` adds the
uncertainty that no other row explains, in profiles without errors of published counts.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from weakref import WeakKeyDictionary

from hiltest.measurement import DOUBT, PUBLISHED, CycleRange, RowEffect, runs_from_flash
from hiltest.virtual.core.machine import Machine
from hiltest.virtual.model.timing import CountError, TimingProfile
from hiltest.virtual.peripherals.dwt import CycleCounter
from hiltest.virtual.processor.slices import PriceTables, Slice

# The result can be used when the FPU is free, or a cycle later, so the two rows change together.
_TOGETHER = {"fp_divide": "fp_divide_use"}


@dataclass(frozen=True, slots=True)
class Move:
    """One uncertainty of a profile: the values of its rows at both ends."""

    row: str
    low: dict[str, int]
    high: dict[str, int]


def moves(profile: TimingProfile) -> Iterator[Move]:
    """Yield the uncertainties of a profile: a row, or two rows that change together."""
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
    profile: TimingProfile,
    cycles: int,
    whole: Sequence[Slice],
    empty: Sequence[Slice] = (),
    *,
    error: CountError | None = None,
) -> CycleRange | None:
    """Return the range of counts if every uncertain row takes any value of its range.

    Parameters
    ----------
    profile
        Profile of the count.
    whole
        Slices that were counted.
    empty
        Slices that were counted and subtracted.
    error
        Errors of published counts of such code; by default the doubt of the profile.

    Returns
    -------
    CycleRange or None
        None if these slices do not reproduce the count, due to an exception or sleep.
    """
    if not whole:
        return None
    uncertain = list(moves(profile))
    alone = _count(profile, [values for move in uncertain for values in (move.low, move.high)], whole, empty)
    if alone is None or alone[0] != cycles:
        return None
    effects: list[RowEffect] = []
    least: dict[str, int] = {}
    most: dict[str, int] = {}
    for move, low, high in zip(uncertain, alone[1::2], alone[2::2], strict=True):
        least |= move.low if low <= high else move.high
        most |= move.high if low <= high else move.low
        if low != cycles or high != cycles:
            effects.append(RowEffect(move.row, low, high))
    ends = _count(profile, [least, most], whole, empty)
    if ends is None:
        return None
    below, above = _doubt(profile, cycles) if error is None else _published(error, cycles)
    if below or above:
        effects.append(RowEffect(DOUBT if error is None else PUBLISHED, cycles - below, cycles + above))
    effects.sort(key=lambda effect: -max(abs(effect.low - cycles), abs(effect.high - cycles)))
    return CycleRange(ends[1] - below, ends[2] + above, tuple(effects))


def _count(
    profile: TimingProfile, tables: Sequence[Mapping[str, int]], whole: Sequence[Slice], empty: Sequence[Slice]
) -> list[int] | None:
    """Return the counts by the profile and by each table of rows that differ from it; None if they are unknown."""
    prices = _price_tables(whole[0].machine, profile, tables)
    counts, subtracted = prices.count(whole), prices.count(empty)
    if counts is None or subtracted is None:
        return None
    return [count - less for count, less in zip(counts, subtracted, strict=True)]


_Key = tuple[str, str]
_cached_tables: WeakKeyDictionary[Machine, dict[_Key, PriceTables]] = WeakKeyDictionary()
_MOST_CACHED = 4  # by machine: for the moves of one row and of all rows, for two profiles


def _price_tables(machine: Machine, profile: TimingProfile, tables: Sequence[Mapping[str, int]]) -> PriceTables:
    """Return price tables, from the cache if possible, because cached tables have already priced the code."""
    cached = _cached_tables.setdefault(machine, {})
    key = profile.digest, repr(tables)
    prices = cached.pop(key, None) or PriceTables(machine, profile, tables)
    cached[key] = prices  # the least recently used key stands first
    if len(cached) > _MOST_CACHED:
        del cached[next(iter(cached))]
    return prices


def _doubt(profile: TimingProfile, cycles: int) -> tuple[int, int]:
    """Return by how much a count may be too high, and too low, for reasons that no row explains [cycles]."""
    row = profile.rows.get(DOUBT)
    doubt = math.ceil(cycles * row.value / 1000) if row else 0
    return doubt, doubt


def _published(error: CountError, cycles: int) -> tuple[int, int]:
    """Return by how much a count may be too high, and too low, as published counts were [cycles]."""
    low, high = error.permille
    return math.ceil(-cycles * low / 1000), math.ceil(cycles * high / 1000)


def flash_range(profile: TimingProfile, cycles: int) -> CycleRange | None:
    """Return the uncertainty range of a count of code in flash, from the memory rows of the profile.

    Returns
    -------
    CycleRange or None
        None for a profile without such rows, whose counts assume zero wait states.
    """
    row = profile.memory.get("flash_uncertainty")
    if row is None:
        return None
    percent = row.value
    return CycleRange(round(cycles * (100 - percent) / 100), round(cycles * (100 + percent) / 100))


def _error(profile: TimingProfile, cycle_model: str) -> CountError | None:
    """Return the errors of published counts whose code ran from the same memory."""
    if runs_from_flash(cycle_model):
        return profile.errors.get("flash")
    in_sram = profile.errors.get("sram")
    return profile.errors.get("sram_u", in_sram) if "sram_u" in cycle_model.partition("@")[2] else in_sram


def timed_range(
    profile: TimingProfile, cycle_model: str, cycles: int, executed: tuple[Sequence[Slice], Sequence[Slice]] | None
) -> CycleRange | None:
    """Return the uncertainty range of a timed count, by the memory of the code.

    Cost rows do not cover waits for flash: the profile states the uncertainty of counts of code in flash.

    Parameters
    ----------
    profile
        Profile of the count.
    cycle_model
        Cycle model of the count, whose placement is the memory of the code.
    executed
        Slices that were counted, and those that were subtracted; None if they are unknown.
    """
    error = _error(profile, cycle_model)
    if error is None and profile.waits_for_flash and runs_from_flash(cycle_model):
        return flash_range(profile, cycles)
    return cycle_range(profile, cycles, *executed, error=error) if executed else None


class TimedSteps:
    """Recorder of the slices of successive steps that the firmware timed.

    Parameters
    ----------
    counter
        Counter that firmware reads before and after each step, and before and after the empty call before each step.
    profile
        Profile of the counts.
    cycle_model
        Cycle model of the counts, whose placement is the memory of the code.
    """

    def __init__(self, counter: CycleCounter, profile: TimingProfile, cycle_model: str) -> None:
        self._counter, self._profile, self._cycle_model = counter, profile, cycle_model
        self._cycles = 0
        self._whole: list[Slice] = []
        self._empty: list[Slice] = []
        self._complete = True

    def add(self, cycles: Sequence[int], overhead_cycles: int) -> None:
        """Record the latest timed steps, in order; if the slices of one step are unknown, the range is unknown."""
        executed = self._counter.executed_in_steps(cycles, overhead_cycles)
        self._complete = self._complete and executed is not None
        self._cycles += sum(cycles)
        if executed:
            self._whole += executed[0]
            self._empty += executed[1]

    def band(self) -> CycleRange | None:
        """Return the uncertainty range of all steps together; None if it is unknown."""
        if not self._cycles:
            return None
        executed = (self._whole, self._empty) if self._complete else None
        return timed_range(self._profile, self._cycle_model, self._cycles, executed)
