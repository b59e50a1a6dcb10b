"""Axes of a magnetometer and an accelerometer, named from their readings at known attitudes."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from hiltest.calibration.axes import Axes, LinearMap, linear_map
from hiltest.calibration.fit import Array

# Largest ratio of residuals at which one sign of the dip is preferred to the other.
_CLEARLY_LESS = 0.5


@dataclass(frozen=True, slots=True)
class SensorAxes:
    """Axes of both sensors; None if the attitudes do not show them."""

    magnetometer: Axes | None
    accelerometer: Axes | None
    dip_may_be_opposite: bool = False
    """True if right axes in a field of the opposite dip would give the same readings."""
    dip_is_opposite: bool = False
    """True if only the opposite dip explains the readings."""
    is_level: bool = False
    """True if all attitudes are level, so that a rotation of the part about z equals one of the board."""

    @property
    def explain_headings(self) -> bool:
        """True if wrong axes are the only explanation of the headings."""
        wrong = [axes for axes in (self.magnetometer, self.accelerometer) if axes is not None and not axes.are_right]
        return bool(wrong) and not (self.is_level and all(axes.turn_about_z for axes in wrong))

    @property
    def are_as_declared(self) -> bool:
        """True if the magnetometer's axes and the sign of the dip are confirmed, and no axes are wrong."""
        return self.magnetometer is not None and not str(self)

    def __str__(self) -> str:
        """Describe the wrong axes; empty without any, or if unknown."""
        wrong = {
            name: axes
            for name, axes in (("magnetometer", self.magnetometer), ("accelerometer", self.accelerometer))
            if axes is not None and not axes.are_right
        }
        if len(wrong) > 1 and self.magnetometer == self.accelerometer:
            turned = self.magnetometer is not None and not self.magnetometer.are_left_handed
            both = "magnetometer and accelerometer alike"
            return f"{f'board ({both})' if turned else both}: {self.magnetometer}"
        descriptions = [f"{name}: {axes}" for name, axes in wrong.items()]
        if self.dip_may_be_opposite or self.dip_is_opposite:
            descriptions.append("the dip has the opposite sign of the declared one")
        return (", or " if self.dip_may_be_opposite else "; ").join(descriptions)


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
        Hard iron of a calibration, used if all attitudes are level and so do not show it.

    Notes
    -----
    On a level board, a field of the opposite dip gives the same readings as a negated z axis. Tilted, the two differ,
    and the residual decides.
    """

    def estimate_map(reference: Array) -> LinearMap | None:
        linear = linear_map(reference, magnetometer)
        return (
            linear if linear is not None or hard_iron is None else linear_map(reference, magnetometer, offset=hard_iron)
        )

    # Its offset is small compared with 1 g, and tilts of 20 degrees hardly separate it from a gain.
    gravity_map = linear_map(gravity, accelerometer, offset=np.zeros(3))
    by_gravity = None if gravity_map is None else gravity_map.axes
    declared = estimate_map(field)
    opposite = estimate_map(field - 2.0 * (field * gravity).sum(axis=1, keepdims=True) * gravity)
    if declared is None or opposite is None:
        return SensorAxes(None, by_gravity)
    axes, is_level = declared.axes, linear_map(field, magnetometer) is None
    if not opposite.is_right or declared.is_right:
        return SensorAxes(axes, by_gravity, is_level=is_level)
    is_opposite = opposite.residual < _CLEARLY_LESS * declared.residual
    return SensorAxes(
        None if is_opposite else axes,
        by_gravity,
        dip_may_be_opposite=axes is not None and not is_opposite,
        dip_is_opposite=is_opposite,
        is_level=is_level,
    )
