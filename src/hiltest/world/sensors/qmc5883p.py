"""QMC5883P three-axis magnetometer; the table has the sources. Its self-test ends at once, without a field."""

from __future__ import annotations

import math

from hiltest.world.recorded_motion import Sensed
from hiltest.world.sensors.register_table import read_table
from hiltest.world.sensors.sensor_setup import SensorSetup
from hiltest.world.sensors.table_sensor import TableSensor

_UT_PER_GAUSS = 100.0
_SUSPEND, _SINGLE, _CONTINUOUS = 0, 2, 3  # operating modes
_READY, _OVERFLOW = 0x01, 0x02  # STATUS


class Qmc5883p(TableSensor):
    """The part over I2C, along its own axes."""

    table = read_table(__file__)

    def __init__(self, setup: SensorSetup) -> None:
        self._announced = 0.0, -1  # rate and number of the latest sample that STATUS has shown as new
        super().__init__(setup)

    def rate_hz(self, quantity: Sensed) -> float:
        """Return the data rate, which the oversampling determines in continuous mode."""
        mode = self.field("operating mode")
        if mode == _CONTINUOUS:
            return float(self.table.data["fastest_rate_hz"]) / self._oversampling
        return 0.0 if mode == _SUSPEND else float(self.table.data["rates_hz"][self.field("data rate")])

    def counts_per_unit(self, quantity: Sensed) -> float:
        """Return the sensitivity at the full scale."""
        return float(self.table.data["counts_per_gauss"][self.field("full scale")]) / _UT_PER_GAUSS

    def noise(self, quantity: Sensed) -> float:
        """Return the noise by oversampling and second filter, whose ratios are 1, 2, 4, 8."""
        return float(self.table.data["noise_ut"]) * math.sqrt(8 / (self._oversampling << self.field("second filter")))

    def is_single(self, quantity: Sensed) -> bool:
        """Return whether a single measurement is asked for."""
        return self.field("operating mode") == _SINGLE

    def finish_single(self, quantity: Sensed) -> None:
        """Suspend the part."""
        self.set_field("operating mode", _SUSPEND)

    def computed(self, register: str, time_s: float) -> int | None:
        """Return the status: a new sample, until STATUS or the data are read, and an axis beyond the range."""
        if register != "STATUS":
            return None
        output, limit = self.outputs[0], self.table.data["overflow_counts"]
        latest = output.latest(time_s)
        before, self._announced = self._announced, (output.rate_hz, latest)
        ready = self.is_ready(output.quantity, time_s) and before != self._announced
        is_beyond = max(map(abs, (output.word_at(time_s, axis) for axis in range(3)))) > limit
        return (_READY if ready else 0) | (_OVERFLOW if is_beyond else 0)

    @property
    def _oversampling(self) -> int:
        """Oversampling ratio: 8, 4, 2, 1."""
        return 8 >> self.field("oversampling")
