"""Mean of several values, and single pairs that moved far more than the others."""

from __future__ import annotations

from collections.abc import Sequence
from statistics import fmean, median

from hiltest.measurement import EXACT, Tolerance, round_significant

LARGEST = 1e100
"""No measurement is larger, and sums of such squares are still finite."""


def mean_value(values: Sequence[float]) -> float | int | None:
    """Return the mean in its written form; None without values, and if one is beyond `LARGEST`."""
    if not values or max(map(abs, values)) > LARGEST:
        return None
    mean = round_significant(fmean(values))
    return int(mean) if mean is not None and all(map(float.is_integer, values)) and mean == int(mean) else mean


FAR = 10.0
"""A move is no chance if it exceeds the tolerance and the median seed's move by this factor.

Both firmwares read the same noise, so that a harmless change stays within the tolerance. If a change moves all seeds
with a normal distribution, ten medians are 6.7 standard deviations: one seed in 10^10 moves farther.
"""


def moved_alone(base: Sequence[float], new: Sequence[float], tolerance: Tolerance) -> list[int]:
    """Return the indices of pairs that moved far beyond the tolerance and beyond the other pairs.

    Parameters
    ----------
    base, new
        Paired values of a board whose noise is the same on both sides.
    tolerance
        Tolerance of their mean. If it is exact, each pair counts in the mean already, and none is returned.
    """
    if tolerance == EXACT:
        return []
    moves = [abs(after - before) for before, after in zip(base, new, strict=True)]
    sizes = [min(abs(before), abs(after)) for before, after in zip(base, new, strict=True)]
    usual = max(median(moves), tolerance.absolute)
    return [
        index
        for index, (move, size) in enumerate(zip(moves, sizes, strict=True))
        if move > FAR * max(usual, tolerance.relative * size)
    ]
