"""MAX and MIN registers of the FXOS8700CQ's magnetometer."""

import numpy as np

from hiltest.world.distortion import MagneticDistortion
from hiltest.world.earth_field import EarthField
from hiltest.world.sensors.fxos8700cq import Fxos8700cq
from hiltest.world.world import World

from .bus_master import read, write

HARD_IRON_UT = (12.0, -30.0, 7.0)


def words(part, time_s, register, count):
    return np.frombuffer(read(part, time_s, register, 2 * count), ">i2").astype(int)


def tumbling():
    world = World(EarthField(48.5, 62.0))
    end_s = world.tumble(time_s=0.0, duration_s=4.0)
    part = Fxos8700cq(world, MagneticDistortion(hard_iron_ut=HARD_IRON_UT), seed=2)
    write(part, 0.05, 0x5B, 0x1F)
    return part, end_s


def test_they_are_the_extremes_of_all_samples_read_or_not():
    part, end_s = tumbling()
    assert not words(part, 0.05, 0x45, 6).any()
    write(part, 0.05, 0x2A, 0x0D)
    polled, _ = tumbling()
    write(polled, 0.05, 0x2A, 0x0D)
    ticks = np.arange(14, round(end_s * 200))
    samples = np.array([words(polled, tick / 200 + 1e-6, 0x33, 3) for tick in ticks])
    for until in (100, 400, len(ticks)):
        result = words(part, ticks[until - 1] / 200 + 1e-6, 0x45, 6).reshape(2, 3)
        assert (result == [samples[:until].max(axis=0), samples[:until].min(axis=0)]).all()


def test_their_middle_is_the_hard_iron_after_a_tumble():
    part, end_s = tumbling()
    write(part, 0.05, 0x2A, 0x0D)
    largest, smallest = words(part, end_s, 0x45, 6).reshape(2, 3)
    x, y, z = (largest + smallest) / 2
    # Each extreme is within 2 % of 485 counts (coverage of the tumble) and 4 sigma of 6 counts.
    assert np.abs(np.array([-y, -x, -z]) - 10 * np.array(HARD_IRON_UT)).max() < 0.02 * 485 + 24


def test_standby_keeps_them_and_its_reset_bit_and_a_software_reset_forget_them():
    (part, _), (running, _) = tumbling(), tumbling()
    write(part, 0.05, 0x2A, 0x0D)
    write(running, 0.05, 0x2A, 0x0D)
    write(part, 2.0, 0x2A, 0x0C)
    write(part, 2.0, 0x3F, 0x10)  # an offset changes samples to come, not the extremes of those that were
    assert (words(part, 2.1, 0x45, 6) == words(running, 2.0, 0x45, 6)).all()
    write(part, 2.3, 0x5C, 0x04)
    assert not words(part, 2.3, 0x45, 6).any()
    write(part, 2.4, 0x2A, 0x0D)
    assert words(part, 3.0, 0x45, 6).any()
    write(part, 3.1, 0x2A, 0x0C)
    assert not write(part, 3.1, 0x2B, 0x40)
    assert not words(part, 3.2, 0x45, 6).any()


def test_they_can_be_switched_off():
    part, end_s = tumbling()
    write(part, 0.05, 0x5C, 0x10)
    write(part, 0.05, 0x2A, 0x0D)
    assert not words(part, 2.0, 0x45, 6).any()
    write(part, 2.0, 0x2A, 0x0C)
    write(part, 2.0, 0x5C, 0x00)
    assert not words(part, 2.1, 0x45, 6).any()
    write(part, end_s, 0x2A, 0x0D)  # the board stands still from here on: only noise is between the extremes
    largest, smallest = words(part, end_s + 1.0, 0x45, 6).reshape(2, 3)
    assert (largest - smallest < 2 * 5 * 7).all()  # 200 readings of 0.67 uT, at oversampling 8: within 5 sigma


def test_they_are_of_all_runs_each_with_the_set_up_that_it_had():
    (part, _), (polled, _) = tumbling(), tumbling()
    samples = []
    for run in range(150):
        begin_s = 0.1 + 0.025 * run
        for item in (part, polled):
            write(item, begin_s, 0x3F, run % 8)
            write(item, begin_s, 0x2A, (0x05, 0x0D)[run % 2])
        samples += [words(polled, begin_s + 0.001 * millisecond, 0x33, 3) for millisecond in range(1, 25)]
        for item in (part, polled):
            write(item, begin_s + 0.0245, 0x2A, 0x04)
    result = words(part, 4.0, 0x45, 6).reshape(2, 3)
    assert (result == [np.max(samples, axis=0), np.min(samples, axis=0)]).all()
