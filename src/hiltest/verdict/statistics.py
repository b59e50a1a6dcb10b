"""Mean of several values, and single pairs that moved far more than the others."""

from __future__ import annotations

from collections.abc import Sequence
from statistics import fmean, median

from hiltest.measurement import EXACT, Tolerance, round_significant

LARGEST = 1e100
"""Nothing that is measured is so large, and sums of such squares still are numbers."""


def mean_value(values: Sequence[float]) -> float | int | None:
    """Return the mean as it is written; None for no values, and where one is beyond `LARGEST`."""
    if not values or max(map(abs, values)) > LARGEST:
        return None
    mean = round_significant(fmean(values))
    return int(mean) if mean is not None and all(map(float.is_integer, values)) and mean == int(mean) else mean


FAR = 10.0
"""So many times the tolerance, and the median seed's move, is no chance.

Both firmwares read the same noise, so that a tolerance is already all that a harmless change moves. Of a change that
moves all seeds, normally distributed, ten medians are 6.7 standard deviations: one seed in 10^10 is farther.
"""


def moved_alone(base: Sequence[float], new: Sequence[float], tolerance: Tolerance) -> list[int]:
    """Return which pairs moved far beyond the tolerance and beyond what the others did.

    Parameters
    ----------
    base, new
        Paired, of a board whose noise is the same on both sides.
    tolerance
        Tolerance of their mean. With an exact one each pair counts in the mean already, and none is named.
    """
    if tolerance == EXACT:
        return []
    moves = [abs(after - before) for before, after in zip(base, new, strict=True)]
    sizes = [min(abs(before), abs(after)) for before, after in zip(base, new, strict=True)]
    usual = max(median(moves), tolerance.absolute)
    return [
        index for index, (move, size) in enumerate(zip(moves, sizes, strict=True))
        if move > FAR * max(usual, tolerance.relative * size)
    ]
