"""Axes of a magnetometer and an accelerometer, named from their readings at known attitudes."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from hiltest.calibration.axes import Axes, LinearMap, linear_map
from hiltest.calibration.fit import Array

# Of two signs of the dip the one that leaves less than half of what the other does.
_CLEARLY_LESS = 0.5


@dataclass(frozen=True, slots=True)
class SensorAxes:
    """Axes of both sensors; None where the attitudes do not show them."""

    magnetometer: Axes | None
    accelerometer: Axes | None
    dip_may_be_opposite: bool = False
    """The same readings are those of right axes in a field of the opposite dip."""
    dip_is_opposite: bool = False
    """They are, and they are not those of any axes in the declared one."""
    is_level: bool = False
    """All attitudes are level: a turn of the part about z is then the same as one of the board."""

    @property
    def explain_headings(self) -> bool:
        """Whether they are not the board's, and nothing else looks like it."""
        wrong = [each for each in (self.magnetometer, self.accelerometer) if each is not None and not each.are_right]
        return bool(wrong) and not (self.is_level and all(each.turn_about_z for each in wrong))

    @property
    def are_as_declared(self) -> bool:
        """Whether the magnetometer's axes and the sign of the dip are known to be right, and no others to be wrong."""
        return self.magnetometer is not None and not str(self)

    def __str__(self) -> str:
        """Return what is wrong with them; empty where nothing is, or nothing is known."""
        wrong = {
            name: axes for name, axes in (("magnetometer", self.magnetometer), ("accelerometer", self.accelerometer))
            if axes is not None and not axes.are_right
        }
        if len(wrong) > 1 and self.magnetometer == self.accelerometer:
            turned = self.magnetometer is not None and not self.magnetometer.are_left_handed
            both = "magnetometer and accelerometer alike"
            return f"{f'board ({both})' if turned else both}: {self.magnetometer}"
        said = [f"{name}: {axes}" for name, axes in wrong.items()]
        if self.dip_may_be_opposite or self.dip_is_opposite:
            said.append("the dip has the opposite sign of the declared one")
        return (", or " if self.dip_may_be_opposite else "; ").join(said)


def sensor_axes(
    field: Array, gravity: Array, magnetometer: Array, accelerometer: Array, *, hard_iron: Array | None = None
) -> SensorAxes:
    """Estimate the axes of both sensors.

    Parameters
    ----------
    field, gravity : shape (n, 3)
        Known vectors along the board's axes at each attitude, gravity of length 1.
    magnetometer, accelerometer : shape (n, 3)
        Readings [counts].
    hard_iron : shape (3,)
        Of a calibration. It counts where the attitudes are all level: these do not show it.

    Notes
    -----
    A field of the opposite dip makes the readings of a magnetometer whose z axis is negated, as long as the board is
    level. Tilted, the two differ, and what is left of the readings decides.
    """
    def of(known: Array) -> LinearMap | None:
        found = linear_map(known, magnetometer)
        return found if found is not None or hard_iron is None else linear_map(known, magnetometer, offset=hard_iron)

    # Its offset is small beside 1 g, and tilts of 20 degrees tell it from a gain badly.
    gravity_map = linear_map(gravity, accelerometer, offset=np.zeros(3))
    by_gravity = None if gravity_map is None else gravity_map.axes
    declared, opposite = of(field), of(field - 2.0 * (field * gravity).sum(axis=1, keepdims=True) * gravity)
    if declared is None or opposite is None:
        return SensorAxes(None, by_gravity)
    found, is_level = declared.axes, linear_map(field, magnetometer) is None
    if not opposite.is_right or declared.is_right:
        return SensorAxes(found, by_gravity, is_level=is_level)
    is_opposite = opposite.residual < _CLEARLY_LESS * declared.residual
    return SensorAxes(
        None if is_opposite else found, by_gravity, dip_may_be_opposite=found is not None and not is_opposite,
        dip_is_opposite=is_opposite, is_level=is_level,
    )
