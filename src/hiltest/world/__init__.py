"""The simulated truth around a virtual board: field, distortion, motion, temperature and noise.

`World` combines these, and returns the sensors' input at any time. The seed alone determines all noise.
"""

from hiltest.world.distortion import MagneticDistortion
from hiltest.world.earth_field import EarthField, Vector
from hiltest.world.noise import NoiseSource
from hiltest.world.temperature import Temperature
from hiltest.world.world import World, WorldState

__all__ = [
    "EarthField",
    "MagneticDistortion",
    "NoiseSource",
    "Temperature",
    "Vector",
    "World",
    "WorldState",
]
