"""MMA8653FC three-axis accelerometer.

The table has the sources. Not modelled: the embedded event functions, sleep, and the modes of resolution.
"""

from __future__ import annotations

import math

from hiltest.world import Vector
from hiltest.world.recorded_motion import Sensed
from hiltest.world.sensors.register_table import read_table
from hiltest.world.sensors.sampling import Counts
from hiltest.world.sensors.table_sensor import TableSensor

_STATUS, _OUT_X_MSB, _OUT_Z_MSB, _OUT_Z_LSB, _CTRL_REG1, _OFF_X = 0x00, 0x01, 0x05, 0x06, 0x2A, 0x2F
_SPARE_BITS = 6  # words of ten bits are left-justified
_LARGEST = 511
_READY = 0x01


class Mma8653(TableSensor):
    """The part, along its own axes."""

    table = read_table(__file__)

    @property
    def _is_active(self) -> int:
        return self.field("active mode")

    @property
    def _doublings(self) -> int:
        """Return the full scale in doublings of 2 g."""
        return min(self.field("full scale"), 2)

    def rate_hz(self, quantity: Sensed) -> float:
        """Return the data rate in active mode."""
        return float(self.table.data["rates_hz"][self.field("data rate")]) if self._is_active else 0.0

    def counts_per_unit(self, quantity: Sensed) -> float:
        """Return the sensitivity of the left-justified words."""
        counts: float = self.table.data["counts_per_g"] << _SPARE_BITS
        return counts / (1 << self._doublings)

    def noise(self, quantity: Sensed) -> float:
        """Return the noise of a bandwidth of half the data rate."""
        density: float = self.table.data["noise_density_g"]
        return density * math.sqrt(max(self.rate_hz(quantity), 1.0) / 2.0)

    def first_sample_s(self, quantity: Sensed) -> float:
        """Return the turn-on time: 2/ODR + 1 ms."""
        return 2.0 / self.rate_hz(quantity) + 0.001

    def added(self, quantity: Sensed) -> Vector:
        """Return the user offsets."""
        step_g = self.table.data["offset_step_g"]
        words = [self._stored[_OFF_X + axis] for axis in range(3)]
        x, y, z = (step_g * (word - 256 if word & 0x80 else word) for word in words)
        return x, y, z

    def words(self, quantity: Sensed, reading: Vector) -> Counts:
        """Return ten bits for each axis, left-justified."""
        counts_per_g = self.table.data["counts_per_g"] / (1 << self._doublings)
        x, y, z = (max(-_LARGEST - 1, min(_LARGEST, round(value * counts_per_g))) << _SPARE_BITS for value in reading)
        return x, y, z

    def computed(self, register: str, time_s: float) -> int | None:
        """Return SYSMOD and INT_SOURCE."""
        if register == "SYSMOD":
            return self._is_active
        return self._source(time_s) if register == "INT_SOURCE" else None

    def _source(self, time_s: float) -> int:
        return self.field("data-ready interrupt") & bool(self.outputs[0].status(time_s) & 0x08)

    def interrupt_levels(self, time_s: float) -> tuple[bool, ...]:
        """Return INT1 and INT2: CTRL_REG5 routes new data to one of them, CTRL_REG3 sets the active level."""
        source, to_int1 = self._source(time_s), self.field("interrupt pins") & _READY
        active_high = bool(self.field("polarity of the interrupt pins"))
        return (bool(source & to_int1) == active_high, bool(source & ~to_int1) == active_high)

    def following(self, register: int) -> int:
        """Return the next register; fast-read mode skips the low bytes, and 0x06 leads to 0x00."""
        if self.field("fast read") and register in (_OUT_X_MSB, _OUT_X_MSB + 2, _OUT_Z_MSB):
            return register + 2 if register != _OUT_Z_MSB else _STATUS
        return _STATUS if register == _OUT_Z_LSB else super().following(register)

    def write_register(self, register: int, value: int, time_s: float) -> bool:
        """Write a register; in active mode only a change to standby, or a reset, is possible."""
        resets = value & self.table.resetting.get(register, 0)
        if self._is_active and not resets and (register != _CTRL_REG1 or value & 1):
            return True
        return super().write_register(register, value, time_s)
