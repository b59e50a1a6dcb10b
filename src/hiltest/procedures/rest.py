"""The accelerometer while the board stands still."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from hiltest.boards.board import Board
from hiltest.link.messages import Average, SensorKind
from hiltest.link.replies import G_PER_COUNT

Reals = NDArray[np.float64]


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
