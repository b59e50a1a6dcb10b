"""Noise between the two sides of a comparison, and the smallest change that is seen through it.

Two firmwares on one seed of a virtual board read the same noise: their runs are paired, and only what the changes
differ by from seed to seed is noise. On a real board every run has noise of its own.

Whether a mean change is more than noise is Student's test. What the test sees follows from the noncentral t
distribution, here with the tolerance beside it: a change counts only beyond both.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cache
from statistics import fmean, mean, stdev
from typing import Any

from hiltest.measurement import Deviation

FALSE_ALARMS = 0.005
"""Share of comparisons of unchanged firmware that may call anything changed; its measurements share it equally.

Of the 1 in 100 that is allowed half is kept back, for errors are not normal: they are more often far too large than far
too small. Between 56 seeds of the default rig, eight runs against one, 0.01 called 20 of 1500 worse.
"""

SEEN = 0.8
"""A change that is seen in this share of comparisons is what a comparison is said to see: in 4 of 5."""

PAIRS_MINIMUM = 8
"""Below, an interval of Student's t says little: with 3 pairs it is 2.5 standard deviations wide to each side."""

FREEDOM_MINIMUM = 4
"""Below, as with two runs against two, the test of one among 100 measurements needs 30 deviations and more."""

_RUNS_AT_MOST = 100_000
_FAR = 5.0
_QUANTILES = 100
_PRECISION = 1e-4


@dataclass(frozen=True, slots=True)
class Noise:
    """Noise of a mean change."""

    deviation: float
    """Standard deviation of one run, or of one paired change; above 0."""
    freedom: int
    """Degrees of freedom that it was estimated with; 0 where it is only assumed."""
    spread: float
    """Standard error of the mean change, in deviations."""
    of_these_runs: bool = True
    """Whether it was estimated from the runs that are compared, so that another comparison would have another."""
    tested: bool = True
    """False for few pairs, where the tolerance alone decides."""

    @property
    def error(self) -> float:
        """Standard error of the mean change."""
        return self.deviation * self.spread

    def reaches(self, floor: float) -> bool:
        """Say whether noise alone could ever carry the mean change beyond a tolerance."""
        return self.tested and _FAR * self.error > floor


def paired(changes: Sequence[float]) -> Noise | None:
    """Return the noise of runs that are paired by seed, None for one pair and where every pair moved alike."""
    pairs = len(changes)
    if pairs < 2 or not (deviation := stdev(changes)):
        return None
    return Noise(deviation, pairs - 1, 1.0 / math.sqrt(pairs), tested=pairs >= PAIRS_MINIMUM)


def unpaired(base: Sequence[float], new: Sequence[float], known: Deviation | None) -> Noise | None:
    """Return the noise between runs that share none, None where there is none.

    Parameters
    ----------
    base, new
        At least one run each.
    known
        That of the default rig, where these are too few runs to say. A larger one of theirs is taken all the same.
    """
    spread = math.sqrt(1.0 / len(base) + 1.0 / len(new))
    found, of_these = of_runs((base, new), known)
    return Noise(found.value, found.freedom, spread, of_these_runs=of_these) if found else None


def of_runs(sides: Sequence[Sequence[float]], known: Deviation | None) -> tuple[Deviation | None, bool]:
    """Return how much runs of one firmware differ, None where they do not, and whether these runs say so themselves.

    Parameters
    ----------
    sides
        Runs of one firmware each.
    known
        As for `unpaired`.
    """
    freedom = sum(len(side) - 1 for side in sides)
    squares = math.fsum((each - fmean(side)) ** 2 for side in sides for each in side)
    own = math.sqrt(squares / freedom) if freedom else 0.0
    if freedom < FREEDOM_MINIMUM and known is not None:
        return Deviation(max(own, known.value), known.freedom), False
    return (Deviation(own, freedom), True) if own else (None, True)


def half_width(noise: Noise, share: float) -> float:
    """Return how far noise alone moves the mean: all but this share of unchanged firmware stays within."""
    return _t_quantile(noise.freedom, share) * noise.error if noise.tested else 0.0


def mean_interval(changes: Sequence[float]) -> tuple[float, float] | None:
    """Return the 95 % interval of the mean of paired changes, None for fewer than `PAIRS_MINIMUM`."""
    if len(changes) < PAIRS_MINIMUM:
        return None
    noise, middle = paired(changes), mean(changes)
    half = half_width(noise, 0.05) if noise else 0.0
    return middle - half, middle + half


def smallest_seen(noise: Noise | None, floor: float, share: float) -> float:
    """Return the smallest change that a comparison sees in 4 of 5 cases.

    Parameters
    ----------
    noise
        None where every change beyond the tolerance is seen.
    floor
        The tolerance.
    share
        Share of comparisons of unchanged firmware that may call this measurement changed.
    """
    if noise is None:
        return floor
    low, high = 0.0, floor + noise.error
    while chance_seen(noise, floor, share, high) < SEEN:
        low, high = high, 2.0 * high
    while high - low > _PRECISION * high:
        middle = (low + high) / 2.0
        low, high = (low, middle) if chance_seen(noise, floor, share, middle) >= SEEN else (middle, high)
    return high


def chance_seen(noise: Noise, floor: float, share: float, size: float) -> float:
    """Return the chance that a change of this size is called.

    Notes
    -----
    The mean change is normal, the deviation that a comparison estimates is that of chi: of their ratio, beyond the
    quantile of t, it is the noncentral t distribution, which knows no tolerance. So the chance is taken at equally
    likely deviations, and averaged.
    """
    from scipy.special import ndtr, stdtr

    critical = half_width(noise, share)
    if not critical:
        return float(ndtr((size - floor) / noise.error))
    if not noise.of_these_runs:
        return float(stdtr(noise.freedom, (size - max(floor, critical)) / noise.error))
    import numpy as np

    return float(np.mean(ndtr((size - np.maximum(floor, critical * _deviations(noise.freedom))) / noise.error)))


def runs_a_side(deviation: float, floor: float, share: float, size: float) -> int | None:
    """Return how many runs each side needs on a board with noise of its own; None where no number is enough."""
    if size <= floor:
        return None
    least = FREEDOM_MINIMUM // 2 + 1  # those that say themselves how much noise they have

    def enough(runs: int) -> bool:
        return chance_seen(Noise(deviation, 2 * runs - 2, math.sqrt(2.0 / runs)), floor, share, size) >= SEEN

    return _smallest(enough, least) if deviation else 1


def seeds_needed(deviation: float, floor: float, share: float, size: float) -> int | None:
    """Return how many seeds a virtual board needs, where paired changes have this deviation; as `runs_a_side`."""
    if size <= floor:
        return None

    def enough(seeds: int) -> bool:
        noise = Noise(deviation, seeds - 1, 1.0 / math.sqrt(seeds), tested=seeds >= PAIRS_MINIMUM)
        return chance_seen(noise, floor, share, size) >= SEEN and (noise.tested or not _alarms(noise, floor, share))

    few = next((seeds for seeds in range(1, PAIRS_MINIMUM) if enough(seeds)), None) if deviation else 1
    return few or _smallest(enough, PAIRS_MINIMUM)


def _alarms(noise: Noise, floor: float, share: float) -> bool:
    """Say whether the tolerance alone lets noise call more than its share of unchanged firmware."""
    from scipy.special import ndtr

    return bool(2.0 * ndtr(-floor / noise.error) > share)


def _smallest(enough: Any, least: int) -> int | None:
    """Return the smallest number from `least` up that is enough, None beyond `_RUNS_AT_MOST`."""
    high = least
    while not enough(high):
        if high >= _RUNS_AT_MOST:
            return None
        least, high = high + 1, min(2 * high, _RUNS_AT_MOST)
    while least < high:
        middle = (least + high) // 2
        least, high = (least, middle) if enough(middle) else (middle + 1, high)
    return high


@cache
def _t_quantile(freedom: int, share: float) -> float:
    """Return what Student's t is beyond, to both sides together, in this share of cases."""
    from scipy.special import stdtrit

    return float(stdtrit(freedom, 1.0 - share / 2.0))


@cache
def _deviations(freedom: int) -> Any:
    """Return equally likely estimates of a deviation of 1."""
    import numpy as np
    from scipy.special import chdtri

    return np.sqrt(chdtri(freedom, (np.arange(_QUANTILES) + 0.5) / _QUANTILES) / freedom)
