"""Errors of an accelerometer."""

from __future__ import annotations

from dataclasses import dataclass

from hiltest.world import Vector
from hiltest.world.sensors.drift import Drift


@dataclass(frozen=True, slots=True)
class AccelerometerErrors:
    """Errors and drift of the accelerometer, body frame: ``(I + diag(gain_error) + cross_axis) @ g + offset_g``."""

    offset_g: Vector = (0.0, 0.0, 0.0)
    gain_error: Vector = (0.0, 0.0, 0.0)
    cross_axis: tuple[Vector, Vector, Vector] = ((0.0, 0.0, 0.0), (0.0, 0.0, 0.0), (0.0, 0.0, 0.0))
    drift: Drift = Drift()  # noqa: RUF009 - frozen, so it may be shared

    def apply(self, gravity_body_g: Vector, temperature_degc: float) -> Vector:
        """Return gravity as the part measures it at a temperature [g]."""
        x, y, z = gravity_body_g
        (xx, xy, xz), (yx, yy, yz), (zx, zy, zz) = self.cross_axis
        measured = (
            x + self.gain_error[0] * x + (xx * x + xy * y + xz * z) + self.offset_g[0],
            y + self.gain_error[1] * y + (yx * x + yy * y + yz * z) + self.offset_g[1],
            z + self.gain_error[2] * z + (zx * x + zy * y + zz * z) + self.offset_g[2],
        )
        return self.drift.apply(measured, temperature_degc)
