"""The earth's magnetic field and gravity at the bench."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TypeAlias

from hiltest.orientation.angles import Rows, sin_cos_deg

Vector: TypeAlias = tuple[float, float, float]

#: Gravity in the earth frame NED [g]: down.
GRAVITY_NED_G: Vector = (0.0, 0.0, 1.0)


@dataclass(frozen=True, slots=True)
class EarthField:
    """Local geomagnetic field; the earth frame's north is *magnetic* north."""

    strength_ut: float
    """Total intensity [uT]."""
    dip_deg: float
    """Inclination, positive down [deg]."""
    declination_deg: float = 0.0
    """Angle of magnetic north east of true north [deg]; for information, no heading uses it."""

    @property
    def ned_ut(self) -> Vector:
        """Field in the earth frame NED [uT]."""
        sin_dip, cos_dip = sin_cos_deg(self.dip_deg)
        return (self.strength_ut * cos_dip, 0.0, self.strength_ut * sin_dip)


def apply_rows(rows: Rows, vector: Vector) -> Vector:
    """Multiply a 3x3 matrix by a vector, with a fixed order of roundings.

    A matrix product of a linear-algebra library may fuse multiply and add or sum in another order on different hosts,
    but samples of the simulated world must be equal.
    """
    x, y, z = vector
    (a, b, c), (d, e, f), (g, h, i) = rows
    return (a * x + b * y + c * z, d * x + e * y + f * z, g * x + h * y + i * z)
