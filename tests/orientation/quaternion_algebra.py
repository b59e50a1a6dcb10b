"""Products of quaternions, in float64; the conventions are those of `hiltest.orientation.quaternions`."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import ArrayLike

from hiltest.orientation.quaternions import Quaternion


def product(first: ArrayLike, second: ArrayLike) -> Quaternion:
    """Return Hamilton's product: what `second` does in the frame that `first` has made."""
    x, y, z, w = np.asarray(second, dtype=np.float64)
    matrix = np.array([[w, z, -y, x], [-z, w, x, y], [y, -x, w, z], [-x, -y, -z, w]])
    return matrix @ np.asarray(first, dtype=np.float64)


def conjugate(quaternion: ArrayLike) -> Quaternion:
    """Return the opposite turn of a unit quaternion."""
    return np.asarray(quaternion, dtype=np.float64) * (-1.0, -1.0, -1.0, 1.0)


def from_rotation_vector(rotation_rad: ArrayLike) -> Quaternion:
    """Return the rotation about a vector, shape (3,), by its length [rad]: Mucciaccia's equations (8) to (11)."""
    vector = np.asarray(rotation_rad, dtype=np.float64)
    angle_rad = float(np.linalg.norm(vector))
    # numpy's sinc is sin(pi x)/(pi x), and knows its limit.
    return np.append(0.5 * np.sinc(angle_rad / (2.0 * math.pi)) * vector, math.cos(0.5 * angle_rad))


def angle_between_deg(first: ArrayLike, second: ArrayLike) -> float:
    """Return the smallest rotation that takes one attitude to another [deg]; signs do not matter."""
    between = product(conjugate(first), second)
    return math.degrees(2.0 * math.atan2(float(np.linalg.norm(between[:3])), abs(float(between[3]))))
