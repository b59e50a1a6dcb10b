"""Angles, poses and rotations between the earth frame and the body frame.

Frames: earth is NED (north, east, down), body is x forward, y right, z down. A
pose is aerospace yaw-pitch-roll (z-y'-x''), in degrees. Every function here is
built from operations that IEEE 754 rounds correctly (+, -, *, /, remainder), so
the simulated world is the same to the last bit on every host; the C library's
`sin` and `cos` are not.
"""

from __future__ import annotations

import math
from collections.abc import Iterable
from dataclasses import dataclass
from typing import TypeAlias

import numpy as np
from numpy.typing import ArrayLike, NDArray

Matrix: TypeAlias = NDArray[np.float64]
Rows: TypeAlias = tuple[tuple[float, float, float], tuple[float, float, float], tuple[float, float, float]]

_RADIANS_PER_DEGREE = math.pi / 180.0
# Taylor coefficients, alternating signs, highest power first. On |angle| <= 45
# degrees the first omitted term is below 2e-17 of the result: under half an ulp.
_SINE_TERMS = tuple((-1.0) ** k / math.factorial(2 * k + 1) for k in range(8, -1, -1))
_COSINE_TERMS = tuple((-1.0) ** k / math.factorial(2 * k) for k in range(8, -1, -1))
# Below this cosine of pitch, heading and roll turn about the same axis to within double rounding.
_GIMBAL_LOCK_COSINE = 1e-12


@dataclass(frozen=True, slots=True)
class Pose:
    """Attitude of the body in the earth frame, z-y'-x'' [deg]."""

    heading_deg: float
    pitch_deg: float = 0.0
    roll_deg: float = 0.0


def wrap_180(angle_deg: float) -> float:
    """Bring an angle into (-180, 180] [deg].

    Examples
    --------
    >>> wrap_180(350.0), wrap_180(-180.0)
    (-10.0, 180.0)
    """
    rest = math.remainder(angle_deg, 360.0)
    return 180.0 if rest == -180.0 else rest + 0.0  # + 0.0 turns a negative zero positive


def wrap_360(angle_deg: float) -> float:
    """Bring an angle into [0, 360) [deg].

    Examples
    --------
    >>> wrap_360(-90.0), wrap_360(360.0)
    (270.0, 0.0)
    """
    rest = math.fmod(angle_deg, 360.0)
    if rest < 0.0:
        rest += 360.0
    return 0.0 if rest >= 360.0 else rest + 0.0  # a tiny negative angle rounds up to 360 itself


def heading_error_deg(measured_deg: float, reference_deg: float) -> float:
    """Return measured minus reference heading, the short way round, in (-180, 180] [deg].

    Examples
    --------
    >>> heading_error_deg(1.0, 359.0)
    2.0
    """
    return wrap_180(wrap_180(measured_deg) - wrap_180(reference_deg))


def circular_mean_deg(angles_deg: Iterable[float]) -> float:
    """Return the direction of the sum of unit vectors, in [0, 360) [deg].

    Raises
    ------
    ValueError
        If there are no angles, or they cancel so that their mean has no direction.
    """
    pairs = [sin_cos_deg(angle) for angle in angles_deg]
    if not pairs:
        raise ValueError("no angles to average")
    sine = math.fsum(pair[0] for pair in pairs) / len(pairs)
    cosine = math.fsum(pair[1] for pair in pairs) / len(pairs)
    if math.hypot(sine, cosine) < 1e-9:
        raise ValueError("the angles cancel: their mean has no direction")
    return wrap_360(math.degrees(math.atan2(sine, cosine)))


def sin_cos_deg(angle_deg: float) -> tuple[float, float]:
    """Return sine and cosine of an angle in degrees, the same on every host.

    The result is exact at multiples of 90 degrees, and within 1.5 ulp elsewhere.

    Examples
    --------
    >>> sin_cos_deg(90.0)
    (1.0, 0.0)
    """
    rest_deg = math.remainder(angle_deg, 90.0)
    quarter = round((angle_deg - rest_deg) / 90.0)
    radians = rest_deg * _RADIANS_PER_DEGREE
    square = radians * radians
    sine = cosine = 0.0
    for term in _SINE_TERMS:
        sine = sine * square + term
    for term in _COSINE_TERMS:
        cosine = cosine * square + term
    sine *= radians
    turned = ((sine, cosine), (cosine, -sine), (-sine, -cosine), (-cosine, sine))[quarter % 4]
    return turned[0] + 0.0, turned[1] + 0.0


def rotation_rows(pose: Pose) -> Rows:
    """Return `rotation_body_from_ned` as plain tuples, for code that samples one instant at a time."""
    sin_h, cos_h = sin_cos_deg(pose.heading_deg)
    sin_p, cos_p = sin_cos_deg(pose.pitch_deg)
    sin_r, cos_r = sin_cos_deg(pose.roll_deg)
    return (
        (cos_p * cos_h, cos_p * sin_h, -sin_p),
        (sin_r * sin_p * cos_h - cos_r * sin_h, sin_r * sin_p * sin_h + cos_r * cos_h, sin_r * cos_p),
        (cos_r * sin_p * cos_h + sin_r * sin_h, cos_r * sin_p * sin_h - sin_r * cos_h, cos_r * cos_p),
    )


def rotation_body_from_ned(pose: Pose) -> Matrix:
    """Return the matrix that transforms earth-frame components to body-frame components.

    Parameters
    ----------
    pose
        Attitude; any angles, also beyond +-90 degrees of pitch.

    Returns
    -------
    ndarray, shape (3, 3)
        ``v_body = R @ v_ned``; ``R = Rx(roll) Ry(pitch) Rz(heading)``.
    """
    return np.array(rotation_rows(pose), dtype=np.float64)


def pose_from_rotation(rotation: ArrayLike) -> Pose:
    """Return the pose of a rotation matrix, the inverse of `rotation_body_from_ned`.

    Parameters
    ----------
    rotation : shape (3, 3)
        Matrix that transforms earth-frame components to body-frame components.

    Returns
    -------
    Pose
        Heading in [0, 360), pitch in [-90, 90], roll in (-180, 180]. At +-90
        degrees of pitch heading and roll turn about one axis: roll is then 0.

    Raises
    ------
    ValueError
        If the matrix is not a rotation to within 1e-6.
    """
    matrix = np.asarray(rotation, dtype=np.float64)
    if matrix.shape != (3, 3) or not np.allclose(matrix @ matrix.T, np.eye(3), atol=1e-6):
        raise ValueError("not a rotation: the rows are not orthonormal")
    if np.linalg.det(matrix) < 0.0:
        raise ValueError("not a rotation: a reflection")
    cos_pitch = math.hypot(matrix[1, 2], matrix[2, 2])
    pitch_deg = math.degrees(math.atan2(-matrix[0, 2], cos_pitch))
    if cos_pitch < _GIMBAL_LOCK_COSINE:
        return Pose(wrap_360(math.degrees(math.atan2(-matrix[1, 0], matrix[1, 1]))), pitch_deg, 0.0)
    return Pose(
        wrap_360(math.degrees(math.atan2(matrix[0, 1], matrix[0, 0]))),
        pitch_deg,
        wrap_180(math.degrees(math.atan2(matrix[1, 2], matrix[2, 2]))),
    )
