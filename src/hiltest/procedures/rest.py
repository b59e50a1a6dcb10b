"""Accelerometer and gyroscope of a still board; a bias is refused if the board was moved."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from hiltest.boards.board import Board
from hiltest.errors import CalibrationError
from hiltest.link.gyroscope import Axis, GyroscopeRest, GyroscopeRestReply, StillnessKind
from hiltest.link.messages import Average
from hiltest.link.replies import DPS_PER_COUNT, G_PER_COUNT, SAMPLE_RATE_HZ, SensorKind
from hiltest.procedures.progress import Progress, silent

Reals = NDArray[np.float64]

# Samples in one window of the firmware's test of stillness.
STILLNESS_WINDOW = 20


@dataclass(frozen=True, slots=True, eq=False)
class AccelerometerRestResult:
    """Gravity as a still board feels it (body frame, positive down) [g]."""

    n: int
    mean_g: Reals
    spread_g: Reals | None
    norm_error_mg: float
    pitch_deg: float
    roll_deg: float


def measure_accelerometer_rest(board: Board, *, readings: int = 64) -> AccelerometerRestResult:
    """Average the accelerometer of a still board.

    Raises
    ------
    SensorAbsentError
        When the board has no accelerometer.
    """
    board.sensor(SensorKind.ACCELEROMETER)
    reply = board.session.request(Average(readings))
    mean_g, spread = reply.accelerometer.mean * G_PER_COUNT, reply.accelerometer.spread
    x, y, z = (float(value) for value in mean_g)
    return AccelerometerRestResult(
        n=reply.n,
        mean_g=mean_g,
        spread_g=None if spread is None else spread * G_PER_COUNT,
        norm_error_mg=1000.0 * (math.hypot(x, y, z) - 1.0),
        pitch_deg=math.degrees(math.atan2(-x, math.hypot(y, z))),
        roll_deg=math.degrees(math.atan2(y, z)),
    )


class BoardMovedError(CalibrationError):
    """Error for a board that moved while it should lie still.

    Attributes
    ----------
    at_s : float
        Seconds into the rest.
    axis : Axis
        Axis of the largest motion.
    """

    def __init__(self, at_s: float, axis: Axis, motion: str, advice: str) -> None:
        self.at_s = at_s
        self.axis = axis
        super().__init__(f"the board moved {at_s:.1f} s into the rest: {motion}. {advice}")


class SamplesLostError(CalibrationError):
    """Overflow of the gyroscope's FIFO: the samples have a gap."""


def noise_counts(board: Board) -> float:
    """Return the rms of one sample of the gyroscope, assuming independence [counts].

    It combines the declared density over half the sampling rate and the rounding to whole counts.
    """
    white_dps = board.declared.gyroscope_density_dps * math.sqrt(0.5 * SAMPLE_RATE_HZ)
    return math.hypot(white_dps / DPS_PER_COUNT, math.sqrt(1.0 / 12.0))


def rest_gyroscope(
    board: Board, *, seconds: float, store: bool = False, progress: Progress | None = None
) -> GyroscopeRestReply:
    """Average the gyroscope of a still board.

    Parameters
    ----------
    board
        Still board; a constant rotation from before the rest looks like bias.
    seconds
        Length of the rest, at most 20.
    store
        True if the board subtracts the mean as its bias from now on.

    Raises
    ------
    BoardMovedError
        When the board was moved: nothing is stored then.
    CalibrationError
        When the rest is too short to test whether the board was still; nothing is stored then either.
    SamplesLostError
        When the board could not read its gyroscope in time.
    SensorAbsentError
        When the board has no gyroscope.
    """
    tell = progress or silent
    board.sensor(SensorKind.GYROSCOPE)
    n = math.ceil(seconds * SAMPLE_RATE_HZ)
    timeout_us = round(2e6 * seconds + 1e6)  # twice the expected time, plus a second
    tell("gyroscope at rest", 0, 1)
    reply = board.session.request(GyroscopeRest(n, store, noise_counts(board), timeout_us=timeout_us))
    tell("gyroscope at rest", 1, 1)
    _refuse_motion(reply, seconds)
    if reply.span.lost:
        raise SamplesLostError(f"samples of the gyroscope were lost in a rest of {seconds:g} s; run again")
    return reply


def _refuse_motion(reply: GyroscopeRestReply, seconds: float) -> None:
    stillness, window_s = reply.stillness, STILLNESS_WINDOW / SAMPLE_RATE_HZ
    if stillness.kind is StillnessKind.STILL:
        return
    if stillness.kind is StillnessKind.NOT_TESTED:
        raise CalibrationError(
            f"stillness was not tested: a rest of {seconds:g} s is shorter than the {window_s:g} s "
            "of one test of stillness; rest longer"
        )
    amount_dps = stillness.amount * DPS_PER_COUNT
    axis = stillness.axis.name.lower()
    if stillness.kind is StillnessKind.TURNED:
        motion = f"{amount_dps:+.2f} deg/s about its {axis} axis, as the mean of {window_s:g} s, beside the time before"
    else:
        motion = f"{amount_dps:.2f} deg/s rms about its {axis} axis within {window_s:g} s"
    raise BoardMovedError(
        stillness.first / SAMPLE_RATE_HZ,
        stillness.axis,
        motion,
        f"Leave the board alone for {seconds:g} s and run again; if it was not touched, check for vibration, and "
        "sensors.gyroscope_noise_mdps_per_rthz in the rig",
    )
