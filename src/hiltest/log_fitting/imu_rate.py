"""Scales of a gyroscope's axes from a turntable at a known, constant rate."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from hiltest.log_fitting.imu_log import ImuLog
from hiltest.log_fitting.intervals import Interval
from hiltest.measurement.units import DEGREES_PER_SECOND

Reals = NDArray[np.float64]

DPS_PER_RPM = 6.0
# Largest variation of one-second means: a turntable's rate varies by one or two tenths of a percent, an accelerating
# one by more.
_WINDOW_S = 1.0
_STEADY = 0.005
# Allowance for noise in standard errors, which no mean among a few hundred windows exceeds.
_SCATTER = 4.0
# Factor over the quietest tenth above which a spread is motion, as for rests.
_MOTION = 2.5
# Rates below this are noise.
_ABOVE_NOISE = 10.0
# Fraction of the fastest rate above which the table counts as turning.
_TURNS = 0.5
# Largest angle: beyond it, the rate is shared between axes with different scales.
_ALONG_DEG = 15.0
# Largest scale error of an uncalibrated part.
_SCALE = 0.15
# Fraction of readings at the maximum above which the range was exceeded: with noise, few readings are the largest.
_AT_THE_END = 0.5
_AXES = "xyz"


@dataclass(frozen=True, slots=True)
class SteadyRate:
    """A part of a log that turned at the known rate."""

    start_s: float
    end_s: float
    """Interval in the log."""
    reading: tuple[float, float, float]
    """Median of one-second means minus the bias, in the unit of the log."""
    axis: str
    """Nearest axis: x, y or z."""
    askew_deg: float
    """Angle of the reading from that axis."""
    scale: float | None
    """``rate_dps = scale * (reading - bias)`` of that axis; None if it was refused."""
    uncertainty: float
    """Standard uncertainty of the scale, for an exact rate of the turntable."""
    refused: str
    """Reason for the refusal; empty if it was used."""


def steady_parts(log: ImuLog, bias: Reals, *, rpm: float) -> tuple[Interval, ...]:
    """Find the parts of a log with steady rotation, for one revolution or longer.

    Parameters
    ----------
    bias : shape (3,)
        Reading at rest.
    rpm
        Revolutions per minute.

    Returns
    -------
    tuple of Interval
        For each part between two stops, the longest interval in which one-second means stay within 0.5 %.
    """
    if log.rate is None:
        return ()
    size = max(2, round(_WINDOW_S / log.period_s))
    if len(log.rate) < size:
        return ()
    sums = np.cumsum(np.vstack([np.zeros(3), log.rate - bias]), axis=0)
    means = (sums[size:] - sums[:-size]) / size
    speed = np.linalg.norm(means, axis=1)
    turns = speed > _TURNS * float(speed.max())
    parts = []
    for start, end in _runs(turns):
        if end - start < size:
            continue
        level = float(np.median(speed[start:end]))
        noise = float(np.diff(log.rate[start:end], axis=0).std(axis=0).max()) / math.sqrt(2.0)
        if level < _ABOVE_NOISE * noise:
            continue
        steady = np.zeros(len(turns), dtype=np.bool_)
        steady[start:end] = np.abs(speed[start:end] - level) <= _STEADY * level + _SCATTER * noise / math.sqrt(size)
        first, last = max(_runs(steady), key=lambda run: run[1] - run[0], default=(start, start))
        part = Interval(first, last + size - 1)
        if part.end - part.start >= 60.0 / rpm / log.period_s:
            parts.append(part)
    return tuple(parts)


def rest_rate(log: ImuLog, rests: Sequence[Interval] = ()) -> Reals:
    """Return the gyroscope's approximate reading at rest, shape (3,): in its rests, or if it mostly turns.

    In the latter case it is the reading nearest to zero of the quietest seconds; for counts, whose zero is unknown, the
    first of them.
    """
    readings = log.rate
    if readings is None:
        return np.zeros(3)
    if rests:
        return np.asarray(np.concatenate([readings[rest.start : rest.end] for rest in rests]).mean(axis=0))
    size = min(len(readings), max(2, round(_WINDOW_S / log.period_s)))
    windows = readings[: len(readings) // size * size].reshape(-1, size, 3)
    means, spread = windows.mean(axis=1), windows.std(axis=1).max(axis=1)
    quiet = means[spread <= _MOTION * np.percentile(spread, 10)]
    counts = DEGREES_PER_SECOND[log.rate_unit] is None
    return np.asarray(quiet[0 if counts else int(np.argmin(np.linalg.norm(quiet, axis=1)))])


def fit_rates(
    log: ImuLog, parts: Sequence[Interval], rests: Sequence[Interval], bias: Reals, *, rpm: float
) -> tuple[SteadyRate, ...]:
    """Fit the scale of the axis about which each part turned.

    Parameters
    ----------
    parts
        Parts from `steady_parts`.
    rests
        Rests, from which a part's bias is taken.
    bias : shape (3,)
        Bias for parts without a rest.

    Notes
    -----
    The scale is the rate over the length of the reading: a misalignment of some degrees shares the rate among axes with
    similar scales, and the length does not change.
    """
    return tuple(_rate(log, part, rests, bias, DPS_PER_RPM * rpm) for part in parts)


def _rate(log: ImuLog, part: Interval, rests: Sequence[Interval], bias: Reals, rate_dps: float) -> SteadyRate:
    readings = log.rate if log.rate is not None else np.zeros((1, 3))
    beside = neighbouring_rests(part, rests)
    biases = np.array([readings[rest.start : rest.end].mean(axis=0) for rest in beside] or [bias])
    samples = readings[part.start : part.end]
    size = min(len(samples), max(2, round(_WINDOW_S / log.period_s)))
    seconds = samples[: len(samples) // size * size].reshape(-1, size, 3).mean(axis=1)
    # The median, because a table may accelerate for longer than was cut off.
    reading = np.median(seconds, axis=0) - biases.mean(axis=0)
    length = float(np.linalg.norm(reading))
    axis = int(np.argmax(np.abs(reading)))
    askew_deg = math.degrees(math.acos(min(1.0, abs(float(reading[axis])) / length)))
    scale = rate_dps / length
    along = seconds @ (reading / length)
    # The standard error of a median is that of a mean times the root of pi / 2.
    scatter = float(along.std(ddof=1)) * math.sqrt(math.pi / 2.0 / len(along)) if len(along) > 1 else _STEADY * length
    drift = float(np.ptp(biases @ (reading / length))) / 2.0
    farthest = np.abs(samples[:, axis]).max()
    refused = ""
    nominal = DEGREES_PER_SECOND[log.rate_unit]
    if askew_deg > _ALONG_DEG:
        refused = f"it lay {askew_deg:.0f} deg off its {_AXES[axis]} axis: lay it flat on a face"
    elif (np.abs(samples[:, axis]) == farthest).mean() > _AT_THE_END:
        refused = f"{_AXES[axis]} reads {farthest:.6g} at most: the rate is beyond the sensor's range"
    elif nominal is not None and abs(scale / nominal - 1.0) > _SCALE:
        refused = f"it reads {length * nominal:.4g} deg/s where the table turns at {rate_dps:.4g}"
    x, y, z = reading.tolist()
    start_s, end_s = float(log.time_s[part.start]), float(log.time_s[part.end - 1])
    return SteadyRate(
        start_s,
        end_s,
        (x, y, z),
        _AXES[axis],
        askew_deg,
        None if refused else scale,
        scale * math.hypot(scatter, drift) / length,
        refused,
    )


def neighbouring_rests(part: Interval, rests: Sequence[Interval]) -> tuple[Interval, ...]:
    """Return the last rest that begins before a part, and the first that ends after it, if they exist."""
    before = [rest for rest in rests if rest.start < part.start and rest.end < part.end]
    behind = [rest for rest in rests if rest.end > part.end and rest.start > part.start]
    return (*before[-1:], *behind[:1])


def _runs(which: NDArray[np.bool_]) -> list[tuple[int, int]]:
    """Return the start and end of each run of true values."""
    edges = np.flatnonzero(np.diff(np.concatenate([[False], which, [False]]).astype(np.int8))).tolist()
    return list(pairwise(edges))[::2]
