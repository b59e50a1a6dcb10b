"""Axes of both sensors, estimated at a few known attitudes of an automatic table."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from hiltest.boards.board import Board
from hiltest.calibration.sensor_axes import SensorAxes, sensor_axes
from hiltest.link.messages import Average
from hiltest.orientation.angles import Pose, rotation_body_from_ned, wrap_360
from hiltest.procedures.turntables import Turntable


def see_axes(
    board: Board,
    turntable: Turntable,
    *,
    poses: Sequence[Pose],
    field_ned_ut: Sequence[float],
    mounting_yaw_deg: float,
    readings: int = 16,
) -> SensorAxes:
    """Turn to each pose, and estimate the axes from the readings of both sensors.

    Parameters
    ----------
    poses
        Level and tilted ones.
    field_ned_ut
        Declared field [uT].
    mounting_yaw_deg
        Declared turn of the board on the table: board heading = table heading + this.
    readings
        New samples of each sensor to average at each pose.
    """
    rotations, means = [], []
    for pose in poses:
        achieved = turntable.turn_to(pose)
        attitude = Pose(wrap_360(achieved.heading_deg + mounting_yaw_deg), achieved.pitch_deg, achieved.roll_deg)
        rotations.append(rotation_body_from_ned(attitude))
        reply = board.session.request(Average(readings))
        means.append((reply.magnetometer.mean, reply.accelerometer.mean))
    turns = np.array(rotations)
    magnetometer, accelerometer = np.array(means, dtype=np.float64).swapaxes(0, 1)
    return sensor_axes(turns @ np.array(field_ned_ut), turns @ np.array((0.0, 0.0, 1.0)), magnetometer, accelerometer)
