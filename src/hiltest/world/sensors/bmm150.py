"""BMM150 three-axis magnetometer, whose words firmware compensates by trim registers; the table has the sources.

The words of `SampledOutput` are compensated ones; the registers have the raw words, by the inverse of the compensation
at the present resistance of the Hall plate. The table's noise of the low-power preset gives that of the others by their
repetitions, for white noise: the data sheet's figures within their rounding. The self-test passes at once.
"""

from __future__ import annotations

import math

from hiltest.world import Vector
from hiltest.world.recorded_motion import Sensed
from hiltest.world.sensors.drift import REFERENCE_DEGC
from hiltest.world.sensors.register_table import read_table
from hiltest.world.sensors.sensor_setup import SensorSetup
from hiltest.world.sensors.table_sensor import TableSensor

_DATA, _PAST_DATA, _POWER = 0x42, 0x48, 0x4B  # registers
_NORMAL, _FORCED, _SLEEP = 0, 1, 3  # operating modes; 2 is sleep as well
_SHIFTS = 3, 3, 1  # of the raw words of x, y and z in their registers; the lowest bit is the result of the self-test
_LOW_POWER_REPETITIONS = 3


class Bmm150(TableSensor):
    """The part over I2C or SPI, along its own axes."""

    table = read_table(__file__)

    def __init__(self, setup: SensorSetup) -> None:
        super().__init__(setup)
        self._trim: dict[str, int] = {}
        for address, (name, place) in self.table.words.items():
            self._trim[name] = self._trim.get(name, 0) + (self.table.values[address] << 8 * place)
        self.set_field("power", 0)  # suspend mode after power-on; a reset enters sleep mode

    def rate_hz(self, quantity: Sensed) -> float:
        """Return the data rate, at most one measurement after the other."""
        start_s, xy_s, z_s = self.table.data["durations_s"]
        xy, _, z = self._repetitions
        fastest_hz = 1.0 / (start_s + xy_s * xy + z_s * z)
        mode, rates_hz = self.field("operating mode"), self.table.data["rates_hz"]
        if mode not in (_NORMAL, _FORCED):
            return 0.0
        return float(fastest_hz if mode == _FORCED else min(rates_hz[self.field("data rate")], fastest_hz))

    def counts_per_unit(self, quantity: Sensed) -> float:
        """Return the sensitivity of a compensated word."""
        return float(self.table.data["counts_per_ut"])

    def noise(self, quantity: Sensed) -> Vector:
        """Return the noise by repetitions."""
        x, y, z = (
            noise_ut * math.sqrt(_LOW_POWER_REPETITIONS / repetitions)
            for noise_ut, repetitions in zip(self.table.data["noise_ut"], self._repetitions, strict=True)
        )
        return x, y, z

    def is_single(self, quantity: Sensed) -> bool:
        """Return whether the mode is the forced one."""
        return self.field("operating mode") == _FORCED

    def finish_single(self, quantity: Sensed) -> None:
        """Enter sleep mode."""
        self.set_field("operating mode", _SLEEP)

    def written(self, register: str, value: int, time_s: float) -> None:
        """Leave normal mode in suspend mode."""
        if not self.field("power"):
            self.set_field("operating mode", _SLEEP)

    def computed(self, register: str, time_s: float) -> int | None:
        """Return the resistance of the Hall plate and the data-ready bit."""
        if register != "RHALL":
            return None
        return self._hall(time_s) << 2 | self.is_ready(Sensed.MAGNETOMETER, time_s)

    def read_register(self, register: int, time_s: float) -> int:
        """Return a register: those of the field have raw words."""
        if not self.field("power") and register != _POWER:
            return 0
        if not _DATA <= register < _PAST_DATA:
            return super().read_register(register, time_s)
        output, (axis, is_high) = self.outputs[0], divmod(register - _DATA, 2)
        largest: int = self.table.data["largest_words"][axis]
        gain, offset = self._line(axis, self._hall(time_s))
        raw = round((output.word(axis, time_s) - offset) / gain)
        value = (raw if abs(raw) <= largest else -largest - 1) << _SHIFTS[axis] | 1
        if is_high:
            output.clear_flags(axis)
        if register == _PAST_DATA - 1:
            output.deliver_read(time_s)
        return value >> 8 * is_high & 0xFF

    def write_register(self, register: int, value: int, time_s: float) -> bool:
        """Write a register, which suspend mode refuses."""
        return super().write_register(register, value, time_s) if self.field("power") or register == _POWER else True

    def interrupt_levels(self, time_s: float) -> tuple[bool, ...]:
        """Return INT, which the model leaves inactive, and DRDY, active from a new sample until it is read."""
        ready = bool(self.field("data-ready pin") and self.is_ready(Sensed.MAGNETOMETER, time_s))
        return not self.field("polarity of the interrupt"), ready == bool(self.field("polarity of the data-ready pin"))

    @property
    def _repetitions(self) -> tuple[int, int, int]:
        """Number of measurements that are averaged, by axis."""
        xy = 1 + 2 * self.field("repetitions of x and y")
        return xy, xy, 1 + self.field("repetitions of z")

    def _hall(self, time_s: float) -> int:
        """Return the resistance of the Hall plate [counts]."""
        above_degc = self.setup.world.temperature_degc(time_s) - REFERENCE_DEGC
        change: float = self.table.data["hall_counts_per_degc"] * above_degc
        return self._trim["XYZ1"] + round(change)

    def _line(self, axis: int, hall: int) -> tuple[float, float]:
        """Return gain and offset of the compensation, which is linear [sixteenths of uT per raw count, and of uT]."""
        trim = self._trim
        if axis == 2:
            divisor = 4.0 * (trim["Z2"] + trim["Z1"] * hall / 2**15)
            return 2**17 / divisor, -(trim["Z4"] * 2**17 + trim["Z3"] * (hall - trim["XYZ1"])) / divisor
        ratio = 2**14 * (trim["XYZ1"] / hall - 1.0)
        scale = trim["XY2"] * ratio**2 / 2**28 + trim["XY1"] * ratio / 2**14 + 256.0
        return scale * (trim[("X2", "Y2")[axis]] + 160.0) / 2**13, 8.0 * trim[("X1", "Y1")[axis]]
