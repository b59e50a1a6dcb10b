"""Quaternions of attitude, in float64.

A quaternion is (x, y, z, w), scalar last, as in Mucciaccia's thesis, equation (11). An attitude quaternion has norm 1
and converts body components to the earth frame (NED): ``v_ned = q v q*``, the product being Hamilton's. q and -q are
one attitude.
"""

from __future__ import annotations

from typing import TypeAlias

import numpy as np
from numpy.typing import ArrayLike, NDArray

from hiltest.orientation.angles import Pose, pose_from_rotation, rotation_body_from_ned

Quaternion: TypeAlias = NDArray[np.float64]


def normalised(quaternion: ArrayLike) -> Quaternion:
    """Return the quaternion of norm 1 in the same direction."""
    values = np.asarray(quaternion, dtype=np.float64)
    unit: Quaternion = values / np.linalg.norm(values)
    return unit


def from_pose(pose: Pose) -> Quaternion:
    """Return the quaternion of an attitude given by its angles, w not negative."""
    return from_ned_axes(rotation_body_from_ned(pose).T)


def from_ned_axes(axes: ArrayLike) -> Quaternion:
    """Return the quaternion of a rotation matrix, w not negative.

    Parameters
    ----------
    axes : shape (3, 3)
        Matrix from body components to north, east and down: its rows are these directions in the body frame.

    Notes
    -----
    Each element of the quaternion's outer square is a sum of elements of the matrix. The row of its largest diagonal
    element is used, to avoid division by a small number (Shepperd 1978).
    """
    (a, b, c), (d, e, f), (g, h, i) = np.asarray(axes, dtype=np.float64)
    # Four times the outer square, in the order x, y, z, w.
    square = np.array(
        [
            [1 + a - e - i, b + d, c + g, h - f],
            [b + d, 1 - a + e - i, f + h, c - g],
            [c + g, f + h, 1 - a - e + i, d - b],
            [h - f, c - g, d - b, 1 + a + e + i],
        ]
    )
    row = square[int(np.argmax(np.diag(square)))]
    unit = normalised(row)
    return -unit if unit[3] < 0.0 else unit


def rotation_ned_from_body(quaternion: ArrayLike) -> NDArray[np.float64]:
    """Return the matrix, shape (3, 3), of a unit quaternion: ``v_ned = R @ v_body``."""
    x, y, z, w = np.asarray(quaternion, dtype=np.float64)
    return np.array(
        [
            [1 - 2 * (y * y + z * z), 2 * (x * y - z * w), 2 * (x * z + y * w)],
            [2 * (x * y + z * w), 1 - 2 * (x * x + z * z), 2 * (y * z - x * w)],
            [2 * (x * z - y * w), 2 * (y * z + x * w), 1 - 2 * (x * x + y * y)],
        ]
    )


def pose_of(quaternion: ArrayLike) -> Pose:
    """Return heading, pitch and roll of a unit quaternion."""
    return pose_from_rotation(rotation_ned_from_body(quaternion).T)
