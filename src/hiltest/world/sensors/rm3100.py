"""RM3100 three-axis magnetometer, which counts cycles of an oscillator; the table has the sources.

All axes are measured, whichever are chosen; the flags of HSHAKE about refused writes stay as they are. Noise at other
numbers of cycles than the table's follows for white noise, which agrees with the manual's figures at 50 and 100 cycles.
"""

from __future__ import annotations

import math

from hiltest.world import Vector
from hiltest.world.recorded_motion import Sensed
from hiltest.world.sensors.register_table import read_table
from hiltest.world.sensors.sampling import Counts
from hiltest.world.sensors.table_sensor import TableSensor

_POLL, _RESULT, _PAST_RESULT = 0x00, 0x24, 0x2D  # registers; results have three bytes for each axis, the highest first
_DATA_READY = 0x80  # STATUS


class Rm3100(TableSensor):
    """The part over I2C or SPI, along its own axes."""

    table = read_table(__file__)

    def rate_hz(self, quantity: Sensed) -> float:
        """Return the data rate, at most one measurement after the other."""
        data = self.table.data
        start_s, cycle_s = data["axis_s"]
        fastest_hz = 1.0 / sum(start_s + cycle_s * cycles for cycles in self._cycles)
        if self.field("continuous measurement"):
            steps = self.field("data rate") - data["fastest_rate_code"]
            return float(min(data["fastest_rate_hz"] / 2 ** max(0, steps), fastest_hz))
        return fastest_hz if self.field("single measurement") else 0.0

    def counts_per_unit(self, quantity: Sensed) -> float:
        """Return the gain of x."""
        return self._gains[0]

    def noise(self, quantity: Sensed) -> Vector:
        """Return the noise by cycles."""
        x, y, z = (math.sqrt(self.table.data["default_cycles"] / max(1, cycles)) for cycles in self._cycles)
        noise_ut = self.table.outputs[0].noise
        return noise_ut * x, noise_ut * y, noise_ut * z

    def is_single(self, quantity: Sensed) -> bool:
        """Return whether a single measurement is asked for."""
        return not self.field("continuous measurement")

    def finish_single(self, quantity: Sensed) -> None:
        """Clear the request."""
        self.set_field("single measurement", 0)

    def words(self, quantity: Sensed, reading: Vector) -> Counts:
        """Return the words by each axis's gain."""
        full_scale = self.table.outputs[0].full_scale
        x, y, z = (
            max(-full_scale - 1, min(full_scale, round(gain * value_ut)))
            for gain, value_ut in zip(self._gains, reading, strict=True)
        )
        return x, y, z

    def computed(self, register: str, time_s: float) -> int | None:
        """Return the status, or CMM, whose reading ends the continuous mode."""
        if register == "CMM":
            value = self._stored[self._pointer]
            self._stop(time_s)
            return value
        if register != "STATUS":
            return None
        return _DATA_READY if self.is_ready(Sensed.MAGNETOMETER, time_s) else 0

    def written(self, register: str, value: int, time_s: float) -> None:
        """End the continuous mode with a new data rate."""
        if register == "TMRC":
            self._stop(time_s)

    def write_register(self, register: int, value: int, time_s: float) -> bool:
        """Write a register, which clears data ready; the continuous mode refuses a single measurement."""
        output = self.outputs[0]
        for axis in range(3):
            output.word(axis, time_s)
            output.clear_flags(axis)
        output.release()
        if register == _POLL and self.field("continuous measurement"):
            return False
        return super().write_register(register, value, time_s)

    def read_register(self, register: int, time_s: float) -> int:
        """Return a register; the results have three bytes."""
        if not _RESULT <= register < _PAST_RESULT:
            return super().read_register(register, time_s)
        output, (axis, place) = self.outputs[0], divmod(register - _RESULT, 3)
        word = output.word(axis, time_s)
        output.clear_flags(axis)
        if register == _PAST_RESULT - 1:
            output.deliver_read(time_s)
        return word >> 8 * (2 - place) & 0xFF

    def interrupt_levels(self, time_s: float) -> tuple[bool, ...]:
        """Return DRDY, high from a new measurement until it is read."""
        return (self.is_ready(Sensed.MAGNETOMETER, time_s),)

    def _stop(self, time_s: float) -> None:
        self.set_field("continuous measurement", 0)
        self._follow_settings(time_s)

    @property
    def _cycles(self) -> list[int]:
        """Number of cycles by axis."""
        return [
            self.field(f"high byte of the cycles of {axis}") << 8 | self.field(f"low byte of the cycles of {axis}")
            for axis in "xyz"
        ]

    @property
    def _gains(self) -> list[float]:
        """Gain by axis [counts/uT]."""
        offset, per_cycle = self.table.data["counts_per_ut"]
        return [offset + per_cycle * cycles for cycles in self._cycles]
