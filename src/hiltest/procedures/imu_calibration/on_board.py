"""Storage of a calibration file's numbers on the board, so that its answers use them."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager

import numpy as np

from hiltest.boards import Board
from hiltest.link.accelerometer import SetAccelerometer
from hiltest.link.gyroscope import GetGyroscope, SetGyroscope
from hiltest.link.messages import ClearCalibration, SetCalibration
from hiltest.procedures.heading_statistics import rms
from hiltest.procedures.imu_calibration.contents import GyroscopePart, ImuCalibration
from hiltest.procedures.requested_headings import RequestedAngles
from hiltest.procedures.rest import rest_gyroscope

#: Subject of the headings under a file's calibration: ``heading.calibration.max``.
NAME = "calibration"


def store_calibration(board: Board, calibration: ImuCalibration, slot: int) -> dict[str, int]:
    """Store magnetometer and accelerometer calibration in a slot; return the slot by its name."""
    board.session.request(ClearCalibration(slot))
    magnetometer, accelerometer = calibration.magnetometer, calibration.accelerometer
    board.session.request(SetCalibration(slot, magnetometer.soft_iron, magnetometer.hard_iron))
    if accelerometer is not None:
        board.session.request(SetAccelerometer(slot, accelerometer.gain, accelerometer.offset))
    return {NAME: slot}


@contextmanager
def gyroscope_calibrated_by(board: Board, part: GyroscopePart) -> Iterator[None]:
    """Give the board a file's gyroscope calibration for the time of the context, and restore its own afterwards."""
    own = board.session.request(GetGyroscope())
    board.session.request(SetGyroscope(part.matrix, part.bias))
    try:
        yield
    finally:
        board.session.request(SetGyroscope(own.matrix, own.bias))


def gyroscope_bias_error_dps(board: Board, part: GyroscopePart, *, seconds: float) -> float:
    """Return the largest axis of a still board's mean rate under a file's calibration [deg/s].

    Raises
    ------
    BoardMovedError, SamplesLostError
        When the board moved: the mean of a motion to and fro could hide it.
    """
    with gyroscope_calibrated_by(board, part):
        rest = rest_gyroscope(board, seconds=seconds)
    return float(np.abs(np.array(part.matrix) @ rest.corrected_mean).max())


def field_norm_rms_percent(known_angles: RequestedAngles, calibration: ImuCalibration) -> float:
    """Return the deviation of the corrected field's norm from 1 at the known angles, rms over the poses [%]."""
    part = calibration.magnetometer
    corrected = (known_angles.magnetometer - np.array(part.hard_iron)) @ np.array(part.soft_iron).T
    return rms([100.0 * (float(np.linalg.norm(vector)) - 1.0) for vector in corrected])
