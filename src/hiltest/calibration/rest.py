"""Test of whether a gyroscope was at rest: its rate changes by no more than its noise."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

Reals = NDArray[np.float64]

# Lengths of windows: a knock lasts a tenth of a second; a slow motion shows in a second.
_WINDOWS_S = (0.1, 1.0)
# Largest change in deviations of the noise: it is 5 among a million changes of Gaussian noise. A motion that a second
# does not show adds less than 2 * 10^2 N^2 / T to a variance of N^2: a twentieth in an hour's log.
_MOVED = 10.0
# The lower quartile of the changes' sizes is noise in a log that rested for half of its time; this is its ratio to the
# deviation for a normal distribution.
_QUARTILE, _OF_DEVIATION = 25.0, 0.3186


@dataclass(frozen=True, slots=True)
class Motion:
    """The first motion in a log."""

    start: int
    """First sample of the window that shows it."""
    axis: int
    change: float
    """Change from the mean of the previous window, in the unit of the log."""
    samples: int
    """Length of the windows."""
    times: float
    """Size of the change in deviations of the noise."""
    rest: tuple[int, int]
    """Longest part without a motion: its first sample, and the first one after it."""


def first_motion(rates: Reals, *, rate_hz: float) -> Motion | None:
    """Return the first motion in a log; None without one.

    Parameters
    ----------
    rates : shape (n, axes)

    Notes
    -----
    The means of neighbouring windows differ by noise, and hardly by drift. They are compared with all differences of
    the log, so that the log's own noise decides; a log that moved for more than half of its time is not detected.
    """
    windows = sorted({max(1, round(seconds * rate_hz)) for seconds in _WINDOWS_S})
    moved = {size: _changes(rates, size) for size in windows if len(rates) >= 3 * size}
    starts = [
        (int(np.argmax(times.max(axis=1) > _MOVED)), size)
        for size, (_, times) in moved.items()
        if (times > _MOVED).any()
    ]
    if not starts:
        return None
    # If two window lengths show the same motion, the shorter one determines its start.
    before, size = min(starts, key=lambda start: (start[0] + 2) * start[1])
    changes, times = moved[size]
    axis = int(np.argmax(times[before]))
    return Motion(
        (before + 1) * size,
        axis,
        float(changes[before, axis]),
        size,
        float(times[before, axis]),
        _longest_rest(len(rates), moved),
    )


def density_of_changes(rates: Reals, *, rate_hz: float) -> Reals:
    """Return the one-sided noise density of each axis that the changes from second to second have, shape (axes,).

    Parameters
    ----------
    rates : shape (n, axes)
        In any unit; the density is in it over sqrt(Hz). For less than three seconds changes of a tenth count, and
        the density is zero if there are fewer than three of these.

    Notes
    -----
    White noise of density d makes means over T differ by ``d / sqrt(T)``. A motion that lasts for all of the log makes
    its own "noise", which only an absolute limit of this density detects.
    """
    for seconds in reversed(_WINDOWS_S):
        size = max(1, round(seconds * rate_hz))
        if len(rates) >= 3 * size:
            noise = np.percentile(np.abs(_mean_changes(rates, size)), _QUARTILE, axis=0) / _OF_DEVIATION
            return np.asarray(noise * np.sqrt(size / rate_hz))
    return np.zeros(rates.shape[1])


def _mean_changes(rates: Reals, size: int) -> Reals:
    count = len(rates) // size
    changes: Reals = np.diff(rates[: count * size].reshape(count, size, -1).mean(axis=1), axis=0)
    return changes


def _changes(rates: Reals, size: int) -> tuple[Reals, Reals]:
    """Return the changes between the means of neighbouring windows, and their sizes in deviations of the noise."""
    changes = _mean_changes(rates, size)
    noise = np.percentile(np.abs(changes), _QUARTILE, axis=0) / _OF_DEVIATION
    # If nearly all readings are equal the quartile is zero, but one step of the converter in a window is not a motion.
    steps = np.abs(np.diff(rates, axis=0))
    steps[steps == 0.0] = np.inf
    with np.errstate(over="ignore"):
        return changes, np.abs(changes) / np.maximum(noise, steps.min(axis=0) / size)


def _longest_rest(n: int, moved: Mapping[int, tuple[Reals, Reals]]) -> tuple[int, int]:
    at_rest = np.ones(n + 2, dtype=np.int8)
    at_rest[[0, -1]] = 0
    for size, (_, times) in moved.items():
        for before in np.flatnonzero(times.max(axis=1) > _MOVED).tolist():
            at_rest[1 + before * size : 1 + (before + 2) * size] = 0
    edges = np.diff(at_rest)
    starts, ends = np.flatnonzero(edges == 1), np.flatnonzero(edges == -1)
    return max(zip(starts.tolist(), ends.tolist(), strict=True), key=lambda part: part[1] - part[0], default=(0, 0))
