"""Seeds that moved by themselves, which a mean over many, and its interval, would hide."""

from __future__ import annotations

from collections.abc import Sequence
from statistics import median

from hiltest.comparison.model import EXACT, Tolerance

FAR = 10.0
"""So many times the tolerance, and the median seed's move, is no chance.

Both firmwares read the same noise, so that a tolerance is already all that a harmless change moves. Of a change that
moves all seeds, normally distributed, ten medians are 6.7 standard deviations: one seed in 10^10 is farther.
"""


def moved_alone(base: Sequence[float], new: Sequence[float], tolerance: Tolerance) -> list[int]:
    """Return which pairs moved far beyond the tolerance and beyond what the others did.

    Parameters
    ----------
    base, new : sequence of float
        Paired, of a board whose noise is the same on both sides.
    tolerance : Tolerance
        Of their mean. With an exact one each pair counts in the mean already, and none is named.
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
