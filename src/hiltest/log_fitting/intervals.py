"""Rests and turns in a log: detected in the readings, or annotated."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from hiltest.budgets import INTERVALS
from hiltest.errors import ConfigError
from hiltest.json_files import read_json
from hiltest.log_fitting.imu_log import ImuLog
from hiltest.measurement.units import DEGREES_PER_SECOND, GRAVITIES

Reals = NDArray[np.float64]

# Length of a window: the mean of a shorter rest has too much noise.
_WINDOW_S = 1.0
# The quietest tenth of all windows is at rest; a spread larger by this factor is motion. With 100 samples the spread of
# noise scatters by 7 %; in the tested logs, the smallest motion is 20 times the noise.
_QUIETEST = 10.0
_MOTION = 2.5
# Absolute limits, because a log without a rest has a quietest tenth too. Noise and a table's vibrations are below
# these; a hand-held or turning sensor is above. For counts, the limit is relative to the range of the log.
_RESTLESS_G = 0.03
_RESTLESS_DPS = 3.0
_RESTLESS_PART = 0.05
# Lower bound of the noise relative to it: a log without noise only has rounding.
_ROUNDING = 1e-4
# A steady turn has no spread: it is detected if its mean rate is off by more than this many spreads of the noise. A
# bias drifts by less.
_TURNING = 5.0
# Words in the names of annotated turns.
_TURN_WORDS = ("rot", "turn")


@dataclass(frozen=True, slots=True)
class Interval:
    """Samples `start` to `end` - 1 of a log, and its name; empty if it was detected."""

    start: int
    end: int
    name: str = ""


@dataclass(frozen=True, slots=True)
class Intervals:
    """Rests and motions of a log."""

    rests: tuple[Interval, ...]
    """Rests in the order of time."""
    motions: tuple[Interval, ...]
    """Motions between two detected rests, or annotated turns."""
    found: bool
    """True if they were detected in the readings; otherwise they are annotations."""


def found_intervals(log: ImuLog, *, rest_rate: Reals | None = None) -> Intervals:
    """Detect the rests of a log: intervals of at least a second in which neither sensor moves.

    Parameters
    ----------
    rest_rate : shape (3,)
        Reading of the gyroscope at rest; by default its median over windows without spread.

    Raises
    ------
    ConfigError
        When the log is shorter than a few seconds.
    """
    window = max(2, round(_WINDOW_S / log.period_s))
    if len(log.time_s) < 3 * window:
        raise ConfigError(
            f"{log.files[0]}: {len(log.time_s)} samples, {log.time_s[-1] - log.time_s[0]:.1f} s: "
            "too short for rests of one second"
        )
    still = np.ones(len(log.time_s) - window + 1, dtype=np.bool_)
    if len(log.acceleration):
        _, spread = _windows(log.acceleration, window)
        still &= _still(spread, _restless(GRAVITIES[log.acceleration_unit], _RESTLESS_G, log.acceleration))
    if log.rate is not None:
        rate, noise = _windows(log.rate, window)
        restless = _restless(DEGREES_PER_SECOND[log.rate_unit], _RESTLESS_DPS, log.rate)
        still &= _still(noise, restless)
        if still.any():
            off = np.linalg.norm(rate - (np.median(rate[still], axis=0) if rest_rate is None else rest_rate), axis=1)
            still &= off <= _TURNING * _quiet(noise, restless)
    at_rest = np.zeros(len(log.time_s) + 2, dtype=np.int8)
    for first in np.flatnonzero(still).tolist():
        at_rest[first + 1 : first + 1 + window] = 1
    edges = np.diff(at_rest)
    begins, ends = np.flatnonzero(edges == 1).tolist(), np.flatnonzero(edges == -1).tolist()
    rests = tuple(Interval(begin, end) for begin, end in zip(begins, ends, strict=True))
    motions = tuple(Interval(before.end, after.start) for before, after in pairwise(rests))
    return Intervals(rests, motions, found=True)


def listed_intervals(log: ImuLog, path: Path) -> Intervals:
    """Read annotations: a JSON object of names, each with its first sample and the one after its last.

    Names with ``rot`` or ``turn`` in them are turns, all others rests: ``{"x_p": {"start": 540, "end": 1271}, ...}``.

    Raises
    ------
    ConfigError
        When the file is invalid, or a sample is not in the log.
    """
    parsed = read_json(path, budget=INTERVALS, otherwise="name a list of intervals (JSON)").content
    if not isinstance(parsed, dict) or not parsed:
        raise ConfigError(f'{path}: no list of intervals; write {{"x_up": {{"start": 540, "end": 1271}}, ...}}')
    return _name_intervals([_interval_entry(log, path, name, entry) for name, entry in parsed.items()])


def labelled_intervals(log: ImuLog) -> Intervals:
    """Read the intervals from the log's column of labels: a run of rows with the same label is one interval."""
    labels = np.array(log.labels or (), dtype=object)
    edges = [0, *(np.flatnonzero(labels[1:] != labels[:-1]) + 1).tolist(), len(labels)]
    return _name_intervals([Interval(first, last, str(labels[first])) for first, last in pairwise(edges)])


def _interval_entry(log: ImuLog, path: Path, name: str, entry: object) -> Interval:
    start, end = (entry.get("start"), entry.get("end")) if isinstance(entry, dict) else (None, None)
    if not isinstance(start, int) or not isinstance(end, int):
        raise ConfigError(f"{path}: {name}: needs start and end, two numbers of samples")
    if not 0 <= start < end <= len(log.time_s):
        raise ConfigError(f"{path}: {name}: samples {start} to {end} are not in a log of {len(log.time_s)}")
    return Interval(start, end, name)


def _name_intervals(intervals: Sequence[Interval]) -> Intervals:
    turns: list[Interval] = []
    rests: list[Interval] = []
    for interval in intervals:
        (turns if any(word in interval.name.lower() for word in _TURN_WORDS) else rests).append(interval)
    return Intervals(tuple(sorted(rests, key=lambda rest: rest.start)), tuple(turns), found=False)


def _still(spread: Reals, restless: float) -> NDArray[np.bool_]:
    quiet = _quiet(spread, restless)
    return spread <= (_MOTION * quiet if quiet < restless else -1.0)


def _quiet(spread: Reals, restless: float) -> float:
    return max(float(np.percentile(spread, _QUIETEST)), _ROUNDING * restless)


def _restless(unit: float | None, limit: float, values: Reals) -> float:
    """Return the upper limit of a rest's spread, in the unit of the values."""
    if unit is not None:
        return limit / unit
    return _RESTLESS_PART * float(np.linalg.norm(values - np.median(values, axis=0), axis=1).max())


def _windows(values: Reals, window: int) -> tuple[Reals, Reals]:
    """Return mean, shape (k, 3), and spread over all axes, shape (k,), of every run of `window` samples."""
    centred = values - values.mean(axis=0)
    sums = np.cumsum(np.vstack([np.zeros(3), centred]), axis=0)
    squares = np.cumsum(np.vstack([np.zeros(3), centred * centred]), axis=0)
    mean: Reals = (sums[window:] - sums[:-window]) / window
    variance = (squares[window:] - squares[:-window]) / window - mean * mean
    return mean + values.mean(axis=0), np.sqrt(np.maximum(variance, 0.0).sum(axis=1))
