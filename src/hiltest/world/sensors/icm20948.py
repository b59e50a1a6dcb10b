"""ICM-20948 accelerometer and gyroscope, with an I2C master for the AK09916 in its package; the table has the sources.

The I2C master serves its slaves 0 to 3 once in a period of the gyroscope, and slave 4 at once. Only the latest of these
transfers before an access is carried out, because each replaces the one before. Noise follows from density and
bandwidth.
"""

from __future__ import annotations

import math
from typing import cast

from hiltest.world.recorded_motion import Sensed
from hiltest.world.sensors.ak09916 import Ak09916
from hiltest.world.sensors.register_table import read_table
from hiltest.world.sensors.sensor_setup import SensorSetup
from hiltest.world.sensors.table_sensor import TableSensor

_ZERO_DEGC = 21.0
_BANK_SELECT, _MASTER_STATUS, _EXTERNAL_DATA, _SLAVE_0, _SLAVE_4_DATA = 0x7F, 0x17, 0x3B, 0x303, 0x317
_REGISTERS_OF_SLAVE, _DATA_BYTES = 4, 24
_ENABLE = 0x80  # I2C_SLV4_CTRL
_DONE, _SLAVE_4_NACK = 0x40, 0x10  # I2C_MST_STATUS; b3-b0 are the refusals of the slaves 3 to 0
_ALL_AXES = 7


class Icm20948(TableSensor):
    """The part over I2C or SPI, along the axes of the package."""

    table = read_table(__file__)
    companion_models = (Ak09916,)

    def __init__(self, setup: SensorSetup) -> None:
        self._served_s = self._status_read_s = 0.0  # the latest service of the slaves, and read of INT_STATUS_1
        super().__init__(setup)

    def rate_hz(self, quantity: Sensed) -> float:
        """Return the data rate; it is the sensor's own without the filter."""
        if self.field("sleep") or self.field(f"axes of the {quantity.key} off") == _ALL_AXES:
            return 0.0
        if not self.field(f"filtered {quantity.key}"):
            return float(self.table.data[f"{quantity.key}_full_rate_hz"])
        divisor = self.field("divisor of the gyroscope's rate")
        if quantity is Sensed.ACCELEROMETER:
            high, low = "high bits of the accelerometer's divisor", "low byte of the accelerometer's divisor"
            divisor = self.field(high) << 8 | self.field(low)
        return float(self.table.data[f"{quantity.key}_rate_hz"]) / (1 + divisor)

    def counts_per_unit(self, quantity: Sensed) -> float:
        """Return the sensitivity at the full scale."""
        steps = self.table.data["counts_per_dps" if quantity is Sensed.GYROSCOPE else "counts_per_g"]
        return float(steps[self.field(f"full scale of the {quantity.key}")])

    def noise(self, quantity: Sensed) -> float:
        """Return the noise by the filter."""
        bandwidths_hz = self.table.data[f"{quantity.key}_bandwidths_hz"]
        filtered = self.field(f"filtered {quantity.key}")
        bandwidth_hz = bandwidths_hz[self.field(f"filter of the {quantity.key}") if filtered else -1]
        density = self.table.data["density_dps" if quantity is Sensed.GYROSCOPE else "density_g"]
        return float(density) * math.sqrt(bandwidth_hz)

    def computed(self, register: str, time_s: float) -> int | None:
        """Return temperature, new data or the I2C master's status; a read clears these two."""
        if register == "TEMP_OUT_H":
            degc = self.setup.world.temperature_degc(time_s) - _ZERO_DEGC
            off = self.field("sleep") or self.field("temperature sensor off")
            return 0 if off else round(degc * self.table.data["counts_per_degc"])
        if register == "INT_STATUS_1":
            ready, self._status_read_s = self._new_data_s(time_s) is not None, time_s
            return int(ready)
        if register == "I2C_MST_STATUS":
            status, self._stored[_MASTER_STATUS] = self._stored[_MASTER_STATUS], 0
            return status
        return None

    def written(self, register: str, value: int, time_s: float) -> None:
        """Begin to serve the slaves, or serve slave 4."""
        if register.endswith("_CTRL"):
            self._served_s = time_s
        if register == "I2C_SLV4_CTRL" and value & _ENABLE and self._has_master:
            data = self._transfer(4, 1, time_s)
            self._stored[_MASTER_STATUS] |= _DONE if data is not None else _DONE | _SLAVE_4_NACK
            self._stored[_SLAVE_4_DATA] = data[0] if data else self._stored[_SLAVE_4_DATA]

    def locate(self, register: int) -> int:
        """Return the address in the table: all banks have the bank selection."""
        return register if register == _BANK_SELECT else self.field("register bank") << 8 | register

    def settings(self) -> dict[int, int]:
        """Return the settings, of which the selected bank is none."""
        return {address: value for address, value in super().settings().items() if address != _BANK_SELECT}

    def start(self, reading: bool, time_s: float) -> bool:
        """Answer the device address; a burst reads the data of one service of the slaves."""
        self._serve_slaves(time_s)
        return super().start(reading, time_s)

    def select(self, time_s: float) -> None:
        """Begin a transfer over SPI."""
        self._serve_slaves(time_s)
        super().select(time_s)

    def interrupt_levels(self, time_s: float) -> tuple[bool, ...]:
        """Return INT1: new data until their status is read, or a pulse."""
        new_s = self._new_data_s(time_s) if self.field("data-ready interrupt") else None
        pulse_s = math.inf if self.field("latched interrupt") else self.table.data["pulse_s"]
        return ((new_s is not None and time_s < new_s + pulse_s) != bool(self.field("active-low interrupt")),)

    def next_interrupt_s(self, time_s: float) -> float:
        """Return the time of the next sample, or of the end of a pulse [s]."""
        end_s = (self._new_data_s(time_s) or -math.inf) + self.table.data["pulse_s"]
        return min(end_s if end_s > time_s else math.inf, super().next_interrupt_s(time_s))

    @property
    def _has_master(self) -> bool:
        return bool(self.field("I2C master")) and not self.field("sleep")

    def _follow_settings(self, time_s: float) -> None:
        super()._follow_settings(time_s)
        bypass = self.field("bypass of the I2C master") and not self.field("I2C master")
        cast("Ak09916", self.companions[0]).is_reachable = bool(bypass)

    def _new_data_s(self, time_s: float) -> float | None:
        """Return the instant of the latest sample after the latest read of its status; None if there is none."""
        instants = [output.held_instant(time_s) for output in self.outputs]
        return max(
            (instant for instant in instants if instant is not None and instant > self._status_read_s), default=None
        )

    def _serve_slaves(self, time_s: float) -> None:
        """Carry out the latest service of the slaves 0 to 3, whose data follow each other."""
        alone_hz = self.table.data["gyroscope_rate_hz"] / (1 << self.field("rate of the I2C master alone"))
        rate_hz = self.rate_hz(Sensed.GYROSCOPE) or self.rate_hz(Sensed.ACCELEROMETER) or alone_hz
        service_s = math.floor(time_s * rate_hz + 1e-9) / rate_hz
        if not self._has_master or service_s <= self._served_s:
            return
        self._served_s, place = service_s, 0
        for slave in range(4):
            length = self.field(f"length of slave {slave}")
            if self.field(f"slave {slave}"):
                data = self._transfer(slave, length, service_s)
                self._stored[_MASTER_STATUS] |= 1 << slave if data is None else 0
                for offset, byte in enumerate((data or b"")[: _DATA_BYTES - place]):
                    self._stored[_EXTERNAL_DATA + place + offset] = byte
                place = min(_DATA_BYTES, place + length)

    def _transfer(self, slave: int, length: int, time_s: float) -> bytes | None:
        first = _SLAVE_0 + slave * _REGISTERS_OF_SLAVE
        address, register, value = (self._stored[first + offset] for offset in (0, 1, 3))
        return cast("Ak09916", self.companions[0]).transfer(address, register, value, length, time_s)
