"""LSM6DS3TR-C accelerometer and gyroscope; the table has the sources.

The noise in high performance follows from the density and the bandwidth. Reads are in blocks whatever BDU says.
"""

from __future__ import annotations

import math

from hiltest.world import Vector
from hiltest.world.recorded_motion import Sensed
from hiltest.world.sensors.drift import REFERENCE_DEGC
from hiltest.world.sensors.register_table import read_table
from hiltest.world.sensors.table_sensor import TableSensor

_SLOW_CODE = 11  # data rate of 1.6 Hz, of the accelerometer in low-power mode only
_NEGATIVE = {Sensed.ACCELEROMETER: 2, Sensed.GYROSCOPE: 3}  # self-test
_ONE_OFFSET_G = (2**-10, 2**-6)


class Lsm6ds3trc(TableSensor):
    """The part over I2C or SPI, along the axes of the package."""

    table = read_table(__file__)

    def rate_hz(self, quantity: Sensed) -> float:
        """Return the data rate; codes beyond the table stop a sensor."""
        code, rates_hz = self.field(f"data rate of the {quantity.key}"), self.table.data["rates_hz"]
        if code > _SLOW_CODE:
            return 0.0
        if quantity is Sensed.GYROSCOPE:
            return 0.0 if code == _SLOW_CODE or self.field("sleep of the gyroscope") else float(rates_hz[code])
        is_slow = code == _SLOW_CODE and self.field("accelerometer without high performance")
        return float(self.table.data["slow_rate_hz"] if is_slow else rates_hz[code])

    def counts_per_unit(self, quantity: Sensed) -> float:
        """Return the sensitivity at the full scale."""
        steps = self.table.data["mdps" if quantity is Sensed.GYROSCOPE else "mg"]
        return 1000.0 / float(steps[self._full_scale(quantity)])

    def noise(self, quantity: Sensed) -> float:
        """Return the noise by performance, bandwidth and full scale."""
        data, rate_hz, scale = self.table.data, self.rate_hz(quantity), self._full_scale(quantity)
        is_low = rate_hz <= data["fastest_low_power_hz"] and self.field(f"{quantity.key} without high performance")
        if quantity is Sensed.GYROSCOPE:
            bandwidth_hz = data["bandwidths_hz"][self.field("data rate of the gyroscope")] if rate_hz else 0.0
            return float(data["rms_mdps"] if is_low else data["density_mdps"] * math.sqrt(bandwidth_hz)) * 1e-3
        if self.field("low-pass filter of the accelerometer"):
            divisor = data["filter_divisors"][self.field("cut-off of the accelerometer's filters")]
        else:
            divisor = 4.0 if self.field("quarter of the data rate as bandwidth") else 2.0
        if is_low:
            return float(data["rms_mg"][scale]) * 1e-3 * math.sqrt(2.0 / divisor)
        return float(data["density_ug"][scale]) * 1e-6 * math.sqrt(rate_hz / divisor)

    def added(self, quantity: Sensed) -> Vector:
        """Return the self-test's output and the user offsets, of which that of z is subtracted."""
        mode = self.field(f"self-test of the {quantity.key}")
        sign = 1 if mode == 1 else -1 if mode == _NEGATIVE[quantity] else 0
        if quantity is Sensed.GYROSCOPE:
            dps = sign * float(self.table.data["self_test_dps"][self._full_scale(quantity)])
            return dps, dps, dps
        one_g, self_test_g = _ONE_OFFSET_G[self.field("coarse user offsets")], sign * self.table.data["self_test_g"]
        x, y, z = (((self.field(f"user offset of {axis}") + 128) % 256 - 128) * one_g for axis in "xyz")
        return self_test_g + x, self_test_g + y, self_test_g - z

    def computed(self, register: str, time_s: float) -> int | None:
        """Return the flags of new data, or the temperature, which is measured while a sensor runs."""
        if register == "STATUS_REG":
            return self._new_data(time_s)
        if register != "OUT_TEMP_L":
            return None
        degc = self.setup.world.temperature_degc(time_s) - REFERENCE_DEGC
        runs = self.rate_hz(Sensed.ACCELEROMETER) or self.rate_hz(Sensed.GYROSCOPE)
        return round(degc * self.table.data["counts_per_degc"]) if runs else 0

    def interrupt_levels(self, time_s: float) -> tuple[bool, ...]:
        """Return INT1 and INT2: new data of the selected sensors."""
        data, low = self._new_data(time_s), bool(self.field("active-low interrupts"))
        first, second = (self.field(f"data-ready interrupts on {pin}") for pin in self.pins)
        if self.field("all interrupts on INT1"):
            first, second = first | second, 0
        return bool(data & first) != low, bool(data & second) != low

    def following(self, register: int) -> int:
        """Return the next register of a burst, which may stay."""
        return (register + self.field("moving pointer")) & 0xFF

    def _full_scale(self, quantity: Sensed) -> int:
        if quantity is Sensed.GYROSCOPE and self.field("full scale of 125 dps"):
            return len(self.table.data["mdps"]) - 1
        return self.field(f"full scale of the {quantity.key}")

    def _new_data(self, time_s: float) -> int:
        """Return new data: b0 of the accelerometer, b1 of the gyroscope."""
        return self.is_ready(Sensed.ACCELEROMETER, time_s) | self.is_ready(Sensed.GYROSCOPE, time_s) << 1
