"""LSM9DS1 magnetometer: the LIS3MDL's die with other sensitivities and user offsets; the table has the sources."""

from __future__ import annotations

from hiltest.world import Vector
from hiltest.world.recorded_motion import Sensed
from hiltest.world.sensors.lis3mdl import Lis3mdl
from hiltest.world.sensors.register_table import read_table
from hiltest.world.sensors.sampling import Counts, saturated_word

_MGAUSS_PER_UT = 10.0
_OFFSETS = 0x05  # OFFSET_X_REG_L_M, the first of six


class Lsm9ds1M(Lis3mdl):
    """The magnetometer over I2C or SPI, along the axes of the package."""

    table = read_table(__file__)

    def counts_per_unit(self, quantity: Sensed) -> float:
        """Return the sensitivity at the full scale."""
        return _MGAUSS_PER_UT / float(self.table.data["mgauss"][self.field("full scale")])

    def words(self, quantity: Sensed, reading: Vector) -> Counts:
        """Return the words, from which the part subtracts the user offsets."""
        data = bytes(self._stored[_OFFSETS + place] for place in range(6))
        offsets = (int.from_bytes(data[first : first + 2], "little", signed=True) for first in (0, 2, 4))
        words = zip(reading, offsets, strict=True)
        x, y, z = (saturated_word(value * self.counts_per_unit(quantity) - offset) for value, offset in words)
        return x, y, z
