"""A gyroscope's calibration from the rests and whole turns of a log."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from hiltest.calibration.accelerometer import AccelerometerFit
from hiltest.calibration.acceptance import Acceptance, Bound, Reason, rate_by
from hiltest.calibration.gyroscope import MAX_TURNS, GyroscopeFit, GyroscopeTurn, TurnsStatus, fit_turns
from hiltest.logs.imu_log import ImuLog
from hiltest.logs.imu_rate import beside_of
from hiltest.logs.intervals import Interval, Intervals
from hiltest.units import DEGREES_PER_SECOND

Reals = NDArray[np.float64]

WHOLE_DEG = 360.0
# Gravity before and behind a turn about the vertical: a table that is level within 1.5 degrees moves it by 3.
_SAME_GRAVITY_DEG = 4.0
# The sensor's own axes are off by less.
_ABOUT_VERTICAL_DEG = 15.0
# What an uncalibrated part's scale may be off; the next number of whole turns is at least half of one away.
_SCALE = 0.15
# Less than that is a table that was touched.
_A_TURN_AT_ALL = 0.2
_LONGEST_GAP = 5.0  # in samples
_REFUSALS = {
    TurnsStatus.TOO_FEW: "fewer than three whole turns about the vertical were found",
    TurnsStatus.TOO_SMALL: "a turn is smaller than 90 degrees",
    TurnsStatus.NOT_SPANNING: "the turns are about axes in one plane: turn it lying on three different faces",
    TurnsStatus.SINGULAR: "the readings of the turns lie in one plane: an axis of the gyroscope is dead",
}

# Of the shipped rigs' whole turns 0.1 % are the limit; a hand that meets the edge of a table is good to a degree.
BOUNDS = (
    Bound("turns", "", 4.0, Acceptance.FAIR,
          "three turns are met exactly: a fourth would show how good the matrix is", below=True),
    Bound("left_percent", "%", 1.0, Acceptance.POOR,
          "the turns contradict each other: was each whole, on a level table, and no faster than the sensor reads?"),
    Bound("left_percent", "%", 0.5, Acceptance.FAIR,
          "the turns contradict each other by more than a hand at an edge; turn until it is back there"),
)  # fmt: skip


@dataclass(frozen=True, slots=True)
class TurnResult:
    """One motion that may be a whole turn."""

    name: str
    """As annotated, else empty."""
    start_s: float
    end_s: float
    """In the log."""
    bias: tuple[float, float, float]
    """Its own: of the rests beside it, in the unit of the log."""
    integral: tuple[float, float, float]
    """Integral of the rate without its bias: degrees, or counts times seconds."""
    turned_deg: float
    """What it was taken for, about the vertical upward as accelerometers have it; 0 when it was refused."""
    left_deg: float
    """Difference between that and the calibrated integral; 0 without a calibration."""
    refused: str
    """Why, empty when it was used."""


@dataclass(frozen=True, slots=True, eq=False)
class GyroscopeResult:
    """Calibration of the gyroscope from a log."""

    n: int
    """Samples at rest."""
    bias: Reals
    """Shape (3,). Their mean, in the unit of the log."""
    bias_spread: float
    """Standard deviation of the rests' own means about it, largest axis."""
    fit: GyroscopeFit | None
    """``rate_dps = matrix @ (reading - bias)``. None without three turns; the bias holds then as well."""
    turns: tuple[TurnResult, ...]
    verdict: Acceptance
    """On the matrix; refused where there is only the bias."""
    reasons: tuple[Reason, ...]
    """Why it is not good."""
    refused: str
    """Why there is no matrix, empty when there is."""


@dataclass(frozen=True, slots=True, eq=False)
class _Candidate:
    turn: GyroscopeTurn
    up: Reals
    result: TurnResult


def fit_gyroscope(
    log: ImuLog, intervals: Intervals, accelerometer: AccelerometerFit | None, *, turn_deg: float = WHOLE_DEG,
    rests: Sequence[Interval] = (), bias: Reals | None = None, steady: Sequence[Interval] = (),
) -> GyroscopeResult | None:  # fmt: skip
    """Fit the bias to the rests and the matrix to the whole turns about the vertical.

    Parameters
    ----------
    accelerometer
        Calibration from the same log.
    turn_deg
        Angle of each turn, done once or several times; counts alone do not show it.
    rests
        Where the log rests beside annotated turns, found in it: a turn's own bias is that of the rests beside it.
    bias : shape (3,)
        From another log, in the unit of this one; it then holds for all turns.
    steady
        What turned at a table's rate, and is no whole turn.

    Returns
    -------
    GyroscopeResult or None
        None when the log has no gyroscope, or neither a rest nor a bias.

    Notes
    -----
    A turn is between two rests with the same gravity, its integral along it: then the vertical, which the calibrated
    accelerometer tells in its own axes, is what it turned about. Both sensors then have the same axes. The sense is
    that of the readings: a gyroscope that is mirrored as a whole looks like a turn the other way.
    """
    if log.rate is None or not (intervals.rests or bias is not None):
        return None
    still = [log.rate[rest.start : rest.end] for rest in intervals.rests]
    n = sum(map(len, still))
    spread = float(np.array([rest.mean(axis=0) for rest in still]).std(axis=0).max()) if still else 0.0
    own = bias is None
    bias = np.concatenate(still).mean(axis=0) if bias is None else bias
    if accelerometer is None:
        why = "without an accelerometer the axes of the turns are unknown"
        return GyroscopeResult(n, bias, spread, None, (), Acceptance.REFUSED, (), why)
    motions = _candidates(log, intervals, accelerometer, bias, rests, own=own)
    times_s = [(log.time_s[each.start], log.time_s[each.end - 1]) for each in steady]
    meant = [motion for motion in motions if not any(
        motion.result.start_s < end_s and start_s < motion.result.end_s for start_s, end_s in times_s
    )]  # fmt: skip
    candidates = _whole_turns(log, meant, turn_deg)
    used = [candidate for candidate in candidates if not candidate.result.refused]
    found = fit_turns([_about_vertical(each) for each in used])
    if found.status is not TurnsStatus.OK:
        turns = tuple(candidate.result for candidate in candidates)
        return GyroscopeResult(n, bias, spread, None, turns, Acceptance.REFUSED, (), _REFUSALS[found.status])
    turns = tuple(replace(candidate.result, left_deg=_left_deg(candidate, found.matrix)) for candidate in candidates)
    left = [100.0 * turn.left_deg / abs(turn.turned_deg) for turn in turns if not turn.refused]
    verdict, reasons = rate_by(BOUNDS, {"turns": float(len(left)), "left_percent": max(left)})
    return GyroscopeResult(n, bias, spread, GyroscopeFit(found.matrix, bias), turns, verdict, reasons, "")


def _candidates(
    log: ImuLog, intervals: Intervals, accelerometer: AccelerometerFit, bias: Reals, rests: Sequence[Interval], *,
    own: bool,
) -> list[_Candidate]:  # fmt: skip
    """Return the motions that leave gravity where it was."""
    found = []
    around = zip(intervals.rests, intervals.rests[1:], strict=False) if intervals.found else [
        (turn, turn) for turn in intervals.motions
    ]
    for motion, (before, after) in zip(intervals.motions, around, strict=True):
        first, last = (_gravity(log, accelerometer, each) for each in (before, after))
        if first @ last > np.cos(np.radians(_SAME_GRAVITY_DEG)):
            beside = beside_of(motion, intervals.rests if intervals.found else rests) if own else ()
            biases = [_rate(log, each) for each in beside] or [bias]
            found.append(_candidate(log, motion, (biases[0], biases[-1]), first + last))
    return found


def _candidate(log: ImuLog, motion: Interval, bias: Sequence[Reals], up: Reals) -> _Candidate:
    samples = _rates(log)[motion.start : motion.end]
    # A sample stands for the period about it: from half a period before the first to half a one behind the last.
    steps_s = np.diff(log.time_s[motion.start : motion.end])
    duration_s = float(steps_s.sum())
    turn = GyroscopeTurn(np.zeros(3), samples.sum(axis=0), len(samples), duration_s, bias[0], bias[1])
    unit = DEGREES_PER_SECOND[log.rate_unit] or 1.0
    x, y, z = (unit * turn.integral).tolist()
    own_x, own_y, own_z = turn.bias.tolist()
    gap = steps_s.size == 0 or float(steps_s.max()) > _LONGEST_GAP * log.period_s
    refused = "samples are missing in it" if gap else ""
    start_s = float(log.time_s[motion.start])
    result = TurnResult(motion.name, start_s, start_s + duration_s, (own_x, own_y, own_z), (x, y, z), 0.0, 0.0, refused)
    return _Candidate(turn, up / np.linalg.norm(up), result)


def _whole_turns(log: ImuLog, candidates: Sequence[_Candidate], turn_deg: float) -> list[_Candidate]:
    """Return the candidates with their number of turns, or the reason why they are none, without what hardly turned."""
    lengths = [float(np.linalg.norm(candidate.result.integral)) for candidate in candidates]
    whole = turn_deg
    if DEGREES_PER_SECOND[log.rate_unit] is None:
        turned = [length for length in lengths if length > _A_TURN_AT_ALL * max(lengths)]
        whole = float(np.median(turned)) if turned else 1.0
    turns, used = [], 0
    for each, length in zip(candidates, lengths, strict=True):
        if length < _A_TURN_AT_ALL * whole:
            continue
        along = float(np.array(each.result.integral) @ each.up) / length
        times = max(1, round(length / whole))
        refused = each.result.refused
        if not refused and abs(along) < np.cos(np.radians(_ABOUT_VERTICAL_DEG)):
            refused = "not about the vertical"
        if not refused and abs(length / (times * whole) - 1.0) > _SCALE:
            refused = f"{length / whole:.2f} of a turn of {turn_deg:g} degrees"
        if not refused and used == MAX_TURNS:
            refused = f"{MAX_TURNS} are enough"
        used += not refused
        turned_deg = 0.0 if refused else float(np.copysign(times * turn_deg, along))
        turns.append(replace(each, result=replace(each.result, turned_deg=turned_deg, refused=refused)))
    return turns


def _about_vertical(each: _Candidate) -> GyroscopeTurn:
    return replace(each.turn, turned_deg=each.result.turned_deg * each.up)


def _left_deg(each: _Candidate, matrix: Reals) -> float:
    if each.result.refused:
        return 0.0
    return float(np.linalg.norm(matrix @ each.turn.integral - each.result.turned_deg * each.up))


def _gravity(log: ImuLog, accelerometer: AccelerometerFit, interval: Interval) -> Reals:
    """Return the direction of the mean gravity; a turn about the vertical leaves it where it is."""
    mean = accelerometer.gravity_g(log.acceleration[interval.start : interval.end].mean(axis=0))
    unit: Reals = mean / np.linalg.norm(mean)
    return unit


def _rate(log: ImuLog, interval: Interval) -> Reals:
    mean: Reals = _rates(log)[interval.start : interval.end].mean(axis=0)
    return mean


def _rates(log: ImuLog) -> Reals:
    return log.rate if log.rate is not None else np.zeros_like(log.acceleration)
