"""Mean of paired changes, and its uncertainty with a few seeds."""

from __future__ import annotations

import math
from collections.abc import Sequence
from statistics import NormalDist, fmean, mean, median, stdev

from hiltest.measurement import EXACT, Tolerance, round_significant

PAIRS_MINIMUM = 8
"""Below, an interval of Student's t says little: with 3 pairs it is 2.5 standard deviations wide to each side."""


LARGEST = 1e100
"""Nothing that is measured is so large, and sums of such squares still are numbers."""


def mean_value(values: Sequence[float]) -> float | int | None:
    """Return the mean as it is written; None for no values, and where one is beyond `LARGEST`."""
    if not values or max(map(abs, values)) > LARGEST:
        return None
    mean = round_significant(fmean(values))
    return int(mean) if mean is not None and all(map(float.is_integer, values)) and mean == int(mean) else mean


def mean_interval(changes: Sequence[float]) -> tuple[float, float] | None:
    """Return the 95 % interval of the mean, None for fewer than `PAIRS_MINIMUM`.

    Parameters
    ----------
    changes : sequence of float
        One for each pair, independent and roughly normal.
    """
    if len(changes) < PAIRS_MINIMUM:
        return None
    middle = mean(changes)
    half = student_t(len(changes) - 1) * stdev(changes) / math.sqrt(len(changes))
    return middle - half, middle + half


def student_t(freedom: int) -> float:
    """Return the 97.5 % quantile of Student's t with `freedom` degrees of freedom, 7 or more, to four digits.

    Source: Abramowitz and Stegun, Handbook of Mathematical Functions (1964), 26.7.5. The library that has it takes
    longer to import than all else that a comparison does.
    """
    x = NormalDist().inv_cdf(0.975)
    terms = (
        (x**3 + x) / 4,
        (5 * x**5 + 16 * x**3 + 3 * x) / 96,
        (3 * x**7 + 19 * x**5 + 17 * x**3 - 15 * x) / 384,
        (79 * x**9 + 776 * x**7 + 1482 * x**5 - 1920 * x**3 - 945 * x) / 92160,
    )
    return x + math.fsum(term / freedom**power for power, term in enumerate(terms, start=1))


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
