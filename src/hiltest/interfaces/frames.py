"""Conventions of axes and angles, and their conversion to hiltest's: body x forward, y right, z down."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from hiltest.orientation.angles import wrap_360

_SAME = ((1.0, 0.0, 0.0), (0.0, 1.0, 0.0), (0.0, 0.0, 1.0))
# x right, y forward, z up
_RIGHT_FORWARD_UP = ((0.0, 1.0, 0.0), (1.0, 0.0, 0.0), (0.0, 0.0, -1.0))


@dataclass(frozen=True, slots=True)
class Frame:
    """A convention."""

    to_body: tuple[tuple[float, ...], ...]
    """Matrix from the firmware's axes to hiltest's."""
    gravity_sign: float
    """1 if a level board's accelerometer reads gravity, -1 if it reads the reaction force."""
    clockwise: bool
    """True if headings increase clockwise, seen from above."""
    zero_deg: float = 0.0
    """Compass heading at which the firmware's heading is 0: 90 for east."""
    chip_to_body: tuple[tuple[float, ...], ...] | None = None
    """Matrix from the magnetometer chip's axes to hiltest's; None if raw readings are along the firmware's axes."""

    def vector(self, numbers: ArrayLike) -> NDArray[np.float64]:
        """Return a vector in hiltest's axes."""
        return np.array(self.to_body) @ np.asarray(numbers, dtype=np.float64)

    def gravity(self, numbers: ArrayLike) -> NDArray[np.float64]:
        """Return an accelerometer reading as gravity in hiltest's axes, down positive."""
        return self.gravity_sign * self.vector(numbers)

    def raw_field(self, numbers: ArrayLike) -> NDArray[np.float64]:
        """Return a raw reading of the magnetometer, or a hard iron, in hiltest's axes."""
        return np.array(self.chip_to_body or self.to_body) @ np.asarray(numbers, dtype=np.float64)

    def soft_iron(self, numbers: ArrayLike) -> NDArray[np.float64]:
        """Return a matrix of raw readings in hiltest's axes."""
        turn = np.array(self.chip_to_body or self.to_body)
        return np.asarray(turn @ np.reshape(np.asarray(numbers, dtype=np.float64), (3, 3)) @ turn.T)

    def heading_deg(self, angle_deg: float) -> float:
        """Return the compass heading: from magnetic north, clockwise, in [0, 360)."""
        return wrap_360(self.zero_deg + (angle_deg if self.clockwise else -angle_deg))


#: NXP's firmware sends a compass heading in all of its frames. ``enu`` is the mathematical convention: the angle of the
#: x axis from east, counterclockwise, with x right and y forward.
FRAMES = {
    "ned": Frame(_SAME, 1.0, clockwise=True),
    "android": Frame(_RIGHT_FORWARD_UP, -1.0, clockwise=True),
    "windows": Frame(_RIGHT_FORWARD_UP, 1.0, clockwise=True),
    "enu": Frame(_RIGHT_FORWARD_UP, -1.0, clockwise=False),
}
