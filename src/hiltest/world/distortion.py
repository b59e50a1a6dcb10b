"""Distortion of the field at a magnetometer by the board's own iron."""

from __future__ import annotations

from dataclasses import dataclass

from hiltest.orientation.angles import Rows
from hiltest.world.earth_field import Vector, apply_rows

IDENTITY: Rows = ((1.0, 0.0, 0.0), (0.0, 1.0, 0.0), (0.0, 0.0, 1.0))


@dataclass(frozen=True, slots=True)
class MagneticDistortion:
    """Constant soft and hard iron, fixed to the body.

    Notes
    -----
    ``measured = soft_iron @ field + hard_iron``. A calibration's `soft_iron` maps in the opposite direction: it is the
    inverse of this one up to a scale (and, for a fit of norms only, up to a rotation, which the heading procedure
    detects).
    """

    soft_iron: Rows = IDENTITY
    """Matrix from the true field to the field at the part, body frame [1]."""
    hard_iron_ut: Vector = (0.0, 0.0, 0.0)
    """Constant field added to it, body frame [uT]."""

    def apply(self, field_body_ut: Vector) -> Vector:
        """Return the field at the part, body frame [uT]."""
        x, y, z = apply_rows(self.soft_iron, field_body_ut)
        return (x + self.hard_iron_ut[0], y + self.hard_iron_ut[1], z + self.hard_iron_ut[2])
