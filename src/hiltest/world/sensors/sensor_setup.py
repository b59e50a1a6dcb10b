"""Surroundings of one part: world, place on the board, and the truth of its errors."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field

from hiltest.world import MagneticDistortion, Vector, World
from hiltest.world.distortion import IDENTITY
from hiltest.world.earth_field import apply_rows
from hiltest.world.recorded_motion import Sensed
from hiltest.world.sensors.accelerometer_errors import AccelerometerErrors
from hiltest.world.sensors.drift import Drift


@dataclass(frozen=True, slots=True)
class SensorSetup:
    """World and truth of a part, all in the body frame."""

    world: World
    seed: int = 1
    name: str = ""
    """Distinguishes the noise of two parts of one kind at the same address."""
    address: int | None = None
    """7-bit address; None for the part's first."""
    axes: tuple[str, str, str] = ("x", "y", "z")
    """Axes of the part along x, y and z of the body, such as ``-y``."""
    distortion: MagneticDistortion = MagneticDistortion()  # noqa: RUF009 - frozen, so it may be shared
    """Distortion between the earth's field and the magnetometer, its own offset included."""
    accelerometer: AccelerometerErrors = AccelerometerErrors()  # noqa: RUF009
    gyroscope_response: tuple[Vector, Vector, Vector] = IDENTITY
    """Gains and misalignment: matrix from the true to the measured rate, before the bias."""
    gyroscope_bias_dps: Vector = (0.0, 0.0, 0.0)
    gyroscope_drift: Drift = Drift()  # noqa: RUF009
    magnetometer_drift: Drift | None = None
    """None for the temperature coefficient of the part's table."""
    noise: Mapping[Sensed, float] = field(default_factory=dict)
    """Rms noise of an axis in place of the data sheet's, at all settings [unit of the quantity]."""
    companion_address: int | None = None
    """7-bit address of the further device in the package; None for its first."""

    def felt(self, quantity: Sensed, time_s: float, drift: Drift) -> Vector:
        """Return the reading of a sensor without noise, in the quantity's unit.

        Parameters
        ----------
        drift
            Drift of the magnetometer without `magnetometer_drift`.
        """
        world, degc = self.world, self.world.temperature_degc(time_s)
        if quantity is Sensed.MAGNETOMETER:
            return (self.magnetometer_drift or drift).apply(world.field_at_part_ut(self.distortion, time_s), degc)
        state = world.state_at(time_s)
        if quantity is Sensed.ACCELEROMETER:
            return self.accelerometer.apply(state.gravity_body_g, degc)
        (x, y, z), bias = apply_rows(self.gyroscope_response, state.rate_body_dps), self.gyroscope_bias_dps
        return self.gyroscope_drift.apply((x + bias[0], y + bias[1], z + bias[2]), degc)
