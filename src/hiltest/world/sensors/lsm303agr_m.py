"""LSM303AGR magnetometer; the table has the sources.

The low-pass filter halves the bandwidth, so that white noise without it is larger by the root of 2. The low-power mode
has the same noise here.
"""

from __future__ import annotations

import math

from hiltest.world import Vector
from hiltest.world.recorded_motion import Sensed
from hiltest.world.sensors.register_table import read_table
from hiltest.world.sensors.sampling import Counts, saturated_word
from hiltest.world.sensors.sensor_setup import SensorSetup
from hiltest.world.sensors.table_sensor import TableSensor

_CONTINUOUS, _SINGLE, _IDLE = 0, 1, 3  # operating modes
_INTERRUPT = 0x01  # INT_SOURCE_REG_M
_OFFSETS = 0x45  # OFFSET_X_REG_L_M, the first of six


class Lsm303agrM(TableSensor):
    """The magnetometer over I2C or SPI, along the axes of the package."""

    table = read_table(__file__)

    def __init__(self, setup: SensorSetup) -> None:
        self._latched, self._checked_s = False, 0.0  # the interrupt, and the time of its latest comparison
        super().__init__(setup)

    def rate_hz(self, quantity: Sensed) -> float:
        """Return the data rate."""
        measures = self.field("operating mode") in (_CONTINUOUS, _SINGLE)
        return float(self.table.data["rates_hz"][self.field("data rate")]) if measures else 0.0

    def counts_per_unit(self, quantity: Sensed) -> float:
        """Return the sensitivity, the only one."""
        return float(self.table.data["counts_per_ut"])

    def noise(self, quantity: Sensed) -> float:
        """Return the noise with or without the low-pass filter."""
        return self.table.outputs[0].noise * (1.0 if self.field("low-pass filter") else math.sqrt(2.0))

    def is_single(self, quantity: Sensed) -> bool:
        """Return whether a single measurement is asked for."""
        return self.field("operating mode") == _SINGLE

    def finish_single(self, quantity: Sensed) -> None:
        """Enter the idle mode."""
        self.set_field("operating mode", _IDLE)

    def words(self, quantity: Sensed, reading: Vector) -> Counts:
        """Return the words, from which the part subtracts the user offsets."""
        words = zip(reading, self._offsets(), strict=True)
        x, y, z = (saturated_word(value * self.counts_per_unit(quantity) - offset) for value, offset in words)
        return x, y, z

    def computed(self, register: str, time_s: float) -> int | None:
        """Return the source of the threshold interrupt; a read ends a latched one."""
        if register != "INT_SOURCE_REG_M":
            return None
        pending, self._latched = self._is_pending(time_s), False
        return self._axes_beyond(time_s) | (_INTERRUPT if pending else 0)

    def written(self, register: str, value: int, time_s: float) -> None:
        """Compare only samples after the interrupt's latest setting with the threshold."""
        if register == "INT_CTRL_REG_M":
            self._latched, self._checked_s = False, time_s

    def interrupt_levels(self, time_s: float) -> tuple[bool, ...]:
        """Return INT_MAG: new data, or the threshold interrupt with its polarity."""
        if self.field("data-ready interrupt on the pin"):
            return (bool(self.outputs[0].status(time_s) & 0x08),)
        if not self.field("threshold interrupt on the pin"):
            return (False,)
        return (self._is_pending(time_s) == bool(self.field("active-high interrupt")),)

    def reset(self, time_s: float) -> None:
        """Return to the state after a reset by software."""
        self._latched, self._checked_s = False, time_s
        super().reset(time_s)

    def _is_pending(self, time_s: float) -> bool:
        """Return whether a sample is beyond the threshold: the latest, or with the latch one since the last check."""
        rate_hz = self.outputs[0].rate_hz
        if self.field("latched interrupt") and self.field("threshold interrupt"):
            first, latest = math.floor(self._checked_s * rate_hz + 1e-9) + 1, self.outputs[0].latest(time_s)
            self._latched = self._latched or any(self._axes_beyond(n / rate_hz) for n in range(first, latest + 1))
            self._checked_s = time_s
        return self._latched or bool(self._axes_beyond(time_s))

    def _axes_beyond(self, time_s: float) -> int:
        """Return the bits of the axes that are beyond the threshold: b7-b5 above it, b4-b2 below its negative."""
        if not self.field("threshold interrupt"):
            return 0
        limit = self.field("high byte of the threshold") << 8 | self.field("low byte of the threshold")
        added = (0, 0, 0) if self.field("interrupt after the user offset") else self._offsets()
        bits = 0
        for axis, offset in enumerate(added):
            if self.field("axes of the threshold interrupt") >> 2 - axis & 1:
                word = self.outputs[0].word_at(time_s, axis) + offset
                bits |= (0x80 >> axis) * (word > limit) | (0x10 >> axis) * (word < -limit)
        return bits

    def _offsets(self) -> Counts:
        """Return the user offsets [counts]."""
        data = bytes(self._stored[_OFFSETS + place] for place in range(6))
        x, y, z = (int.from_bytes(data[first : first + 2], "little", signed=True) for first in (0, 2, 4))
        return x, y, z
