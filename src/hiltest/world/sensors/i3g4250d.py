"""I3G4250D three-axis gyroscope; the table has the sources.

Noise follows from density and bandwidth. The part has no block data update; reads are in blocks here.
"""

from __future__ import annotations

import math

from hiltest.world.recorded_motion import Sensed
from hiltest.world.sensors.register_table import read_table
from hiltest.world.sensors.table_sensor import TableSensor


class I3g4250d(TableSensor):
    """The part over I2C or SPI, along the axes of the package."""

    table = read_table(__file__)

    def rate_hz(self, quantity: Sensed) -> float:
        """Return the data rate; the part is in power-down at first, and asleep without axes."""
        measures = self.field("active") and self.field("enabled axes")
        return float(self.table.data["rates_hz"][self.field("data rate")]) if measures else 0.0

    def counts_per_unit(self, quantity: Sensed) -> float:
        """Return the sensitivity at the full scale."""
        return 1000.0 / float(self.table.data["mdps"][self.field("full scale")])

    def noise(self, quantity: Sensed) -> float:
        """Return the noise by the bandwidth of the last filter in use."""
        data, code = self.table.data, self.field("data rate")
        bandwidth_hz = data["first_bandwidths_hz"][code]
        if self.field("second filter"):
            bandwidth_hz = min(bandwidth_hz, data["bandwidths_hz"][code][self.field("bandwidth of the second filter")])
        return float(data["density_mdps"]) * 1e-3 * math.sqrt(bandwidth_hz)

    def computed(self, register: str, time_s: float) -> int | None:
        """Return the temperature, which falls by a count per degree, while the part measures."""
        if register != "OUT_TEMP":
            return None
        counts = round(self.table.data["degc_at_zero"] - self.setup.world.temperature_degc(time_s))
        return counts & 0xFF if self.rate_hz(Sensed.GYROSCOPE) else 0

    def interrupt_levels(self, time_s: float) -> tuple[bool, ...]:
        """Return INT1, whose sources have no model, and DRDY/INT2, which may follow new data."""
        ready = self.field("data-ready interrupt on DRDY/INT2") and self.outputs[0].status(time_s) & 0x08
        return bool(self.field("active-low INT1")), bool(ready)
