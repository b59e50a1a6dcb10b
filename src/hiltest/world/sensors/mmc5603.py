"""MMC5603 three-axis magnetometer with 20-bit words; the table has the sources.

Set and reset leave the reading as it is, because the model has no remanence; the self-test passes at once; the
temperature takes no time. The data sheet gives one figure of noise; that of the other bandwidths follows from their
measurement times for white noise.
"""

from __future__ import annotations

import math

from hiltest.world.recorded_motion import Sensed
from hiltest.world.sensors.register_table import read_table
from hiltest.world.sensors.sensor_setup import SensorSetup
from hiltest.world.sensors.table_sensor import TableSensor

_UT_PER_GAUSS = 100.0
_FIRST_LOW_NIBBLE, _PAST_OUTPUT = 6, 9  # registers: six bytes of the upper 16 bits, then the lowest four of each axis
_MIDDLE = 1 << 19  # word of a field of zero
_MEASURE_TEMPERATURE, _COMPUTE_PERIOD = 0x02, 0x80  # CONTROL0
_MEMORY_READ, _FIELD_DONE, _TEMPERATURE_DONE = 0x10, 0x40, 0x80  # STATUS1
_FASTEST = 255, 3  # data rate and bandwidth of the fastest rate


class Mmc5603(TableSensor):
    """The part over I2C, along its own axes."""

    table = read_table(__file__)

    def __init__(self, setup: SensorSetup) -> None:
        self._period_rate = 0  # data rate of which the part has computed the period
        self._temperature, self._temperature_done = 0, False
        super().__init__(setup)

    def rate_hz(self, quantity: Sensed) -> float:
        """Return the data rate, which bandwidth and automatic set and reset limit."""
        data, bandwidth = self.table.data, self.field("bandwidth")
        if not self.field("continuous mode"):
            return 1.0 / float(data["measurement_s"][bandwidth]) if self.field("measurement of the field") else 0.0
        if self.field("high power") and (self._period_rate, bandwidth) == _FASTEST:
            return float(data["high_power_rate_hz"])
        limits_hz = data["fastest_rates_hz"][self.field("automatic set and reset")]
        return min(float(self._period_rate), float(limits_hz[bandwidth]))

    def counts_per_unit(self, quantity: Sensed) -> float:
        """Return the sensitivity."""
        return float(self.table.data["counts_per_gauss"]) / _UT_PER_GAUSS

    def noise(self, quantity: Sensed) -> float:
        """Return the noise by bandwidth."""
        longest_s, *_ = durations_s = self.table.data["measurement_s"]
        return self.table.outputs[0].noise * math.sqrt(longest_s / durations_s[self.field("bandwidth")])

    def is_single(self, quantity: Sensed) -> bool:
        """Return whether a measurement is asked for."""
        return not self.field("continuous mode")

    def finish_single(self, quantity: Sensed) -> None:
        """Clear the request."""
        self.set_field("measurement of the field", 0)

    def written(self, register: str, value: int, time_s: float) -> None:
        """Carry out the commands."""
        if register == "CONTROL0" and value & _COMPUTE_PERIOD:
            self._period_rate = self.field("data rate")
        if register == "CONTROL0" and value & _MEASURE_TEMPERATURE:
            lowest_degc, step_degc = self.table.data["temperature_degc"]
            counts = round((self.setup.world.temperature_degc(time_s) - lowest_degc) / step_degc)
            self._temperature, self._temperature_done = max(0, min(0xFF, counts)), True

    def computed(self, register: str, time_s: float) -> int | None:
        """Return the status and the measured temperature, whose flag it clears."""
        if register == "TOUT":
            self._temperature_done = False
            return self._temperature
        if register != "STATUS1":
            return None
        field_flag = _FIELD_DONE if self.is_ready(Sensed.MAGNETOMETER, time_s) else 0
        return _MEMORY_READ | field_flag | (_TEMPERATURE_DONE if self._temperature_done else 0)

    def read_register(self, register: int, time_s: float) -> int:
        """Return a register; the words are unsigned, and their lowest bits are behind the others."""
        if register >= _PAST_OUTPUT:
            return super().read_register(register, time_s)
        output, is_nibble = self.outputs[0], register >= _FIRST_LOW_NIBBLE
        axis, second = (register - _FIRST_LOW_NIBBLE, 0) if is_nibble else divmod(register, 2)
        word = output.word(axis, time_s) + _MIDDLE
        output.clear_flags(axis)
        if register == _FIRST_LOW_NIBBLE - 1:
            output.deliver_read(time_s)
        return word << 4 & 0xF0 if is_nibble else word >> (4 if second else 12) & 0xFF

    def reset(self, time_s: float) -> None:
        """Forget the measured temperature and the period."""
        self._period_rate, self._temperature, self._temperature_done = 0, 0, False
        super().reset(time_s)
