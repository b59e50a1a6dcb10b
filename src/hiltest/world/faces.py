"""True pose of a board on a misaligned face."""

from __future__ import annotations

import math

import numpy as np

from hiltest.orientation.angles import Pose, pose_from_rotation, rotation_body_from_ned, sin_cos_deg
from hiltest.world.earth_field import Vector


def askew(pose: Pose, turn_deg: Vector) -> Pose:
    """Return a pose after a small turn of the body.

    Parameters
    ----------
    turn_deg
        Angle about body x, y and z [deg], as one turn about their sum.
    """
    angle_deg = math.hypot(*turn_deg)
    if angle_deg == 0.0:
        return pose
    x, y, z = (component_deg / angle_deg for component_deg in turn_deg)
    sine, cosine = sin_cos_deg(angle_deg)
    across = np.array([[0.0, -z, y], [z, 0.0, -x], [-y, x, 0.0]])
    # Rodrigues' formula; the body rotates, so vectors in its frame rotate in the other direction.
    turn = np.eye(3) + sine * across + (1.0 - cosine) * (across @ across)
    return pose_from_rotation(turn.T @ rotation_body_from_ned(pose))
