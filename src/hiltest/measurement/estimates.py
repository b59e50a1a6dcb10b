"""A number over random instances, and its confidence interval."""

from __future__ import annotations

import math
from collections.abc import Iterable
from dataclasses import dataclass

from scipy.stats import binom

from hiltest.text import hundredths

CONFIDENCE = 0.95


@dataclass(frozen=True, slots=True)
class Estimate:
    """A number over random instances, and the interval that contains the true one, at 95 % confidence unless stated."""

    value: float
    low: float | None
    high: float | None
    """None if the instances are too few for an end."""

    @property
    def interval(self) -> str:
        """The interval in words; too few instances leave an end open."""
        low, high = ("" if end is None else hundredths(end) for end in (self.low, self.high))
        if low and high:
            return f"{low} to {high}"
        return f"at least {low}" if low else f"at most {high}" if high else "too few instances for an interval"

    def __str__(self) -> str:
        return f"{hundredths(self.value)} ({self.interval})"

    def rounded(self, digits: int) -> Estimate:
        """Return the same with this many decimals."""
        low, high = (None if end is None else round(end, digits) for end in (self.low, self.high))
        return Estimate(round(self.value, digits), low, high)


def fewest_for_upper_end(share: float, confidence: float = CONFIDENCE) -> int:
    """Return the smallest number of values whose `quantile` has an upper end."""
    return math.ceil(math.log((1 - confidence) / 2) / math.log(share))


def quantile(values: Iterable[float], share: float, confidence: float = CONFIDENCE) -> Estimate:
    """Return a quantile with its interval from order statistics.

    Parameters
    ----------
    values
        At least one.

    Notes
    -----
    The number of values below the true quantile has a binomial distribution, whatever that of the values is (David and
    Nagaraja, Order Statistics, 2003, section 7.1). So the interval also holds for errors with heavy tails.
    """
    ordered = sorted(map(float, values))
    count = len(ordered)
    low, high = (int(binom.ppf(tail, count, share)) for tail in ((1 - confidence) / 2, (1 + confidence) / 2))
    return Estimate(
        ordered[max(math.ceil(share * count), 1) - 1],
        ordered[low - 1] if low >= 1 else None,
        ordered[high] if high < count else None,
    )
