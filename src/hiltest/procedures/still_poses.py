"""Still poses in all directions: gravity and the field from all sides, in the board's buffer."""

from __future__ import annotations

import math
from collections.abc import Sequence

from hiltest.boards.board import Board
from hiltest.calibration.quality import sphere_directions
from hiltest.calibration.still_pose import StillPose
from hiltest.errors import FirmwareContradictionError
from hiltest.link.poses import MAX_TRANSFER, AddPose, ClearPoses, Poses
from hiltest.link.replies import SensorKind
from hiltest.orientation.angles import Pose, wrap_180, wrap_360
from hiltest.procedures.progress import Progress, silent
from hiltest.procedures.turntables import Turntable

# Step of the heading from pose to pose, so that headings do not repeat [deg]. Gravity's directions are a golden angle
# apart: with the same step, headings would follow gravity, and a fit of both sensors would have a quarter of the
# information.
_HEADING_STEP_DEG = 360.0 * (math.sqrt(2.0) - 1.0)


def spread_poses(n: int) -> tuple[Pose, ...]:
    """Return poses that show gravity evenly from all sides, each at a different heading.

    Parameters
    ----------
    n
        Number of poses, at least 9 for an ellipsoid of gravity.
    """
    poses = []
    for number, (x, y, z) in enumerate(sphere_directions(n).tolist()):
        pitch_deg = math.degrees(math.atan2(-x, math.hypot(y, z)))
        roll_deg = math.degrees(math.atan2(y, z))
        poses.append(Pose(wrap_360(number * _HEADING_STEP_DEG), wrap_180(pitch_deg), wrap_180(roll_deg)))
    return tuple(poses)


def collect_still_poses(
    board: Board, turntable: Turntable, poses: Sequence[Pose], *, readings: int = 16, progress: Progress | None = None
) -> int:
    """Turn to each pose and let the board store it.

    Parameters
    ----------
    board
        Board whose pose buffer is cleared first.
    turntable
        Turntable, whose accuracy does not matter because the poses are not used.
    readings
        New samples of each sensor that are averaged.

    Returns
    -------
    int
        Temperature of the accelerometer's die at the end [degC].

    Raises
    ------
    SensorAbsentError
        When magnetometer or accelerometer is missing.
    ValueError
        If there are no poses.
    """
    tell = progress or silent
    if not poses:
        raise ValueError("no poses to take")
    for kind in (SensorKind.MAGNETOMETER, SensorKind.ACCELEROMETER):
        board.sensor(kind)
    board.session.request(ClearPoses())
    for number, pose in enumerate(poses):
        tell("still poses", number, len(poses))
        turntable.turn_to(pose)
        degc = board.session.request(AddPose(readings)).die_temperature_degc
    tell("still poses", len(poses), len(poses))
    return degc


def stored_poses(board: Board, n: int) -> list[StillPose]:
    """Return the first n poses of the board's buffer.

    Raises
    ------
    BoardResetError
        When the poses are lost.
    FirmwareContradictionError
        When the board accepted them and does not return them.
    """
    poses: list[StillPose] = []
    while len(poses) < n:
        stored = board.session.request(Poses(len(poses), min(MAX_TRANSFER, n - len(poses))))
        if not stored:
            board.session.refuse_reset()
            raise FirmwareContradictionError(
                f"the firmware contradicts itself: it took {n} poses, and gives {len(poses)} of them back"
            )
        poses += stored
    return poses
