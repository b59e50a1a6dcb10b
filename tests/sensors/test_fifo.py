"""FIFOs keep the very samples that polling would have seen, and lose the ones their mode says."""

import math
from collections import deque

import pytest
from hypothesis import given
from hypothesis import strategies as st

from hiltest.orientation.angles import Pose
from hiltest.world.distortion import MagneticDistortion
from hiltest.world.earth_field import EarthField
from hiltest.world.sensors.fxas21002c import Fxas21002c
from hiltest.world.sensors.fxos8700cq import Fxos8700cq
from hiltest.world.world import World

from .bus_master import read, write

FIELD = EarthField(48.5, 62.0)
CIRCULAR, STOP, TRIGGER = 0x40, 0x80, 0xC0
RATE_HZ = 200.0


class Gyroscope:
    """FXAS21002C at 200 Hz from 0.2 s on; sample k is that of 0.2 s + k periods."""

    F_STATUS = 0x08
    FIRST_S = 0.2

    def __init__(self, world, setup=0):
        self.part = Fxas21002c(world, seed=3)
        for register, value in ((0x09, setup), (0x15, 0x08), (0x13, 0x0A)):
            assert write(self.part, 0.135, register, value)


class Accelerometer:
    """FXOS8700CQ in hybrid mode at 200 Hz, from 0.2 s on."""

    F_STATUS = 0x00
    FIRST_S = 0.2

    def __init__(self, world, setup=0):
        self.part = Fxos8700cq(world, MagneticDistortion(), seed=3)
        for register, value in ((0x09, setup), (0x5B, 0x1F), (0x2A, 0x0D)):
            assert write(self.part, 0.186, register, value)


both = pytest.mark.parametrize("sensor", [Gyroscope, Accelerometer])


def moving_world():
    world = World(FIELD)
    world.turn_to(Pose(90.0, 20.0), time_s=0.25)
    world.turn_to(Pose(200.0, -20.0), time_s=1.0, known_angle=3)  # noise of another epoch from there on
    return world


def instant(sensor, number):
    # A cycle of the core after the sample.
    return sensor.FIRST_S + number / RATE_HZ + 1.0 / 120e6


def polled(sensor, count):
    """Read each sample as it becomes ready, without FIFO."""
    part = sensor(moving_world()).part
    samples = []
    for number in range(count):
        burst = read(part, instant(sensor, number), 0x00, 7)
        assert burst[0] == 0x0F, "one new sample, nothing overwritten"
        samples.append(burst[1:])
    return samples


@both
@given(drains=st.lists(st.tuples(st.integers(0, 32), st.floats(0.0, 1.0)), max_size=40), burst=st.booleans())
def test_a_fifo_drained_in_any_rhythm_gives_the_samples_that_polling_gives(sensor, drains, burst):
    part = sensor(moving_world(), CIRCULAR).part
    arrived, got = 0, []
    for samples, share in drains:
        # Up to 32 more, and some part of what is there is read then.
        arrived = min(arrived + samples, len(got) + 32)
        if not arrived:
            continue
        time_s = instant(sensor, arrived - 1)
        stored = arrived - len(got)
        assert read(part, time_s, sensor.F_STATUS, 1)[0] == stored
        expected = math.ceil(share * stored)
        if burst:
            data = read(part, time_s, 0x01, 6 * expected)
            got += [data[at : at + 6] for at in range(0, 6 * expected, 6)]
        else:
            got += [read(part, time_s, 0x01, 6) for _ in range(expected)]
    assert got == polled(sensor, len(got))


@both
@given(
    setup=st.sampled_from([CIRCULAR, CIRCULAR | 5, STOP, STOP | 32, TRIGGER | 7]),
    accesses=st.lists(st.tuples(st.integers(0, 50), st.integers(0, 34)), min_size=1, max_size=12),
)
def test_what_overflows_is_what_a_fifo_fed_sample_by_sample_loses(sensor, setup, accesses):
    mode, watermark = setup & 0xC0, setup & 0x3F
    if sensor is Gyroscope and mode == TRIGGER:
        mode = STOP  # F_MODE = 1x
    part = sensor(moving_world(), setup).part
    stored, overflowed, arrived = deque(), False, 0
    reference = polled(sensor, sum(samples for samples, _ in accesses))
    for samples, access in accesses:
        for number in range(arrived, arrived + samples):
            full = len(stored) == (watermark if mode == TRIGGER else 32)
            overflowed |= full and mode != TRIGGER
            if full and mode != STOP:
                stored.popleft()
            if not full or mode != STOP:
                stored.append(number)
        arrived += samples
        time_s = instant(sensor, arrived - 1)
        flags = (0x80 if overflowed else 0) | (0x40 if 0 < watermark <= len(stored) else 0)
        assert read(part, time_s, sensor.F_STATUS, 1)[0] == flags | len(stored)
        for _ in range(access):
            expected = reference[stored.popleft()] if stored else bytes(6)
            overflowed = overflowed and expected == bytes(6)
            assert read(part, time_s, 0x01, 6) == expected


@both
def test_looking_at_the_status_changes_nothing(sensor):
    looked_at, left_alone = (sensor(moving_world(), STOP | 9).part for _ in range(2))
    for number in range(80):
        read(looked_at, instant(sensor, number), sensor.F_STATUS, 1)
        read(looked_at, instant(sensor, number), 0x0A, 2)
    time_s = instant(sensor, 79)
    assert read(looked_at, time_s, 0x01, 6 * 33) == read(left_alone, time_s, 0x01, 6 * 33)


def test_an_hour_unread_costs_no_more_than_a_moment():
    class CountingWorld(World):
        asked = 0

        def state_at(self, time_s):
            self.asked += 1
            return super().state_at(time_s)

    for setup in (CIRCULAR, STOP):
        world = CountingWorld(FIELD)
        part = Accelerometer(world, setup).part
        assert read(part, 3600.0, 0x00, 1) == b"\xa0"
        read(part, 3600.0, 0x01, 6 * 32)
        assert world.asked == 32
