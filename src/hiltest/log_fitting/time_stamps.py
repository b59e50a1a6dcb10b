"""Sampling rate of a log's time stamps, and gaps.

Stamps are arrival times at a computer: late, or several at once in a packet. This is jitter. Samples are missing after
a delay that later samples do not make up for.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

Reals = NDArray[np.float64]

#: Multiple of the usual wait above which a step may be a gap.
GAP = 1.5
# Longest wait: packets and a clock of whole seconds are more frequent; a sensor that is switched off is not.
_LONGEST_WAIT_S = 2.0
_FEWEST_WAITS = 10
# Shortest wait: faster samples have their time in another unit.
_SHORTEST_WAIT_S = 1e-6
# Time in which late samples catch up: this many waits, plus twice the step.
_CATCH_UP = 10


def gaps(time_s: Reals) -> NDArray[np.int64]:
    """Return the samples before which some are missing.

    Parameters
    ----------
    time_s : shape (n,)
        Times, not decreasing.

    Notes
    -----
    After a gap all stamps are late relative to the samples before it; after a late sample they soon are not. So the
    minima of stamps minus even ones before and after a long step are compared: a difference above half a wait is a gap.
    The loss of a single sample in a packet is smaller, and not detected.
    """
    steps_s = np.diff(time_s)
    wait_s = _usual_wait_s(steps_s)
    long = np.flatnonzero(steps_s > GAP * wait_s) + 1
    if not len(long) or wait_s < _SHORTEST_WAIT_S:
        return np.zeros(0, dtype=np.int64)
    period_s = _period_s(time_s, wait_s)
    gap_places = _not_caught_up(time_s, long, wait_s, period_s)
    # The parts between gaps determine the period far better.
    edges = np.concatenate([[0], gap_places, [len(time_s)]])
    passed_s = time_s[edges[1:] - 1] - time_s[edges[:-1]]
    period_s = float(passed_s.sum()) / max(1, len(time_s) - len(edges) + 1) or period_s
    return _not_caught_up(time_s, long, wait_s, period_s)


def even_stamps(time_s: Reals) -> tuple[float, float]:
    """Return the rate of a part without gaps [Hz], and the largest deviation of its stamps from an even rate [s].

    The rate is the slope of the line through all stamps, because in bursts the first and the last are inaccurate.
    """
    number = np.arange(len(time_s)) - 0.5 * (len(time_s) - 1)
    since_s = time_s - time_s.mean()
    period_s = float(number @ since_s / (number @ number))
    return 1.0 / period_s, float(np.abs(since_s - period_s * number).max())


def _usual_wait_s(steps_s: Reals) -> float:
    """Return the usual wait until another stamp; for bursts, from one to the next."""
    waits_s = steps_s[(steps_s > GAP * np.percentile(steps_s, 25)) & (steps_s <= _LONGEST_WAIT_S)]
    passed_s = steps_s[steps_s <= _LONGEST_WAIT_S].sum()
    in_bursts = len(waits_s) >= _FEWEST_WAITS and waits_s.sum() > 0.5 * passed_s
    return float(np.median(waits_s if in_bursts else steps_s))


def _period_s(time_s: Reals, wait_s: float) -> float:
    """Return the approximate time between samples: from the lower quartile of ten-wait sums, which has no gap."""
    steps_s = np.diff(time_s)
    usual = steps_s[steps_s <= GAP * wait_s]
    together = min(len(steps_s), max(_CATCH_UP, round(_CATCH_UP * wait_s * len(usual) / max(usual.sum(), wait_s))))
    return float(np.percentile(time_s[together:] - time_s[:-together], 25)) / together or wait_s


def _not_caught_up(time_s: Reals, long: NDArray[np.int64], wait_s: float, period_s: float) -> NDArray[np.int64]:
    n = len(time_s)
    late_s = time_s - period_s * np.arange(n)
    usual = round(min(n, _CATCH_UP * wait_s / period_s)) + 1
    places, last = [], 0
    for at in long.tolist():
        behind = usual + round(min(n, 2.0 * (time_s[at] - time_s[at - 1]) / period_s))
        before = max(last, at - usual)
        if late_s[at : at + behind].min() - late_s[before:at].min() > (GAP - 1.0) * wait_s:
            places.append(at)
            last = at
    return np.array(places, dtype=np.int64)
