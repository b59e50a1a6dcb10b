"""A measurement: name, value, unit, limit and outcome.

Pure: nothing here knows pytest, a board or a file.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace
from enum import StrEnum
from numbers import Integral
from typing import Protocol, runtime_checkable

SIGNIFICANT_DIGITS = 9
"""What the host computes is written with this many significant digits.

A float64 sum in another order differs in the 15th or 16th digit; after a chain of
solves and arc tangents a few more are lost. Nine leaves that noise out and is far
finer than anything a bench can see.
"""


WORST_OF_SEVERAL = "worst of several attempts"
"""The note of a measurement that is not the only one of its name."""


class Outcome(StrEnum):
    """What became of a measurement."""

    PASS = "pass"
    """Within its limit."""
    INFORMATION = "information"
    """Recorded without a limit: nothing was judged."""
    FAIL = "fail"
    """Outside its limit, or not a number."""
    UNSET = "unset"
    """It has a limit that could not be judged. A gate that is not evaluated fails closed."""
    NOT_OFFERED = "not offered"
    """This kind of board cannot know it, such as the true offset on a real board; or, with a note, there is nothing to
    measure on this run, such as the cost of one iteration where none was needed."""


FLASH_TIE = 0.10
"""Two cycle counts of code in flash are ranked only where they differ by more than this part of the smaller one.

What the flash makes of a function depends on where its lines happen to lie and on what the cache still has, and no
model of it is better than that; silicon itself moves by as much from one link to the next.
"""


def in_flash(cycle_model: str) -> bool:
    """Say whether a cycle model counts code that runs from flash: ``cortex-m4-k64f/1@flash``."""
    return "flash" in cycle_model.partition("@")[2]


@runtime_checkable
class Counted(Protocol):
    """A cost in clock cycles that knows what counted it, as a called function's does."""

    @property
    def cycles(self) -> int:
        """How many."""

    @property
    def cycle_model(self) -> str:
        """What counted them."""


@dataclass(frozen=True, slots=True)
class Limit:
    """Closed interval that a value must lie in; None leaves a side open.

    Raises
    ------
    ValueError
        If both sides are open, one is not a finite number, or they are in the wrong order.
    """

    min: float | None = None
    max: float | None = None

    def __post_init__(self) -> None:
        given = [side for side in (self.min, self.max) if side is not None]
        if not given:
            raise ValueError("a limit needs min, max or both")
        if not all(math.isfinite(side) for side in given):
            raise ValueError(f"a limit must be finite, got {self.min} to {self.max}")
        if self.min is not None and self.max is not None and self.min > self.max:
            raise ValueError(f"limit min {self.min} is above its max {self.max}")

    @classmethod
    def within(cls, magnitude: float) -> Limit:
        """Return the limit ``-magnitude`` to ``+magnitude``."""
        return cls(min=-magnitude, max=magnitude)

    def holds(self, value: float) -> bool:
        """Say whether `value` lies inside; a NaN never does."""
        above = self.min is None or value >= self.min
        below = self.max is None or value <= self.max
        return above and below

    def covers(self, other: Limit) -> bool:
        """Say whether whatever holds `other` holds this one too."""
        above = self.min is None or (other.min is not None and other.min >= self.min)
        below = self.max is None or (other.max is not None and other.max <= self.max)
        return above and below

    def __str__(self) -> str:
        if self.min is None:
            return f"at most {_number(self.max)}"
        if self.max is None:
            return f"at least {_number(self.min)}"
        if self.min == self.max:
            return f"exactly {_number(self.max)}"
        if self.min == -self.max:
            return f"within ±{_number(self.max)}"
        return f"{_number(self.min)} to {_number(self.max)}"


@dataclass(frozen=True, slots=True)
class RowEffect:
    """What a cycle count would be with one row of the cycle model at the lower or upper end of its band."""

    row: str
    low: int
    high: int


_Ends = tuple[tuple[float, float], ...]
"""What a move can add to two counts, to both at once: where it is, and at its ends."""


@dataclass(frozen=True, slots=True)
class CycleBand:
    """Within what a cycle count lies when every uncertain row of its cycle model moves within its own band.

    Attributes
    ----------
    low, high : int
        With every row at the end of its band where it costs less, or more.
    rows : tuple of RowEffect
        Each that changes the count, alone: the one that changes it most comes first.
    """

    low: int
    high: int
    rows: tuple[RowEffect, ...] = ()

    def __str__(self) -> str:
        return _range(self.low, self.high)

    @property
    def moved_most_by(self) -> RowEffect | None:
        """The row that alone changes the count most; None when no row does."""
        return next(iter(self.rows), None)

    def explained(self, model: str = "the cycle model") -> str:
        """Say within what the count lies, and which row of the model alone moves it most."""
        most = self.moved_most_by
        if most is None and self.low == self.high:
            return f"no uncertain row of {model} enters"
        if most is None:
            return f"{self}, no closer than the memories it runs from are known"
        return f"{self} by {model}'s bands, most by {most.row}: {_range(most.low, most.high)}"


@dataclass(frozen=True, slots=True)
class Measurement:
    """One number that a run produced.

    Attributes
    ----------
    name : str
        Dotted, lower case: ``heading.direct.max``.
    value : float, int or None
        None when there is no number to give.
    unit : str
        As written behind the number: ``deg``, ``cycle``, ``uT``, ``%``.
    limit : Limit or None
    information : Limit or None
        Shown beside the value, without a verdict.
    outcome : Outcome
    volatile : bool
        True when two runs of the same seed may differ in it, such as wall time.
    cycle_model : str
        For cycles: what counted them. Numbers of different models are never compared.
    note : str
        Why the outcome is what it is, when the numbers do not say it.
    test : str
        Node id of the test that measured it.
    band : CycleBand or None
        For cycles of a virtual board: what the cycle model's own uncertainty makes of them.
    """

    name: str
    value: float | int | None
    unit: str
    limit: Limit | None = None
    information: Limit | None = None
    outcome: Outcome = Outcome.INFORMATION
    volatile: bool = False
    cycle_model: str = ""
    note: str = ""
    test: str = ""
    band: CycleBand | None = None

    @property
    def gates(self) -> bool:
        """Whether this measurement alone makes a run red."""
        return self.outcome in (Outcome.FAIL, Outcome.UNSET)

    @property
    def says_why_not(self) -> bool:
        """Whether there is no number because there is nothing to measure, and not for want of one."""
        return self.outcome is Outcome.NOT_OFFERED and self.note not in ("", WORST_OF_SEVERAL)

    @property
    def band_reaches_beyond(self) -> bool:
        """Whether it keeps its limit as it was counted, and would not at one end of its band."""
        if self.band is None or self.limit is None or self.outcome is not Outcome.PASS:
            return False
        return not (self.limit.holds(self.band.low) and self.limit.holds(self.band.high))

    def rounded(self) -> Measurement:
        """Return it as it is written: host-computed numbers to nine significant digits."""
        return replace(self, value=round_significant(self.value))

    def __str__(self) -> str:
        value = "no value" if self.value is None else f"{readable(self.value, 6)} {self.unit}".rstrip()
        limit = f", limit {self.limit}" if self.limit else ""
        note = f" ({self.note})" if self.note else ""
        return f"{self.name} = {value}{limit}: {self.outcome}{note}"


def ratio_band(over: Measurement, under: Measurement) -> tuple[float, float] | None:
    """Return within what the ratio of two cycle counts lies; None where one has no band, or another cycle model.

    Both are counted by one model, so a row moves both, and every row moves by itself: the ratio is least, and greatest,
    with each row at one of its ends. What rows change only together, in either count, widens it.
    """
    one, other = over.band, under.band
    if one is None or other is None or over.cycle_model != under.cycle_model or not over.value or not under.value:
        return None
    ones, others = ({each.row: each for each in band.rows} for band in (one, other))
    moves: list[_Ends] = [((over.value, under.value),)]
    for row in sorted(ones.keys() | others.keys()):
        in_one, in_other = (_ends(ones.get(row), over.value), _ends(others.get(row), under.value))
        moves.append(tuple(zip(in_one, in_other, strict=True)))
    moves.append(tuple((by, 0) for by in _together(over.value, one)))
    moves.append(tuple((0, by) for by in _together(under.value, other)))
    swapped: list[_Ends] = [tuple((second, first) for first, second in ends) for ends in moves]
    if any(sum(min(first for first, _ in ends) for ends in each) <= 0 for each in (moves, swapped)):
        return None
    (most, of), (least_of, least) = _greatest_ratio(moves), _greatest_ratio(swapped)
    return least / least_of, most / of


def _ends(effect: RowEffect | None, value: float) -> tuple[float, float, float]:
    """Return what a row adds to a count where it is, and at either end of its band."""
    return (0, effect.low - value, effect.high - value) if effect else (0, 0, 0)


def _together(value: float, band: CycleBand) -> tuple[float, float, float]:
    """Return what all rows add to a count beyond what each adds alone: nothing, at the lower and at the upper end."""
    alone = [_ends(each, value) for each in band.rows]
    return 0, min(0, band.low - value - sum(map(min, alone))), max(0, band.high - value - sum(map(max, alone)))


def _greatest_ratio(moves: Sequence[_Ends]) -> tuple[float, float]:
    """Return the two sums with the greatest ratio that one end of each move can make; every second sum is positive.

    Dinkelbach's iteration: W. Dinkelbach, "On nonlinear fractional programming", Management Science 13 (1967) 492-498.
    The ends that make ``first - ratio * second`` greatest are chosen move by move; where they have no greater ratio,
    none have. The ratio grows in every step and there are so many ends, so it comes to an end, mostly in three steps.
    """
    first, second = _sums(ends[0] for ends in moves)
    while True:
        chosen = [max(ends, key=lambda end: end[0] * second - end[1] * first) for ends in moves]
        better, of = _sums(chosen)
        if better * second <= first * of:
            return first, second
        first, second = better, of


def _sums(ends: Iterable[tuple[float, float]]) -> tuple[float, float]:
    firsts, seconds = zip(*ends, strict=True)
    return sum(firsts), sum(seconds)


def cannot_be_ranked(one: Measurement | None, other: Measurement | None) -> bool:
    """Say whether two cycle counts are of code in flash and too close to say which is less."""
    if one is None or other is None or not one.value or not other.value:
        return False
    flash = in_flash(one.cycle_model) and in_flash(other.cycle_model)
    return flash and not is_beyond(FLASH_TIE, abs(one.value - other.value), one.value, other.value)


def is_beyond(part: float, moved: float, one: float, other: float) -> bool:
    """Say whether two numbers that are `moved` apart differ by more than a part of the one of smaller magnitude.

    Of the smaller: for a cost that rises that is what it was, and both ways round the answer is the same.
    """
    return moved > part * min(abs(one), abs(other))


def judge(
    name: str, value: float | int | None, *, unit: str, limit: Limit | None = None, information: Limit | None = None,
    not_judged: str = "", not_offered: str = "", could_offer: bool = False, volatile: bool = False,
    cycle_model: str = "", test: str = "", band: CycleBand | None = None, note: str = "",
) -> Measurement:
    """Make a measurement and decide its outcome.

    Parameters
    ----------
    name, value, unit, limit, information, volatile, cycle_model, test, band
        As in `Measurement`. A value of None means that there is none to give.
    not_judged : str, optional
        Why the limit cannot be applied. The outcome is then ``unset`` if there is a limit.
    not_offered : str, optional
        Why there is no value, where that follows from another result and nothing is missing.
    could_offer : bool, optional
        Whether this kind of board can know such a value, as a virtual one always can. None under
        a limit is then ``unset``, and not ``not offered``.
    note : str, optional
        What a number is of, where its name does not say it; an outcome that needs a reason has that instead.

    Returns
    -------
    Measurement
        With outcome ``fail`` and no value when `value` is not a finite number: a heading
        that is NaN is a wrong answer, not a missing one.

    Raises
    ------
    ValueError
        If the name is empty or the unit of a cycle count comes without its cycle model.
    """
    if not name:
        raise ValueError("a measurement needs a name")
    if unit.startswith("cycle") and not cycle_model:
        raise ValueError(f"{name}: cycles need their cycle model, or they could be compared with another's")
    if value is None and limit is not None and (could_offer or not_judged):
        outcome, note = Outcome.UNSET, not_judged or not_offered or "the board can offer it, and no value was given"
    elif value is None:
        outcome, note = Outcome.NOT_OFFERED, not_offered
    elif not math.isfinite(value := plain(value)):
        outcome, note, value = Outcome.FAIL, f"the value is {value}", None
    elif limit is not None and not_judged:
        outcome, note = Outcome.UNSET, not_judged
    elif limit is None:
        outcome = Outcome.INFORMATION
    else:
        outcome = Outcome.PASS if limit.holds(value) else Outcome.FAIL
    return Measurement(
        name=name, value=value, unit=unit, limit=limit, information=information, outcome=outcome,
        volatile=volatile, cycle_model=cycle_model, note=note, test=test, band=band,
    )


def plain(value: float | int) -> float | int:
    """Return a Python number for any number: numpy's scalars do not serialise."""
    return int(value) if isinstance(value, Integral) else float(value)


def round_significant(value: float | int | None, digits: int = SIGNIFICANT_DIGITS) -> float | int | None:
    """Round a float to `digits` significant digits; integers and None stay as they are.

    Examples
    --------
    >>> round_significant(0.97123456789)
    0.971234568
    >>> round_significant(12400)
    12400
    """
    if value is None or isinstance(value, int):
        return value
    return float(f"{value:.{digits - 1}e}") + 0.0  # adding zero makes a negative zero positive


def readable(value: float | int, digits: int = 4) -> str:
    """Return a value as people read it: thousands apart, and `digits` significant ones below a thousand.

    Examples
    --------
    >>> readable(11061.25)
    '11 061.2'
    >>> readable(1.96875)
    '1.969'
    """
    if abs(value) < 1000:
        return f"{value:.{digits}g}"
    return f"{value:,.1f}".removesuffix(".0").replace(",", " ")


def _range(low: int, high: int) -> str:
    return f"{readable(min(low, high))} to {readable(max(low, high))}"


def _number(value: float | None) -> str:
    """Return a side of a limit as it was written, thousands apart."""
    return f"{value:,.9g}".replace(",", " ")
