"""The sensors of a virtual board as registers on an I2C or SPI bus in a simulated world, one module per part."""

from hiltest.world.sensors.accelerometer_errors import AccelerometerErrors
from hiltest.world.sensors.drift import Drift
from hiltest.world.sensors.fxas21002c import Fxas21002c
from hiltest.world.sensors.fxos8700cq import Fxos8700cq, Fxos8700cqNoise
from hiltest.world.sensors.mag3110 import Mag3110
from hiltest.world.sensors.register_device import RegisterDevice
from hiltest.world.sensors.register_table import read_table
from hiltest.world.sensors.sensor_setup import SensorSetup
from hiltest.world.sensors.table_sensor import TableSensor

__all__ = [
    "AccelerometerErrors",
    "Drift",
    "Fxas21002c",
    "Fxos8700cq",
    "Fxos8700cqNoise",
    "Mag3110",
    "RegisterDevice",
    "SensorSetup",
    "TableSensor",
    "read_table",
]
