"""AK09916 magnetometer behind the auxiliary I2C master of the ICM-20948; the table has the sources.

A read of the data holds them until the end of the burst. The self-test mode has no model: it measures nothing.
"""

from __future__ import annotations

from hiltest.world.recorded_motion import Sensed
from hiltest.world.sensors.register_table import read_table
from hiltest.world.sensors.sensor_setup import SensorSetup
from hiltest.world.sensors.table_sensor import TableSensor

_POWER_DOWN, _SINGLE = 0, 1  # operating modes
_SINGLE_GRID_HZ = 10_000.0  # a single measurement begins when it is asked for
_READY, _OVERRUN = 0x01, 0x02  # ST1
_OVERFLOW = 0x08  # ST2
_IS_READ = 0x80  # address of a slave


class Ak09916(TableSensor):
    """The part over I2C, along its own axes.

    Attributes
    ----------
    is_reachable : bool
        True while the bus of the device that asks is connected to the part.
    """

    table = read_table(__file__)

    def __init__(self, setup: SensorSetup) -> None:
        self.is_reachable = True
        super().__init__(setup)

    def responds(self, time_s: float) -> bool:
        """Return whether the part is connected to the bus."""
        return self.is_reachable and super().responds(time_s)

    def transfer(self, address: int, register: int, value: int, length: int, time_s: float) -> bytes | None:
        """Carry out a transfer of the auxiliary I2C master.

        Parameters
        ----------
        address
            Address of the slave; b7 is set for a read.
        value
            Byte to write.
        length
            Number of bytes to read.

        Returns
        -------
        bytes or None
            The bytes; None without an acknowledgement.
        """
        before, self.is_reachable = self.is_reachable, address & ~_IS_READ == self.address
        data = None
        if self.start(False, time_s):
            self.write(register, time_s)
            if address & _IS_READ:
                self.start(True, time_s)
                data = bytes(self.read(time_s) for _ in range(length))
            else:
                data = b""
                self.write(value, time_s)
            self.stop(time_s)
        self.is_reachable = before
        return data

    def rate_hz(self, quantity: Sensed) -> float:
        """Return the data rate by the operating mode."""
        if self.is_single(quantity):
            return _SINGLE_GRID_HZ
        return float(self.table.data["rates_hz"].get(str(self.field("operating mode")), 0.0))

    def counts_per_unit(self, quantity: Sensed) -> float:
        """Return the sensitivity, the only one."""
        return float(self.table.data["counts_per_ut"])

    def noise(self, quantity: Sensed) -> float:
        """Return the noise."""
        return self.table.outputs[0].noise

    def is_single(self, quantity: Sensed) -> bool:
        """Return whether a single measurement is asked for."""
        return self.field("operating mode") == _SINGLE

    def finish_single(self, quantity: Sensed) -> None:
        """Enter power-down."""
        self.set_field("operating mode", _POWER_DOWN)

    def first_sample_s(self, quantity: Sensed) -> float:
        """Return the duration of a measurement, or the period of a continuous mode."""
        single_s: float = self.table.data["measurement_s"]
        return single_s if self.is_single(quantity) else super().first_sample_s(quantity)

    def computed(self, register: str, time_s: float) -> int | None:
        """Return the flags of new, lost and too large data."""
        output = self.outputs[0]
        if register == "ST1":
            lost = _OVERRUN if output.status(time_s) & 0x80 else 0
            return lost | (_READY if self.is_ready(output.quantity, time_s) else 0)
        if register != "ST2":
            return None
        sum_counts = sum(abs(output.word(axis, time_s)) for axis in range(3))
        limit_counts = self.table.data["overflow_ut"] * self.table.data["counts_per_ut"]
        return _OVERFLOW if sum_counts >= limit_counts else 0

    def following(self, register: int) -> int:
        """Return the next register of a burst: those of the data and of the settings are two rounds."""
        registers = sorted(self.table.names)
        first_setting = registers.index(0x30)
        for group in (registers[:first_setting], registers[first_setting:]):
            if register in group:
                return group[(group.index(register) + 1) % len(group)]
        return register + 1 & 0xFF
