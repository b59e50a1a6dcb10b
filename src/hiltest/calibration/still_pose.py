"""Readings of magnetometer and accelerometer while the board stood still."""

from __future__ import annotations

from dataclasses import dataclass
from enum import IntEnum

import numpy as np
from numpy.typing import NDArray

from hiltest.orientation.angles import Pose

Reals = NDArray[np.float64]


class Face(IntEnum):
    """Body axis that is down, or none: body frame x forward, y right, z down.

    An axis that is down reads gravity with its own sign: a level board, `PLUS_Z`, reads (0, 0, +1) g.
    """

    PLUS_X = 0
    MINUS_X = 1
    PLUS_Y = 2
    MINUS_Y = 3
    PLUS_Z = 4
    MINUS_Z = 5
    NONE = 255

    @property
    def gravity_g(self) -> tuple[float, float, float]:
        """Gravity in the body frame on this face [g]."""
        if self is Face.NONE:
            raise ValueError("a pose that is no face has no gravity that is known before")
        axis, sign = self // 2, 1.0 - 2.0 * (self % 2)
        x, y, z = (sign if index == axis else 0.0 for index in range(3))
        return x, y, z

    @property
    def label(self) -> str:
        """Axis that is down, with its sign: ``-y``."""
        if self is Face.NONE:
            return "none"
        return "+-"[self % 2] + "xyz"[self // 2]

    @property
    def pose(self) -> Pose:
        """Pose of the table that puts the board on this face, with any heading."""
        return _POSES[self]


# A nose that points up has pitch +90, and reads gravity along -x; the right side is down with roll +90.
_POSES = {
    Face.PLUS_X: Pose(0.0, -90.0, 0.0),
    Face.MINUS_X: Pose(0.0, 90.0, 0.0),
    Face.PLUS_Y: Pose(0.0, 0.0, 90.0),
    Face.MINUS_Y: Pose(0.0, 0.0, -90.0),
    Face.PLUS_Z: Pose(0.0, 0.0, 0.0),
    Face.MINUS_Z: Pose(0.0, 0.0, 180.0),
}

#: The six faces, in the order of their numbers.
FACES = tuple(face for face in Face if face is not Face.NONE)


@dataclass(frozen=True, slots=True, eq=False)
class StillPose:
    """Means and sample standard deviations of new samples of each sensor [counts, body frame].

    Attributes
    ----------
    magnetometer, accelerometer : ndarray, shape (3,)
        Means.
    magnetometer_spread, accelerometer_spread : ndarray, shape (3,), or None
        None for a single sample.
    """

    magnetometer: Reals
    magnetometer_spread: Reals | None
    accelerometer: Reals
    accelerometer_spread: Reals | None
    readings: int
    """Number of readings of each sensor."""
    face: Face = Face.NONE
    """Requested face of the pose."""
