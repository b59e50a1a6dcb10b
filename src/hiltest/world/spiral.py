"""A tumble that limits the field's direction in the body frame to a part of the sphere."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from hiltest.orientation.angles import Pose, pose_from_rotation, sin_cos_deg
from hiltest.world.earth_field import EarthField, Vector
from hiltest.world.motion import angle_rates_dps

#: Time of the field from the middle of the part to its rim [s]. 512 points, the firmware's capacity, take at most 9.6 s
#: with the slowest magnetometer, so a spiral is slower than any sensor.
SPIRAL_S = 12.5
# Rate about the axis, 14 turns in total. With 300 points a turn has 21.39 of them: because of that fraction, near the
# golden ratio's 0.38, each turn's points are between those of earlier turns, not on spokes.
_SPIN_DPS = 404.0
# Share of the part's area that is omitted at both ends: at the centre, and opposite to it, the tilt would be infinitely
# fast.
_LEFT_OUT = 0.002
# Rounding, because atan2 and a matrix product may differ in the last bits between hosts, by 1e-13 degrees.
_DECIMALS = 9


@dataclass(frozen=True, slots=True)
class Cap:
    """A part of the sphere: all directions within an angle of an axis."""

    axis: Vector
    """Axis in the body frame, of any length but zero."""
    fraction: float
    """Share of the sphere's area, above 0 and at most 1; the angle is ``acos(1 - 2 fraction)``."""


@dataclass(frozen=True, slots=True)
class Spiral:
    """A tumble in which the true field's direction in the body frame runs evenly over a cap.

    The body spins about the cap's axis while that axis tilts away from the field. Equal times see equal
    areas: points taken at a constant rate are as dense at the rim as in the middle, and those of any
    part of the time lie on a ring.
    """

    start_s: float
    end_s: float
    """Start and end, virtual time [s]; `SPIRAL_S` apart for the whole cap."""
    cap: Cap
    field: EarthField
    mounting_yaw_deg: float
    """Yaw of the board on the table, which the table's poses compensate."""

    def angles(self, time_s: float) -> tuple[Pose, Vector]:
        """Return the table's pose and its angle rates [deg/s]; from `end_s` on it stands still.

        Notes
        -----
        With the field along z of one frame and the cap's axis along z of another, the body is turned by ``A Rz(spin)
        Ry(tilt) F'``, where the columns of F and A are those frames; the tilt's cosine is ``1 - 2 fraction share``,
        linear in time, so that areas are equal (Archimedes).
        """
        duration_s = self.end_s - self.start_s
        elapsed_s = min(time_s, self.end_s) - self.start_s
        share = _LEFT_OUT + (1.0 - 2.0 * _LEFT_OUT) * elapsed_s / duration_s
        cos_tilt = 1.0 - 2.0 * self.cap.fraction * share
        sin_tilt = math.sqrt(1.0 - cos_tilt * cos_tilt)
        sin_spin, cos_spin = sin_cos_deg(_SPIN_DPS * elapsed_s)
        axes = _axis_frame(self.cap.axis)
        spun = axes @ np.array([[cos_spin, -sin_spin, 0.0], [sin_spin, cos_spin, 0.0], [0.0, 0.0, 1.0]])
        tilted = spun @ np.array([[cos_tilt, 0.0, sin_tilt], [0.0, 1.0, 0.0], [-sin_tilt, 0.0, cos_tilt]])
        board = pose_from_rotation(tilted @ _field_frame(self.field).T)
        pose = Pose(
            round(board.heading_deg - self.mounting_yaw_deg, _DECIMALS),
            round(board.pitch_deg, _DECIMALS),
            round(board.roll_deg, _DECIMALS),
        )
        if time_s >= self.end_s:
            return pose, (0.0, 0.0, 0.0)
        tilt_dps = math.degrees(2.0 * self.cap.fraction * (1.0 - 2.0 * _LEFT_OUT) / duration_s / sin_tilt)
        x, y, z = (-(_SPIN_DPS * axes[:, 2] + tilt_dps * spun[:, 1])).tolist()
        return pose, angle_rates_dps(pose, (x, y, z))


def _axis_frame(axis: Vector) -> NDArray[np.float64]:
    """Return a right-handed frame with a given z axis, as columns."""
    z = np.array(axis) / math.hypot(*axis)
    beside = np.zeros(3)
    beside[int(np.abs(z).argmin())] = 1.0
    x = np.cross(beside, z)
    x /= math.hypot(*x.tolist())
    return np.column_stack([x, np.cross(z, x), z])


def _field_frame(field: EarthField) -> NDArray[np.float64]:
    """Return the frame whose z is the field and whose y is east, as columns in the earth frame."""
    sin_dip, cos_dip = sin_cos_deg(field.dip_deg)
    return np.array([[sin_dip, 0.0, cos_dip], [0.0, 1.0, 0.0], [-cos_dip, 0.0, sin_dip]])
