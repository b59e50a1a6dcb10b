"""LIS3MDL three-axis magnetometer.

The table has the sources. The data sheet gives the noise of one performance mode only; that of the others follows from
their conversion times, the periods of the fast data rates, for white noise. Reads are in blocks whatever BDU says.
"""

from __future__ import annotations

import math

from hiltest.world import Vector
from hiltest.world.recorded_motion import Sensed
from hiltest.world.sensors.drift import REFERENCE_DEGC
from hiltest.world.sensors.register_table import read_table
from hiltest.world.sensors.table_sensor import TableSensor

_UT_PER_GAUSS = 100.0
_SINGLE, _POWER_DOWN = 1, 3  # operating modes; 2 is power-down as well
_LOW_POWER, _BEST = 0, 3  # performance modes


class Lis3mdl(TableSensor):
    """The part over I2C or SPI, along its own axes."""

    table = read_table(__file__)

    def rate_hz(self, quantity: Sensed) -> float:
        """Return the data rate; the performance mode determines a fast one."""
        data = self.table.data
        if self.field("operating mode") > _SINGLE:
            return 0.0
        if self.field("low-power mode"):
            return float(data["rates_hz"][0])
        if self.field("fast data rate"):
            return float(data["fast_rates_hz"][self.field("performance of x and y")])
        return float(data["rates_hz"][self.field("data rate")])

    def counts_per_unit(self, quantity: Sensed) -> float:
        """Return the sensitivity at the full scale."""
        return float(self.table.data["counts_per_gauss"][self.field("full scale")]) / _UT_PER_GAUSS

    def noise(self, quantity: Sensed) -> Vector:
        """Return the noise by performance mode."""
        rates_hz = self.table.data["fast_rates_hz"]
        modes = [self.field(f"performance of {axes}") for axes in ("x and y", "x and y", "z")]
        if self.field("low-power mode"):
            modes = [_LOW_POWER] * 3
        x, y, z = (
            noise_ut * math.sqrt(rates_hz[mode] / rates_hz[_BEST])
            for noise_ut, mode in zip(self.table.data["noise_ut"], modes, strict=True)
        )
        return x, y, z

    def is_single(self, quantity: Sensed) -> bool:
        """Return whether a single conversion is asked for."""
        return self.field("operating mode") == _SINGLE

    def finish_single(self, quantity: Sensed) -> None:
        """Enter power-down."""
        self.set_field("operating mode", _POWER_DOWN)

    def added(self, quantity: Sensed) -> Vector:
        """Return the field of the self-test."""
        x, y, z = (self.field("self-test") * field_ut for field_ut in self.table.data["self_test_ut"])
        return x, y, z

    def computed(self, register: str, time_s: float) -> int | None:
        """Return the temperature."""
        if register != "TEMP_OUT_L":
            return None
        degc = self.setup.world.temperature_degc(time_s) - REFERENCE_DEGC
        counts: float = degc * self.table.data["temperature_counts_per_degc"]
        return self.field("temperature sensor") * round(counts)

    def interrupt_levels(self, time_s: float) -> tuple[bool, ...]:
        """Return INT, which the model leaves low, and DRDY, high from a new sample until it is read."""
        return False, bool(self.outputs[0].status(time_s) & 0x08)
