"""The plane that readings of a turn about one axis lie in."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from hiltest.calibration.fit import Array

#: Largest rms thickness relative to the radius of readings from a turn in a plane. A hand that tilts by 3 degrees makes
#: it 5 %.
FLAT = 0.05
#: rms distance from a circle or ellipse, relative to the radius, above which readings fill the plane, like those of a
#: small cap.
RING = 0.1


@dataclass(frozen=True, slots=True, eq=False)
class Plane:
    """A plane through readings."""

    middle: Array
    """Shape (3,). Mean of the readings, in their unit."""
    axes: Array
    """Shape (3, 3). A rotation; rows are unit vectors in the sensor's axes: two in the plane, then its normal."""
    thickness: float
    """rms distance of the readings from it, in their unit."""

    @classmethod
    def fit(cls, points: Array) -> Plane:
        """Return the plane that fits readings best, shape (n, 3), n >= 1."""
        middle: Array = points.mean(axis=0)
        away = points - middle
        variances, axes = np.linalg.eigh(away.T @ away / len(points))
        normal, across = axes[:, 0], axes[:, 2]
        if normal[np.abs(normal).argmax()] < 0.0:
            normal = -normal
        return cls(middle, np.array([across, np.cross(normal, across), normal]), math.sqrt(max(0.0, variances[0])))

    @property
    def axis(self) -> str:
        """Name of the sensor axis that is nearest to its normal."""
        return "xyz"[int(np.abs(self.axes[2]).argmax())]

    @property
    def tilt_deg(self) -> float:
        """Angle between its normal and that axis."""
        *others, nearest = np.sort(np.abs(self.axes[2])).tolist()
        return math.degrees(math.atan2(math.hypot(*others), nearest))
