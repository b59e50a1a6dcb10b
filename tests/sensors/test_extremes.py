"""MAX and MIN registers of the FXOS8700CQ's magnetometer, and its automatic hard-iron calibration from them."""

import runpy
from pathlib import Path

import numpy as np
import pytest

from hiltest.world.distortion import MagneticDistortion
from hiltest.world.earth_field import EarthField
from hiltest.world.sensors.fxos8700cq import Fxos8700cq
from hiltest.world.world import World

from .bus_master import read, write

HARD_IRON_UT = (12.0, -30.0, 7.0)
CALIBRATES, RAW = 0x9F, 0x80  # of M_CTRL_REG1 and M_CTRL_REG3
FIRST = 13  # sample of the start at 0.05 s


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
    write(part, 2.0, 0x3F, 0x10)  # extremes are of the field without offsets
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


def test_they_are_of_all_runs_each_with_the_set_up_that_it_had_and_without_offsets():
    (part, _), (polled, _) = tumbling(), tumbling()
    write(polled, 0.05, 0x5D, RAW)
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


def calibrating(*, third=0x00, seed=2):
    """A part at 200 Hz that calibrates itself in a tumble."""
    world = World(EarthField(48.5, 62.0))
    end_s = world.tumble(time_s=0.0, duration_s=4.0)
    part = Fxos8700cq(world, MagneticDistortion(hard_iron_ut=HARD_IRON_UT), seed=seed)
    for register, value in ((0x5B, CALIBRATES), (0x5D, third), (0x2A, 0x0D)):
        write(part, 0.05, register, value)
    return part, end_s


def samples_until(part, end_s):
    return np.array([words(part, tick / 200 + 1e-6, 0x33, 3) for tick in range(FIRST, round(end_s * 200))])


def raw_samples():
    part, end_s = calibrating(third=RAW)
    return samples_until(part, end_s)


def middles(raw):
    """Middles of the extremes at the end of each sample, rounded down: the rule of the data sheet."""
    return (np.maximum.accumulate(raw) + np.minimum.accumulate(raw)) // 2


def test_automatic_calibration_subtracts_the_middle_of_the_extremes_before_each_sample():
    part, end_s = calibrating()
    raw = raw_samples()
    offsets = np.vstack([[0, 0, 0], middles(raw)[:-1]])
    assert (samples_until(part, end_s) == raw - offsets).all()
    assert np.abs(middles(raw)[-1]).max() > 200


def test_samples_that_nobody_reads_calibrate_as_well():
    part, end_s = calibrating()
    raw = raw_samples()
    assert (words(part, end_s - 0.005 + 1e-6, 0x33, 3) == raw[-1] - middles(raw)[-2]).all()


def test_axes_in_transfers_of_their_own_have_the_offsets_of_their_samples():
    (part, _), (whole, _) = calibrating(), calibrating()
    deliveries = []
    for tick in range(100, 400, 3):
        x = words(whole, tick / 200 + 1e-6, 0x33, 3)[0]
        y = words(whole, (tick + 1) / 200 + 1e-6, 0x33, 3)[1]
        z = words(whole, (tick + 2) / 200 + 1e-6, 0x33, 3)[2]
        for axis in range(3):
            words(part, (tick + axis) / 200 + 1e-6, 0x33 + 2 * axis, 1)
        deliveries.append((x, y, z))
    assert [row.words for row in part.outputs[1].deliveries] == deliveries


def test_the_offset_registers_hold_the_calibration_and_keep_it_when_it_is_switched_off():
    part, end_s = calibrating()
    loaded = 2 * middles(raw_samples())
    assert (words(part, 1.0 + 1e-6, 0x3F, 3) == loaded[200 - FIRST]).all()
    write(part, end_s - 0.005 + 1e-6, 0x5B, 0x1F)
    assert (words(part, end_s + 1.0, 0x3F, 3) == loaded[-1]).all()
    field = words(part, end_s + 1.0, 0x33, 3)
    write(part, end_s + 1.0, 0x2A, 0x0C)
    write(part, end_s + 1.0, 0x5D, RAW)
    write(part, end_s + 1.0, 0x2A, 0x0D)
    without = words(part, end_s + 2.0, 0x33, 3)
    assert without - field == pytest.approx(loaded[-1] // 2, abs=60)  # noise of 0.67 uT twice, within 6 sigma


def test_without_extremes_or_after_their_reset_the_calibration_has_their_present_middle():
    part, _ = calibrating()
    calibration = words(part, 2.0 + 1e-6, 0x3F, 3)
    write(part, 2.0 + 1e-6, 0x2A, 0x0C)
    write(part, 2.1, 0x5C, 0x10)
    write(part, 2.1, 0x2A, 0x0D)
    assert (words(part, 3.0, 0x3F, 3) == calibration).all()
    write(part, 3.0, 0x2A, 0x0C)
    write(part, 3.0, 0x5C, 0x04)
    assert not words(part, 3.0, 0x3F, 3).any()


def test_a_snapshot_keeps_the_calibration():
    part, end_s = calibrating()
    words(part, 1.0, 0x33, 3)
    state = part.state()
    first = [words(part, time_s, 0x33, 3).tolist() for time_s in (1.5, 2.5, end_s)]
    part.restore(state)
    assert [words(part, time_s, 0x33, 3).tolist() for time_s in (1.5, 2.5, end_s)] == first


def test_a_single_measurement_in_standby_is_among_the_extremes_of_the_run_after_it():
    part, end_s = tumbling()
    write(part, 1.0, 0x5B, 0x3D)
    single = words(part, 1.1, 0x33, 3)
    write(part, end_s, 0x5B, 0x1F)
    write(part, end_s, 0x2A, 0x0D)  # the board stands still from here on
    largest, smallest = words(part, end_s + 1.0, 0x45, 6).reshape(2, 3)
    assert ((largest == single) | (smallest == single)).sum() >= 2


def test_the_calibrator_of_the_leaderboard_is_what_the_part_loads():
    adapter = Path(__file__).parents[2] / "docs" / "leaderboard" / "hardware_fxos8700cq.py"
    part, end_s = calibrating()
    hard_iron_ut, soft_iron = runpy.run_path(str(adapter))["m_acal"](raw_samples() / 10)
    assert (words(part, end_s - 0.005 + 1e-6, 0x3F, 3) == 20 * hard_iron_ut).all()
    assert (soft_iron == np.eye(3)).all()
