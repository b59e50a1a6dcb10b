"""Accelerometer and gyroscope while the board stands still."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from hiltest.boards.board import Board
from hiltest.link.messages import Average, SensorKind
from hiltest.link.replies import DPS_PER_COUNT, G_PER_COUNT
from hiltest.procedures.gyroscope_rest import GYROSCOPE_RATE_HZ, rest_gyroscope
from hiltest.procedures.progress import Progress, silent

Reals = NDArray[np.float64]


@dataclass(frozen=True, slots=True, eq=False)
class GyroscopeRestResult:
    """Two rests of the gyroscope: the first stores the bias, the second judges it.

    Attributes
    ----------
    n : int
        Samples of each rest.
    seconds : float
        Length of each rest at the sensor's rate.
    bias_dps, corrected_dps, spread_dps : ndarray, shape (3,)
        Mean of the first rest; mean of the second without that bias; sample standard
        deviation of the second, None for a single sample.
    bias_error_dps, uncorrected_error_dps : float
        Largest axis of the second rest's mean, with and without the bias taken off.
    die_temperature_degc : int
        As the part gives it.
    """

    n: int
    seconds: float
    bias_dps: Reals
    corrected_dps: Reals
    spread_dps: Reals | None
    bias_error_dps: float
    uncorrected_error_dps: float
    die_temperature_degc: int


@dataclass(frozen=True, slots=True, eq=False)
class AccelerometerRestResult:
    """Gravity as a still board feels it (body frame, positive down) [g]."""

    n: int
    mean_g: Reals
    spread_g: Reals | None
    norm_error_mg: float
    pitch_deg: float
    roll_deg: float


def measure_gyroscope_rest(
    board: Board, *, seconds: float = 2.5, progress: Progress | None = None
) -> GyroscopeRestResult:
    """Store the gyroscope's bias in one rest and judge it in another.

    Parameters
    ----------
    board : Board
        Standing still.
    seconds : float
        Length of each rest.

    Raises
    ------
    BoardMovedError
        When the board was moved in a rest.
    SensorAbsentError
        When the board has no gyroscope.
    """
    tell = progress or silent
    tell("gyroscope at rest", 0, 2)
    first = rest_gyroscope(board, seconds=seconds, store=True)
    tell("gyroscope at rest", 1, 2)
    second = rest_gyroscope(board, seconds=seconds)
    tell("gyroscope at rest", 2, 2)
    corrected_dps = second.corrected_mean * DPS_PER_COUNT
    return GyroscopeRestResult(
        n=second.n,
        seconds=second.n / GYROSCOPE_RATE_HZ,
        bias_dps=first.rate.mean * DPS_PER_COUNT,
        corrected_dps=corrected_dps,
        spread_dps=_scaled(second.rate.spread, DPS_PER_COUNT),
        bias_error_dps=float(np.abs(corrected_dps).max()),
        uncorrected_error_dps=float(np.abs(second.rate.mean * DPS_PER_COUNT).max()),
        die_temperature_degc=second.die_temperature_degc,
    )


def measure_accelerometer_rest(board: Board, *, readings: int = 64) -> AccelerometerRestResult:
    """Average the accelerometer of a still board.

    Raises
    ------
    SensorAbsentError
        When the board has no accelerometer.
    """
    board.sensor(SensorKind.ACCELEROMETER)
    reply = board.session.request(Average(readings))
    mean_g = reply.accelerometer.mean * G_PER_COUNT
    x, y, z = (float(value) for value in mean_g)
    return AccelerometerRestResult(
        n=reply.n,
        mean_g=mean_g,
        spread_g=_scaled(reply.accelerometer.spread, G_PER_COUNT),
        norm_error_mg=1000.0 * (math.hypot(x, y, z) - 1.0),
        pitch_deg=math.degrees(math.atan2(-x, math.hypot(y, z))),
        roll_deg=math.degrees(math.atan2(y, z)),
    )


def _scaled(counts: Reals | None, unit: float) -> Reals | None:
    return None if counts is None else counts * unit
