"""Comparison of two cycle counts: their ratio, and whether they can be ranked."""

from __future__ import annotations

from collections.abc import Iterable, Sequence

from hiltest.measurement.cycle_range import DOUBT, PUBLISHED, CycleRange, RowEffect
from hiltest.measurement.measurement import Measurement

FLASH_TIE = 0.10
"""Two cycle counts of code in flash are ranked only if they differ by more than this fraction of the smaller one.

The effect of the flash depends on the positions of a function's lines and on the contents of the cache, and no
model is more accurate than that; silicon itself varies by as much from one link to the next.
"""


def runs_from_flash(cycle_model: str) -> bool:
    """Return whether a cycle model counts code that runs from flash: ``cortex-m4-k64f/3@flash``."""
    return "flash" in cycle_model.partition("@")[2]


def waits_for_flash(cycle_model: str) -> bool:
    """Return whether a cycle model counts code in flash whose waits are not known exactly.

    Code in flash without wait states does not depend on where the linker has put it.

    >>> [waits_for_flash(f"{model}@flash") for model in ("stm32f407/1-0ws", "stm32f407/1-5ws", "cortex-m4-k64f/3")]
    [False, True, True]
    """
    model = cycle_model.partition("@")[0]
    return runs_from_flash(cycle_model) and not model.endswith("-0ws") and not model.startswith("generic-")


_Ends = tuple[tuple[float, float], ...]
"""Changes of two counts by one row: at its value, and at both ends of its range."""


def ratio_range(over: Measurement, under: Measurement) -> tuple[float, float] | None:
    """Return the uncertainty range of the ratio of two cycle counts; None without ranges of one cycle model.

    Both are counted by one model, so a row changes both, and rows are independent: the ratio is extreme
    with each row at one of its ends. Joint effects of rows on either count widen the range, and so do differences that
    no row explains, of which each count has its own.
    """
    one, other = over.band, under.band
    if one is None or other is None or over.cycle_model != under.cycle_model or not over.value or not under.value:
        return None
    ones, others = ({effect.row: effect for effect in _rows(band)} for band in (one, other))
    moves: list[_Ends] = [((over.value, under.value),)]
    for row in sorted(ones.keys() | others.keys()):
        in_one, in_other = (_ends(ones.get(row), over.value), _ends(others.get(row), under.value))
        moves.append(tuple(zip(in_one, in_other, strict=True)))
    moves.append(tuple((by, 0) for by in _joint_effect(over.value, one)))
    moves.append(tuple((0, by) for by in _joint_effect(under.value, other)))
    swapped: list[_Ends] = [tuple((second, first) for first, second in ends) for ends in moves]
    if any(sum(min(first for first, _ in ends) for ends in pairs) <= 0 for pairs in (moves, swapped)):
        return None
    (most, most_of), (least_of, least) = _greatest_ratio(moves), _greatest_ratio(swapped)
    return least / least_of, most / most_of


def _ends(effect: RowEffect | None, value: float) -> tuple[float, float, float]:
    """Return the change of a count by a row at its value, and at either end of its uncertainty range."""
    return (0, effect.low - value, effect.high - value) if effect else (0, 0, 0)


def _rows(band: CycleRange) -> tuple[RowEffect, ...]:
    return tuple(row for row in band.rows if row.row not in (DOUBT, PUBLISHED))


def _joint_effect(value: float, band: CycleRange) -> tuple[float, float, float]:
    """Return the joint change of a count by all rows beyond their single changes: none, at the lower and upper end."""
    alone = [_ends(row, value) for row in _rows(band)]
    return 0, min(0, band.low - value - sum(map(min, alone))), max(0, band.high - value - sum(map(max, alone)))


def _greatest_ratio(moves: Sequence[_Ends]) -> tuple[float, float]:
    """Return the two sums with the greatest ratio that one end of each move can make; second sums are positive.

    Dinkelbach's iteration: W. Dinkelbach, "On nonlinear fractional programming", Management Science 13 (1967) 492-498.
    Each step chooses the ends that maximise ``first - ratio * second`` move by move; if they have no greater ratio,
    no ends have. The ratio grows in every step and the number of ends is finite, so it ends, mostly after three steps.
    """
    first, second = _sums(ends[0] for ends in moves)
    while True:
        chosen = [max(ends, key=lambda end: end[0] * second - end[1] * first) for ends in moves]
        better, better_second = _sums(chosen)
        if better * second <= first * better_second:
            return first, second
        first, second = better, better_second


def _sums(ends: Iterable[tuple[float, float]]) -> tuple[float, float]:
    firsts, seconds = zip(*ends, strict=True)
    return sum(firsts), sum(seconds)


def cannot_be_ranked(one: Measurement | None, other: Measurement | None) -> bool:
    """Return whether two cycle counts are of code in flash and too close to be ranked."""
    if one is None or other is None or not one.value or not other.value:
        return False
    flash = waits_for_flash(one.cycle_model) and waits_for_flash(other.cycle_model)
    return flash and not is_beyond(FLASH_TIE, abs(one.value - other.value), one.value, other.value)


def is_beyond(part: float, moved: float, one: float, other: float) -> bool:
    """Return whether two numbers that are `moved` apart differ by more than a part of the smaller magnitude.

    The smaller magnitude makes the answer symmetric; for a cost that rises it is the old value.
    """
    return moved > part * min(abs(one), abs(other))
