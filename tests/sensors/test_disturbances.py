"""What the registers of the magnetometers show of a disturbance."""

import numpy as np
import pytest

from hiltest.orientation.angles import Pose
from hiltest.world import EarthField, MagneticDistortion, World
from hiltest.world.disturbances import Cable, Current, Disturbances, Passing
from hiltest.world.sensors.fxos8700cq import Fxos8700cq
from hiltest.world.sensors.mag3110 import Mag3110

from .bus_master import read, write

FIELD = EarthField(48.5, 62.0)
POSE = Pose(70.0, 15.0, -25.0)
CAUSES = {
    "current": Current((1.5, -2.0, 2.5), ((3.0, 0.0), (3.0, 4.0))),
    "passing": Passing((400.0, 200.0, -300.0), (0.0, 2.0, 0.0), (5.0, 0.0, 0.0), at_s=4.0),
    "cable": Cable(20.0, (0.0, 1.0, 0.2), ((3.0, 0.3, 0.0, 0.0), (3.5, 0.1, 0.0, 0.2))),
}


def mag3110(world):
    part = Mag3110(world, MagneticDistortion(), seed=1)
    assert write(part, 0.06, 0x10, 0x01)
    return lambda time_s: body(read(part, time_s, 0x01, 6), +1)


def fxos8700cq(world):
    part = Fxos8700cq(world, MagneticDistortion(), seed=1)
    assert write(part, 0.06, 0x5B, 0x1F)
    assert write(part, 0.06, 0x2A, 0x0D)
    return lambda time_s: body(read(part, time_s, 0x33, 6), -1)


def body(words, down):
    x, y, z = np.frombuffer(words, ">i2") / 10.0
    return np.array([-y, -x, down * z])


@pytest.mark.parametrize("make", [mag3110, fxos8700cq])
@pytest.mark.parametrize("cause", sorted(CAUSES))
def test_a_part_reads_the_field_of_what_disturbs_it_at_the_instant_of_its_sample(make, cause):
    disturbances = Disturbances(**{cause: CAUSES[cause]})
    calm, disturbed = make(World(FIELD, pose=POSE)), make(World(FIELD, pose=POSE, disturbances=disturbances))
    observed = False
    for time_s in (1.0, 2.9, 3.1, 3.3, 3.7, 4.0, 4.4, 9.0):
        # Both have the same noise: what is left is the field, and a count of rounding. A sample is up to 12.5 ms old.
        change = disturbed(time_s) - calm(time_s)
        fields = [disturbances.fields_by_cause_ut(time_s - age_s, POSE)[cause] for age_s in np.linspace(0.0, 0.0125, 6)]
        assert (change >= np.min(fields, axis=0) - 0.101).all()
        assert (change <= np.max(fields, axis=0) + 0.101).all()
        observed |= bool(np.linalg.norm(change) > 2.0)
    assert observed


def test_a_field_out_of_range_stops_at_the_end_of_the_scale():
    strong = Disturbances(Current((1e4, -1e4, 1e4), ((3.0, 0.0), (3.0, 1.0))))
    # 20 000 counts of 0.1 uT, data sheet; the field is 10 000 uT.
    assert np.abs(mag3110(World(FIELD, disturbances=strong))(5.0)).tolist() == [2000.0] * 3
