"""The rate of sampling behind a log's time stamps, and where samples are missing.

Stamps are as a computer sees samples arrive: late, or some at once as a packet brings them. That is jitter. Samples are
missing where time passes that those behind do not make up for.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

Reals = NDArray[np.float64]

#: A step longer than so many usual waits may be a gap.
GAP = 1.5
# Packets and a clock of whole seconds come more often; what is switched on and off does not.
_LONGEST_WAIT_S = 2.0
_FEWEST_WAITS = 10
# What comes faster has its time in another unit.
_SHORTEST_WAIT_S = 1e-6
# So many waits, and twice the step, are what late samples take to catch up.
_CATCH_UP = 10


def gaps(time_s: Reals) -> NDArray[np.int64]:
    """Return the samples before which some are missing.

    Parameters
    ----------
    time_s : shape (n,)
        Not decreasing.

    Notes
    -----
    Behind a gap every stamp is later than by the samples before it; behind a late sample they soon are not. So of the
    stamps less the even ones the least before and behind a long step are compared: more than half a wait is a gap. A
    single sample that is lost out of a packet is less, and not seen.
    """
    steps_s = np.diff(time_s)
    wait_s = _usual_wait_s(steps_s)
    long = np.flatnonzero(steps_s > GAP * wait_s) + 1
    if not len(long) or wait_s < _SHORTEST_WAIT_S:
        return np.zeros(0, dtype=np.int64)
    period_s = _period_s(time_s, wait_s)
    found = _not_caught_up(time_s, long, wait_s, period_s)
    # By the parts between, the period is known far better.
    edges = np.concatenate([[0], found, [len(time_s)]])
    passed_s = time_s[edges[1:] - 1] - time_s[edges[:-1]]
    period_s = float(passed_s.sum()) / max(1, len(time_s) - len(edges) + 1) or period_s
    return _not_caught_up(time_s, long, wait_s, period_s)


def even_stamps(time_s: Reals) -> tuple[float, float]:
    """Return the rate of a part without gaps [Hz], and by how much its stamps are off an even rate at most [s].

    The rate is that of the straight line through all stamps: in bursts the first and the last say little.
    """
    number = np.arange(len(time_s)) - 0.5 * (len(time_s) - 1)
    since_s = time_s - time_s.mean()
    period_s = float(number @ since_s / (number @ number))
    return 1.0 / period_s, float(np.abs(since_s - period_s * number).max())


def _usual_wait_s(steps_s: Reals) -> float:
    """Return how long it usually is until another stamp; of bursts, from one to the next."""
    waits_s = steps_s[(steps_s > GAP * np.percentile(steps_s, 25)) & (steps_s <= _LONGEST_WAIT_S)]
    passed_s = steps_s[steps_s <= _LONGEST_WAIT_S].sum()
    in_bursts = len(waits_s) >= _FEWEST_WAITS and waits_s.sum() > 0.5 * passed_s
    return float(np.median(waits_s if in_bursts else steps_s))


def _period_s(time_s: Reals, wait_s: float) -> float:
    """Return roughly the time between samples: of ten waits together, the lower quartile, which has no gap in it."""
    steps_s = np.diff(time_s)
    usual = steps_s[steps_s <= GAP * wait_s]
    together = min(len(steps_s), max(_CATCH_UP, round(_CATCH_UP * wait_s * len(usual) / max(usual.sum(), wait_s))))
    return float(np.percentile(time_s[together:] - time_s[:-together], 25)) / together or wait_s


def _not_caught_up(time_s: Reals, long: NDArray[np.int64], wait_s: float, period_s: float) -> NDArray[np.int64]:
    n = len(time_s)
    late_s = time_s - period_s * np.arange(n)
    usual = round(min(n, _CATCH_UP * wait_s / period_s)) + 1
    found, last = [], 0
    for at in long.tolist():
        behind = usual + round(min(n, 2.0 * (time_s[at] - time_s[at - 1]) / period_s))
        before = max(last, at - usual)
        if late_s[at : at + behind].min() - late_s[before:at].min() > (GAP - 1.0) * wait_s:
            found.append(at)
            last = at
    return np.array(found, dtype=np.int64)
