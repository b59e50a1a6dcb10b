"""A motion that turns and tilts at once, like that of a carried device."""

from __future__ import annotations

import math
from dataclasses import dataclass

from hiltest.orientation.angles import Pose, sin_cos_deg
from hiltest.world.earth_field import Vector

#: Duration of a sway [s], for which the rates below hold.
SWAY_S = 24.0
# One and a half turns, at 42 deg/s at most, so that the error by a gyroscope's scale does not return to zero.
_HEADING_DEG = 540.0
# Amplitudes like the tilts of the known angles, with 29 and 39 deg/s at most; all headings occur with all tilts.
_TILT_DEG = 20.0
_PITCH_WAVES, _ROLL_WAVES = 3, 4


@dataclass(frozen=True, slots=True)
class Sway:
    """One and a half turns from rest to rest, level at both, with oscillating pitch and roll."""

    start_s: float
    end_s: float
    """Start and end, virtual time [s]."""
    heading_deg: float = 0.0
    """Heading of the level table at the start."""

    def angles(self, time_s: float) -> tuple[Pose, Vector]:
        """Return the pose and the rates of its angles [deg/s]; it stands still at both ends.

        Notes
        -----
        All angles are functions of one share that goes from 0 to 1 as a quintic, without a step
        in speed or acceleration.
        """
        duration_s = self.end_s - self.start_s
        u = min(max((time_s - self.start_s) / duration_s, 0.0), 1.0)
        share = u * u * u * (10.0 + u * (6.0 * u - 15.0))
        speed = 30.0 * u * u * (1.0 + u * (u - 2.0)) / duration_s
        pitch, pitch_slope = _wave(_PITCH_WAVES, share)
        roll, roll_slope = _wave(_ROLL_WAVES, share)
        pose = Pose(self.heading_deg + _HEADING_DEG * share, pitch, roll)
        return pose, (speed * _HEADING_DEG, speed * pitch_slope, speed * roll_slope)


def _wave(waves: int, share: float) -> tuple[float, float]:
    """Return an oscillating angle [deg] and its slope over the share."""
    sine, cosine = sin_cos_deg(360.0 * waves * share)
    return _TILT_DEG * sine, _TILT_DEG * cosine * 2.0 * math.pi * waves
