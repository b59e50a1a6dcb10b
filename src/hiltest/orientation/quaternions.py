"""Quaternions of attitude, in float64.

A quaternion is (x, y, z, w), scalar last, as in Mucciaccia's thesis, equation (11). An attitude quaternion has norm 1
and converts body components to the earth frame (NED): ``v_ned = q v q*``, the product being Hamilton's. q and -q are
one attitude.
"""

from __future__ import annotations

import math
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


def from_rotation_vector(rotation_rad: ArrayLike) -> Quaternion:
    """Return the rotation about a vector by its length, shape (..., 3) [rad], as a quaternion.

    Notes
    -----
    Mucciaccia's equations (8) to (11), which are 0/0 without rotation: sine over angle is one function, 1/2 there.
    """
    vector = np.asarray(rotation_rad, dtype=np.float64)
    angle_rad = np.linalg.norm(vector, axis=-1, keepdims=True)
    # numpy's sinc is sin(pi x)/(pi x), and knows its limit.
    return np.concatenate([0.5 * np.sinc(angle_rad / (2.0 * math.pi)) * vector, np.cos(0.5 * angle_rad)], axis=-1)


def right_matrix(second: ArrayLike) -> NDArray[np.float64]:
    """Return the matrix of a product's second factor, shape (..., 4, 4): ``first second = matrix @ first``."""
    x, y, z, w = np.moveaxis(np.asarray(second, dtype=np.float64), -1, 0)
    return np.moveaxis(np.array([[w, z, -y, x], [-z, w, x, y], [y, -x, w, z], [-x, -y, -z, w]]), (0, 1), (-2, -1))


def left_columns(second: ArrayLike) -> NDArray[np.float64]:
    """Return the products of the earth's axes with a quaternion, as columns, shape (4, 3).

    Notes
    -----
    ``q + left_columns(q) @ turn_rad / 2`` is q after a small rotation about north, east and down. For a unit q the
    columns are orthonormal, and orthogonal to q.
    """
    x, y, z, w = np.asarray(second, dtype=np.float64)
    return np.array([[w, z, -y], [-z, w, x], [y, -x, w], [-x, -y, -z]])
