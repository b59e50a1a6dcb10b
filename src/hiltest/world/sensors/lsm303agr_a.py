"""LSM303AGR accelerometer, a die of its own beside the magnetometer; the table has the sources.

Reads are in blocks whatever BDU says. All modes have the same noise here; the coarser words of the normal and the
low-power mode add their rounding.
"""

from __future__ import annotations

from hiltest.world import Vector
from hiltest.world.recorded_motion import Sensed
from hiltest.world.sensors.drift import REFERENCE_DEGC
from hiltest.world.sensors.lsm303agr_m import Lsm303agrM
from hiltest.world.sensors.register_table import read_table
from hiltest.world.sensors.sampling import Counts, limited
from hiltest.world.sensors.table_sensor import TableSensor

_WORD_BITS = 16
_HIGH_RESOLUTION, _LOW_POWER = 1, 2  # modes; 0 is the normal one
_MG_PER_G = 1000.0


class Lsm303agrA(TableSensor):
    """The accelerometer over I2C or SPI, along the axes of the package; the magnetometer is its companion."""

    table = read_table(__file__)
    companion_models = (Lsm303agrM,)

    def rate_hz(self, quantity: Sensed) -> float:
        """Return the data rate; some codes stop the part, depending on the mode."""
        rates_hz = self.table.data["low_power_rates_hz" if self._mode == _LOW_POWER else "rates_hz"]
        code = self.field("data rate")
        return float(rates_hz[code]) if code < len(rates_hz) else 0.0

    def counts_per_unit(self, quantity: Sensed) -> float:
        """Return the sensitivity by mode and full scale; the word is left-justified."""
        return _MG_PER_G / self._step_mg * (1 << self._unused_bits)

    def noise(self, quantity: Sensed) -> float:
        """Return the noise."""
        return self.table.outputs[0].noise

    def words(self, quantity: Sensed, reading: Vector) -> Counts:
        """Return left-justified words of 8, 10 or 12 bits."""
        unused, step_mg = self._unused_bits, self._step_mg
        limit = (1 << _WORD_BITS - 1 - unused) - 1
        x, y, z = [limited(value * _MG_PER_G / step_mg, limit) << unused for value in reading]
        return x, y, z

    def first_sample_s(self, quantity: Sensed) -> float:
        """Return the turn-on time, which is longer at high resolution."""
        return float(self.table.data["first_sample_periods"][self._mode]) / self.rate_hz(quantity)

    def computed(self, register: str, time_s: float) -> int | None:
        """Return the temperature, left-justified in 10 bits."""
        if register != "OUT_TEMP_L_A":
            return None
        degc = self.setup.world.temperature_degc(time_s) - REFERENCE_DEGC
        counts = round(degc * self.table.data["temperature_counts_per_degc"])
        return counts << 6 if self.field("temperature sensor") else 0

    def interrupt_levels(self, time_s: float) -> tuple[bool, ...]:
        """Return INT_1_XL, which may follow new data, and INT_2_XL, whose sources have no model."""
        ready = bool(self.field("data-ready interrupt on INT_1_XL") and self.outputs[0].status(time_s) & 0x08)
        low = bool(self.field("active-low interrupts"))
        return ready != low, low

    @property
    def _mode(self) -> int:
        if self.field("low-power mode"):
            return _LOW_POWER
        return _HIGH_RESOLUTION if self.field("high resolution") else 0

    @property
    def _step_mg(self) -> float:
        return float(self.table.data["mg"][self._mode][self.field("full scale")])

    @property
    def _unused_bits(self) -> int:
        return _WORD_BITS - int(self.table.data["bits"][self._mode])
