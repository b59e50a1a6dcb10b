"""The sensors of a virtual board as registers on an I2C bus in a simulated world, one module per part."""

from hiltest.world.sensors.drift import Drift
from hiltest.world.sensors.fxas21002c import Fxas21002c
from hiltest.world.sensors.fxos8700cq import AccelerometerErrors, Fxos8700cq, Fxos8700cqNoise
from hiltest.world.sensors.mag3110 import Mag3110
from hiltest.world.sensors.mma8653 import Mma8653
from hiltest.world.sensors.register_device import RegisterDevice

__all__ = [
    "AccelerometerErrors",
    "Drift",
    "Fxas21002c",
    "Fxos8700cq",
    "Fxos8700cqNoise",
    "Mag3110",
    "Mma8653",
    "RegisterDevice",
]
