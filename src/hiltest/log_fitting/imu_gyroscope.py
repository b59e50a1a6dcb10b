"""A gyroscope's calibration from the rests and whole turns of a log."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from hiltest.calibration.accelerometer import AccelerometerFit
from hiltest.calibration.acceptance import Acceptance, Bound, Reason, rate_by
from hiltest.calibration.gyroscope import MAX_TURNS, GyroscopeFit, GyroscopeTurn, TurnsStatus, fit_turns
from hiltest.log_fitting.imu_log import ImuLog
from hiltest.log_fitting.imu_rate import neighbouring_rests
from hiltest.log_fitting.intervals import Interval, Intervals
from hiltest.measurement.units import DEGREES_PER_SECOND

Reals = NDArray[np.float64]

WHOLE_DEG = 360.0
# Largest angle between gravity before and after a turn about the vertical: a table that is level within 1.5 degrees
# changes it by 3.
_SAME_GRAVITY_DEG = 4.0
# Tolerance of the sensor's own axes.
_ABOUT_VERTICAL_DEG = 15.0
# Largest scale error of an uncalibrated part; the next number of whole turns is at least half a turn away.
_SCALE = 0.15
# Smaller rotations mean a table that was touched.
_A_TURN_AT_ALL = 0.2
_LONGEST_GAP = 5.0  # largest gap in samples
_REFUSALS = {
    TurnsStatus.TOO_FEW: "fewer than three whole turns about the vertical were found",
    TurnsStatus.TOO_SMALL: "a turn is smaller than 90 degrees",
    TurnsStatus.NOT_SPANNING: "the axes of the turns lie in one plane: turn the board on three different faces",
    TurnsStatus.SINGULAR: "the readings of the turns lie in one plane: an axis of the gyroscope does not respond",
}

# The limit for whole turns in the packaged rigs is 0.1 %; a hand that aligns with a table's edge is accurate to a
# degree.
BOUNDS = (
    Bound(
        "turns",
        4.0,
        Acceptance.FAIR,
        "three turns determine the matrix exactly: add a fourth to estimate its error",
        below=True,
    ),
    Bound(
        "left_percent",
        1.0,
        Acceptance.POOR,
        "the turns contradict each other: check that each turn was whole, on a level table, and within the sensor's "
        "range",
    ),
    Bound(
        "left_percent",
        0.5,
        Acceptance.FAIR,
        "the turns contradict each other by more than a turn by hand against an edge; turn back to the edge",
    ),
)


@dataclass(frozen=True, slots=True)
class TurnResult:
    """One motion that may be a whole turn."""

    name: str
    """Name of the annotation, otherwise empty."""
    start_s: float
    end_s: float
    """Interval in the log."""
    bias: tuple[float, float, float]
    """Bias from the adjacent rests, in the unit of the log."""
    integral: tuple[float, float, float]
    """Integral of the rate minus its bias: degrees, or counts times seconds."""
    turned_deg: float
    """Assumed angle, about the upward vertical of the accelerometer; 0 if it was refused."""
    left_deg: float
    """Difference between that and the calibrated integral; 0 without a calibration."""
    refused: str
    """Reason for the refusal; empty if it was used."""


@dataclass(frozen=True, slots=True, eq=False)
class GyroscopeResult:
    """Calibration of the gyroscope from a log."""

    n: int
    """Number of samples at rest."""
    bias: Reals
    """Shape (3,). Their mean, in the unit of the log."""
    bias_spread: float
    """Standard deviation of the rests' means, largest axis."""
    fit: GyroscopeFit | None
    """``rate_dps = matrix @ (reading - bias)``; None without three turns; the bias is still valid."""
    turns: tuple[TurnResult, ...]
    verdict: Acceptance
    """Verdict on the matrix; refused with a bias only."""
    reasons: tuple[Reason, ...]
    """Reasons why it is not good."""
    refused: str
    """Reason why there is no matrix; empty with one."""


@dataclass(frozen=True, slots=True, eq=False)
class _Candidate:
    turn: GyroscopeTurn
    up: Reals
    result: TurnResult


def fit_gyroscope(
    log: ImuLog,
    intervals: Intervals,
    accelerometer: AccelerometerFit | None,
    *,
    turn_deg: float = WHOLE_DEG,
    rests: Sequence[Interval] = (),
    bias: Reals | None = None,
    steady: Sequence[Interval] = (),
) -> GyroscopeResult | None:
    """Fit the bias to the rests and the matrix to the whole turns about the vertical.

    Parameters
    ----------
    accelerometer
        Calibration from the same log.
    turn_deg
        Angle of each turn, performed once or several times; counts alone do not show it.
    rests
        Rests that were found in the log beside annotated turns, from which a turn's bias is taken.
    bias : shape (3,)
        Bias from another log, in the unit of this one, for all turns.
    steady
        Parts that turned at a table's rate, which are not whole turns.

    Returns
    -------
    GyroscopeResult or None
        Result; None if the log has no gyroscope, or neither a rest nor a bias.

    Notes
    -----
    A turn is between two rests with the same gravity, and its integral is along gravity: then its axis is the vertical,
    which the calibrated accelerometer measures in its own axes. Both sensors then have the same axes. The direction is
    that of the readings: a mirrored gyroscope looks like a turn in the other direction.
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
    times_s = [(log.time_s[interval.start], log.time_s[interval.end - 1]) for interval in steady]
    meant = [
        motion
        for motion in motions
        if not any(motion.result.start_s < end_s and start_s < motion.result.end_s for start_s, end_s in times_s)
    ]
    candidates = _whole_turns(log, meant, turn_deg)
    used = [candidate for candidate in candidates if not candidate.result.refused]
    fit = fit_turns([_vertical_turn(candidate) for candidate in used])
    if fit.status is not TurnsStatus.OK:
        turns = tuple(candidate.result for candidate in candidates)
        return GyroscopeResult(n, bias, spread, None, turns, Acceptance.REFUSED, (), _REFUSALS[fit.status])
    turns = tuple(replace(candidate.result, left_deg=_left_deg(candidate, fit.matrix)) for candidate in candidates)
    left_percent = [100.0 * turn.left_deg / abs(turn.turned_deg) for turn in turns if not turn.refused]
    verdict, reasons = rate_by(BOUNDS, {"turns": float(len(left_percent)), "left_percent": max(left_percent)})
    return GyroscopeResult(n, bias, spread, GyroscopeFit(fit.matrix, bias), turns, verdict, reasons, "")


def _candidates(
    log: ImuLog,
    intervals: Intervals,
    accelerometer: AccelerometerFit,
    bias: Reals,
    rests: Sequence[Interval],
    *,
    own: bool,
) -> list[_Candidate]:
    """Return the motions that do not change gravity."""
    candidates = []
    around = (
        zip(intervals.rests, intervals.rests[1:], strict=False)
        if intervals.found
        else [(turn, turn) for turn in intervals.motions]
    )
    for motion, (before, after) in zip(intervals.motions, around, strict=True):
        first, last = (_gravity(log, accelerometer, interval) for interval in (before, after))
        if first @ last > np.cos(np.radians(_SAME_GRAVITY_DEG)):
            beside = neighbouring_rests(motion, intervals.rests if intervals.found else rests) if own else ()
            biases = [_rate(log, interval) for interval in beside] or [bias]
            candidates.append(_candidate(log, motion, (biases[0], biases[-1]), first + last))
    return candidates


def _candidate(log: ImuLog, motion: Interval, bias: Sequence[Reals], up: Reals) -> _Candidate:
    samples = _rates(log)[motion.start : motion.end]
    # A sample represents the period about it: from half a period before the first to half a period after the last.
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
    """Return the candidates with their number of turns or a refusal, without those that hardly turned."""
    lengths = [float(np.linalg.norm(candidate.result.integral)) for candidate in candidates]
    whole = turn_deg
    if DEGREES_PER_SECOND[log.rate_unit] is None:
        turned = [length for length in lengths if length > _A_TURN_AT_ALL * max(lengths)]
        whole = float(np.median(turned)) if turned else 1.0
    turns, used = [], 0
    for candidate, length in zip(candidates, lengths, strict=True):
        if length < _A_TURN_AT_ALL * whole:
            continue
        along = float(np.array(candidate.result.integral) @ candidate.up) / length
        times = max(1, round(length / whole))
        refused = candidate.result.refused
        if not refused and abs(along) < np.cos(np.radians(_ABOUT_VERTICAL_DEG)):
            refused = "not about the vertical"
        if not refused and abs(length / (times * whole) - 1.0) > _SCALE:
            refused = f"{length / whole:.2f} of a turn of {turn_deg:g} degrees"
        if not refused and used == MAX_TURNS:
            refused = f"{MAX_TURNS} are enough"
        used += not refused
        turned_deg = 0.0 if refused else float(np.copysign(times * turn_deg, along))
        turns.append(replace(candidate, result=replace(candidate.result, turned_deg=turned_deg, refused=refused)))
    return turns


def _vertical_turn(candidate: _Candidate) -> GyroscopeTurn:
    return replace(candidate.turn, turned_deg=candidate.result.turned_deg * candidate.up)


def _left_deg(candidate: _Candidate, matrix: Reals) -> float:
    if candidate.result.refused:
        return 0.0
    return float(np.linalg.norm(matrix @ candidate.turn.integral - candidate.result.turned_deg * candidate.up))


def _gravity(log: ImuLog, accelerometer: AccelerometerFit, interval: Interval) -> Reals:
    """Return the direction of the mean gravity, which a turn about the vertical does not change."""
    mean = accelerometer.gravity_g(log.acceleration[interval.start : interval.end].mean(axis=0))
    unit: Reals = mean / np.linalg.norm(mean)
    return unit


def _rate(log: ImuLog, interval: Interval) -> Reals:
    mean: Reals = _rates(log)[interval.start : interval.end].mean(axis=0)
    return mean


def _rates(log: ImuLog) -> Reals:
    return log.rate if log.rate is not None else np.zeros_like(log.acceleration)
