"""The models' output registers in the hand-computed poses that the firmware's axis maps are tested with."""

import json
import math
from pathlib import Path

import pytest

from hiltest.orientation.angles import Pose
from hiltest.world.distortion import MagneticDistortion
from hiltest.world.earth_field import EarthField
from hiltest.world.sensors.fxas21002c import Fxas21002c
from hiltest.world.sensors.fxos8700cq import Fxos8700cq, Fxos8700cqNoise
from hiltest.world.sensors.mag3110 import Mag3110
from hiltest.world.world import World

from .bus_master import read, write

POSES = json.loads((Path(__file__).parents[2] / "fixtures" / "axes" / "shield.json").read_text())["poses"]
# The fixture's field: 20 uT north, 3 east, 40 down. The world's north is magnetic: the same field lies
# in it along north, and the fixture's headings count from atan2(3, 20) west of that.
HORIZONTAL_UT = math.hypot(20.0, 3.0)
FIELD = EarthField(math.hypot(HORIZONTAL_UT, 40.0), math.degrees(math.atan2(40.0, HORIZONTAL_UT)))
NORTH_DEG = math.degrees(math.atan2(3.0, 20.0))


def words(part, setup, register):
    for at, value in setup:
        assert write(part, 0.1, at, value)
    return read(part, 1.0, register, 6).hex(" ")


@pytest.mark.parametrize("case", POSES, ids=lambda case: case["name"])
def test_registers_are_those_of_the_hand_computed_pose(case):
    heading, pitch, roll = case["pose"]
    world = World(FIELD, pose=Pose(heading - NORTH_DEG, pitch, roll))
    fxos8700cq = Fxos8700cq(world, MagneticDistortion(), seed=1, noise=Fxos8700cqNoise(0.0, (0.0, 0.0)))
    # The fixture's board turns; a bias of the same size says the same to a board that stands.
    gyroscope = Fxas21002c(world, seed=1, bias_dps=(1.0, -2.0, 3.0), noise_density=0.0)
    hybrid_4g = ((0x5B, 0x03), (0x0E, 0x01), (0x2A, 0x0D))
    assert case["registers"] == {
        "mag3110": words(Mag3110(world, MagneticDistortion(), seed=1, noise_ut=(0.0,) * 4), ((0x10, 0x01),), 0x01),
        "accelerometer": words(fxos8700cq, hybrid_4g, 0x01),
        "fxos8700_magnetometer": words(fxos8700cq, (), 0x33),
        "gyroscope": words(gyroscope, ((0x13, 0x0A),), 0x01),
    }
