"""What temperature does to the words that the parts give."""

import numpy as np
import pytest

from hiltest.orientation.angles import Pose
from hiltest.world.distortion import MagneticDistortion
from hiltest.world.earth_field import EarthField
from hiltest.world.sensors import AccelerometerErrors, Fxos8700cq
from hiltest.world.sensors.drift import Drift
from hiltest.world.sensors.fxas21002c import Fxas21002c
from hiltest.world.sensors.mag3110 import Mag3110
from hiltest.world.temperature import Temperature
from hiltest.world.world import World

from .bus_master import read, write

FIELD = EarthField(48.5, 62.0)
OFFSET, GAIN = (0.1, -0.2, 0.4), (0.001, -0.002, 0.003)
RAMP = Temperature(25.0, 45.0, ramp_s=20.0)  # one degree a second
POSE = Pose(30.0, 20.0, -40.0)


def active(part, *writes):
    for register, value in writes:
        assert write(part, 0.06, register, value)
    return part


def mag3110(world, **options):
    return active(Mag3110(world, MagneticDistortion(), seed=1, **options), (0x10, 0x01))


def fxos8700cq(world, **options):
    part = Fxos8700cq(world, MagneticDistortion(hard_iron_ut=(5.0, 6.0, 7.0)), seed=1, **options)
    return active(part, (0x5B, 0x1F), (0x2A, 0x0D))


def fxos8700cq_accelerometer(world, drift=Drift()):  # noqa: B008 - frozen, so it may be shared
    return fxos8700cq(world, errors=AccelerometerErrors(drift=drift))


def fxas21002c(world, **options):
    return active(Fxas21002c(world, seed=1, bias_dps=(10.0, 20.0, -30.0), **options), (0x13, 0x0A))


def body_gyroscope(part, time_s):
    x, y, z = np.frombuffer(read(part, time_s, 0x01, 6), ">i2") / 16.0
    return np.array([-y, -x, -z])


def body_accelerometer(part, time_s):
    x, y, z = np.frombuffer(read(part, time_s, 0x01, 6), ">i2") / 16384.0
    return np.array([y, x, z])


def body_magnetometer(part, time_s):
    x, y, z = np.frombuffer(read(part, time_s, 0x33, 6), ">i2") / 10.0
    return np.array([-y, -x, -z])


def body_mag3110(part, time_s):
    x, y, z = np.frombuffer(read(part, time_s, 0x01, 6), ">i2") / 10.0
    return np.array([-y, -x, z])


@pytest.mark.parametrize(
    ("make", "argument", "body", "half_a_count", "offset"),
    [
        (fxas21002c, "drift", body_gyroscope, 1 / 32, OFFSET),
        (mag3110, "drift", body_mag3110, 0.05, OFFSET),
        (fxos8700cq, "magnetometer_drift", body_magnetometer, 0.05, OFFSET),
        (fxos8700cq_accelerometer, "drift", body_accelerometer, 1 / 8192, tuple(item / 100.0 for item in OFFSET)),
    ],
)
def test_offset_and_sensitivity_follow_the_temperature_in_the_body_frame(make, argument, body, half_a_count, offset):
    world = World(FIELD, temperature=RAMP, pose=POSE)
    steady = make(World(FIELD, pose=POSE))
    drifting = make(world, **{argument: Drift(offset, GAIN)})
    for time_s in (2.0, 9.0, 15.0, 30.0):
        above = min(time_s, 20.0)
        # Both have the same noise, which a part adds behind what temperature changes: it drops out but for rounding.
        change = body(drifting, time_s) - body(steady, time_s)
        true = {
            body_gyroscope: np.array([10.0, 20.0, -30.0]),
            body_mag3110: np.array(world.state_at(0.0).field_body_ut),
            body_magnetometer: np.add(world.state_at(0.0).field_body_ut, [5.0, 6.0, 7.0]),
            body_accelerometer: np.array(world.state_at(0.0).gravity_body_g),
        }[body]
        # A sample is up to 12.5 ms old: 1/80 degC.
        slack = 2 * half_a_count + 0.0125 * np.abs(np.array(GAIN) * true + offset)
        assert (np.abs(change - above * (np.array(GAIN) * true + offset)) <= slack).all()


def test_without_coefficients_no_temperature_changes_a_bit():
    for make, registers in ((mag3110, 7), (fxos8700cq, 0x3F), (fxas21002c, 8)):
        hot, mild = (make(World(FIELD, temperature=item, pose=POSE)) for item in (RAMP, Temperature()))
        for number in range(100):
            time_s = 0.2 + number / 7.0
            assert read(hot, time_s, 0x00, registers) == read(mild, time_s, 0x00, registers)


def test_at_25_degrees_nothing_has_drifted():
    assert Drift(OFFSET, GAIN).apply((1.0, -2.0, 3.0), 25.0) == (1.0, -2.0, 3.0)


def test_the_temperature_registers_follow():
    world = World(FIELD, temperature=Temperature(-10.0, 60.0, ramp_s=70.0))
    parts = ((mag3110(world), 0x0F, 1.0), (fxos8700cq(world), 0x51, 0.96), (fxas21002c(world), 0x12, 1.0))
    for part, register, step_degc in parts:
        for time_s in (0.2, 11.0, 47.25, 80.0):
            (shown,) = np.frombuffer(read(part, time_s, register, 1), np.int8)
            # Half a step, and a MAG3110 sample is up to 12.5 ms old.
            assert abs(shown * step_degc - min(60.0, time_s - 10.0)) <= step_degc / 2 + 0.0126
