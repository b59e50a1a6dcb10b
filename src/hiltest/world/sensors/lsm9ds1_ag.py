"""LSM9DS1 accelerometer and gyroscope, a die of its own beside the magnetometer; the table has the sources.

The accelerometer has the gyroscope's data rate while that runs. Noise follows from density and bandwidth. Reads are in
blocks whatever BDU says.
"""

from __future__ import annotations

import math

from hiltest.world.recorded_motion import Sensed
from hiltest.world.sensors.drift import REFERENCE_DEGC
from hiltest.world.sensors.lsm9ds1_m import Lsm9ds1M
from hiltest.world.sensors.register_table import read_table
from hiltest.world.sensors.table_sensor import TableSensor

_OUT_X_G, _OUT_X_XL = 0x18, 0x28
_LAST_BYTE = 5  # of three words


class Lsm9ds1Ag(TableSensor):
    """The two sensors over I2C or SPI, along their own axes; the magnetometer is their companion."""

    table = read_table(__file__)
    companion_models = (Lsm9ds1M,)

    def rate_hz(self, quantity: Sensed) -> float:
        """Return the data rate, the same for both sensors while the gyroscope is on."""
        data = self.table.data
        rate_hz = float(data["rates_hz"][self.field("data rate of the gyroscope")])
        if quantity is Sensed.GYROSCOPE:
            return 0.0 if self.field("sleep of the gyroscope") else rate_hz
        rate_hz = rate_hz or float(data["alone_rates_hz"][self.field("data rate of the accelerometer")])
        return rate_hz / (1 << self.field("decimation of accelerations"))

    def counts_per_unit(self, quantity: Sensed) -> float:
        """Return the sensitivity at the full scale."""
        steps = self.table.data["mdps" if quantity is Sensed.GYROSCOPE else "mg"]
        return 1000.0 / float(steps[self.field(f"full scale of the {quantity.key}")])

    def noise(self, quantity: Sensed) -> float:
        """Return the noise by bandwidth."""
        data, rate_code = self.table.data, self.field("data rate of the gyroscope")
        if quantity is Sensed.GYROSCOPE:
            return float(data["density_mdps"]) * 1e-3 * math.sqrt(data["gyroscope_bandwidths_hz"][rate_code])
        rate_code = rate_code or self.field("data rate of the accelerometer")
        bandwidth_hz = data["rate_bandwidths_hz"][rate_code]
        if self.field("own bandwidth"):
            bandwidth_hz = data["bandwidths_hz"][self.field("bandwidth of the accelerometer")]
        return float(data["density_ug"]) * 1e-6 * math.sqrt(bandwidth_hz)

    def computed(self, register: str, time_s: float) -> int | None:
        """Return the flags of new data, or the temperature, which is measured while a sensor runs."""
        if register in ("STATUS_REG", "STATUS_REG_27"):
            return self._new_data(time_s)
        if register != "OUT_TEMP":
            return None
        degc = self.setup.world.temperature_degc(time_s) - REFERENCE_DEGC
        return round(degc * self.table.data["counts_per_degc"]) if self.rate_hz(Sensed.ACCELEROMETER) else 0

    def interrupt_levels(self, time_s: float) -> tuple[bool, ...]:
        """Return INT1_A/G and INT2_A/G: new data of the selected sensors."""
        data, low = self._new_data(time_s), bool(self.field("active-low interrupts"))
        first, second = (self.field(f"data-ready interrupts on {pin}") for pin in ("INT1", "INT2"))
        return bool(data & first) != low, bool(data & second) != low

    def following(self, register: int) -> int:
        """Return the next register of a burst, which goes round the outputs of the active sensors."""
        if not self.field("moving pointer"):
            return register
        both = self.rate_hz(Sensed.GYROSCOPE) > 0.0
        if register == _OUT_X_XL + _LAST_BYTE:
            return _OUT_X_G if both else _OUT_X_XL
        return _OUT_X_XL if both and register == _OUT_X_G + _LAST_BYTE else register + 1 & 0xFF

    def _new_data(self, time_s: float) -> int:
        """Return new data: b0 of the accelerometer, b1 of the gyroscope."""
        return self.is_ready(Sensed.ACCELEROMETER, time_s) | self.is_ready(Sensed.GYROSCOPE, time_s) << 1
