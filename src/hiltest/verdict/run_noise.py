"""Noise between the two sides of a comparison, and the smallest change that is detected through it.

Two firmwares on one seed of a virtual board read the same noise: their runs are paired, and only the scatter of the
changes from seed to seed is noise. On a real board every run has noise of its own.

Student's test decides if a mean change is more than noise. Its power follows from the noncentral t
distribution, combined with the tolerance: a change counts only beyond both.
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
"""Fraction of comparisons of unchanged firmware that may call anything changed; measurements share it equally.

Half of the allowed 1 in 100 is held in reserve, since errors are not normal: they are more often far too large than far
too small. Between 56 seeds of the default rig, eight runs against one, 0.01 called 20 of 1500 worse.
"""

SEEN = 0.8
"""A comparison detects a change if it calls the change in this fraction of cases: in 4 of 5."""

PAIRS_MINIMUM = 8
"""Minimum number of pairs: with 3 pairs Student's interval is 2.5 standard deviations wide to each side."""

FREEDOM_MINIMUM = 4
"""Minimum degrees of freedom: two runs against two need 30 deviations and more for one of 100 measurements."""

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
    """Degrees of freedom of the estimate; 0 if it is only assumed."""
    spread: float
    """Standard error of the mean change, in deviations."""
    of_these_runs: bool = True
    """True if it was estimated from the compared runs, so that another comparison would have another estimate."""
    tested: bool = True
    """False for few pairs: the tolerance alone then decides."""

    @property
    def error(self) -> float:
        """Standard error of the mean change."""
        return self.deviation * self.spread

    def reaches(self, floor: float) -> bool:
        """Return whether noise alone could ever move the mean change beyond a tolerance."""
        return self.tested and _FAR * self.error > floor


def paired(changes: Sequence[float]) -> Noise | None:
    """Return the noise of runs that are paired by seed; None for one pair and if every pair moved alike."""
    pairs = len(changes)
    if pairs < 2 or not (deviation := stdev(changes)):
        return None
    return Noise(deviation, pairs - 1, 1.0 / math.sqrt(pairs), tested=pairs >= PAIRS_MINIMUM)


def unpaired(base: Sequence[float], new: Sequence[float], default: Deviation | None) -> Noise | None:
    """Return the noise between unpaired runs; None without noise.

    Parameters
    ----------
    base, new
        At least one run each.
    default
        Deviation on the default rig, used if there are too few runs; a larger deviation of the runs takes precedence.
    """
    spread = math.sqrt(1.0 / len(base) + 1.0 / len(new))
    deviation, of_these = deviation_of_runs((base, new), default)
    return Noise(deviation.value, deviation.freedom, spread, of_these_runs=of_these) if deviation else None


def deviation_of_runs(sides: Sequence[Sequence[float]], default: Deviation | None) -> tuple[Deviation | None, bool]:
    """Return the deviation between runs of one firmware, None without one, and whether it was estimated from them.

    Parameters
    ----------
    sides
        Runs of one firmware per side.
    default
        Deviation as for `unpaired`.
    """
    freedom = sum(len(side) - 1 for side in sides)
    squares = math.fsum((value - fmean(side)) ** 2 for side in sides for value in side)
    own = math.sqrt(squares / freedom) if freedom else 0.0
    if freedom < FREEDOM_MINIMUM and default is not None:
        return Deviation(max(own, default.value), default.freedom), False
    return (Deviation(own, freedom), True) if own else (None, True)


def half_width(noise: Noise, share: float) -> float:
    """Return the bound within which the mean of all but this fraction of unchanged firmware stays."""
    return _t_quantile(noise.freedom, share) * noise.error if noise.tested else 0.0


def mean_interval(changes: Sequence[float]) -> tuple[float, float] | None:
    """Return the 95 % interval of the mean of paired changes; None for fewer than `PAIRS_MINIMUM`."""
    if len(changes) < PAIRS_MINIMUM:
        return None
    noise, middle = paired(changes), mean(changes)
    half = half_width(noise, 0.05) if noise else 0.0
    return middle - half, middle + half


def smallest_seen(noise: Noise | None, floor: float, share: float) -> float:
    """Return the smallest change that a comparison detects in 4 of 5 cases.

    Parameters
    ----------
    noise
        Noise of the mean change; None if every change beyond the tolerance is detected.
    floor
        Tolerance in the measurement's unit.
    share
        Fraction of comparisons of unchanged firmware that may call this measurement changed.
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
    """Return the probability that a change of this size is called.

    Notes
    -----
    The mean change is normal, and the estimated deviation follows a chi distribution: the probability that their ratio
    exceeds the quantile of t follows the noncentral t distribution, which knows no tolerance. So the probability is
    computed at equally likely deviations and averaged.
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
    """Return the number of runs per side on a board with noise of its own; None if no number is enough."""
    if size <= floor:
        return None
    least = FREEDOM_MINIMUM // 2 + 1  # the fewest runs that allow an estimate of their own noise

    def enough(runs: int) -> bool:
        return chance_seen(Noise(deviation, 2 * runs - 2, math.sqrt(2.0 / runs)), floor, share, size) >= SEEN

    return _smallest(enough, least) if deviation else 1


def seeds_needed(deviation: float, floor: float, share: float, size: float) -> int | None:
    """Return the number of seeds on a virtual board whose paired changes have this deviation, as `runs_a_side` does."""
    if size <= floor:
        return None

    def enough(seeds: int) -> bool:
        noise = Noise(deviation, seeds - 1, 1.0 / math.sqrt(seeds), tested=seeds >= PAIRS_MINIMUM)
        return chance_seen(noise, floor, share, size) >= SEEN and (
            noise.tested or not _alarms_too_often(noise, floor, share)
        )

    few = next((seeds for seeds in range(1, PAIRS_MINIMUM) if enough(seeds)), None) if deviation else 1
    return few or _smallest(enough, PAIRS_MINIMUM)


def _alarms_too_often(noise: Noise, floor: float, share: float) -> bool:
    """Return whether the tolerance alone lets noise call more than its share of unchanged firmware."""
    from scipy.special import ndtr

    return bool(2.0 * ndtr(-floor / noise.error) > share)


def _smallest(enough: Any, least: int) -> int | None:
    """Return the smallest number from `least` up that is enough; None beyond `_RUNS_AT_MOST`."""
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
    """Return the two-sided quantile of Student's t that is exceeded in this fraction of cases."""
    from scipy.special import stdtrit

    return float(stdtrit(freedom, 1.0 - share / 2.0))


@cache
def _deviations(freedom: int) -> Any:
    """Return equally likely estimates of a deviation of 1."""
    import numpy as np
    from scipy.special import chdtri

    return np.sqrt(chdtri(freedom, (np.arange(_QUANTILES) + 0.5) / _QUANTILES) / freedom)
