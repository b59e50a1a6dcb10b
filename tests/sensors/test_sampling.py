"""What all parts share: the sampling grid, noise per sample, and independence of when one looks."""

import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from hiltest.orientation.angles import Pose, rotation_body_from_ned
from hiltest.world.distortion import MagneticDistortion
from hiltest.world.earth_field import EarthField
from hiltest.world.sensors.drift import REFERENCE_DEGC
from hiltest.world.sensors.fxas21002c import Fxas21002c
from hiltest.world.sensors.fxos8700cq import (
    AccelerometerErrors,
    Fxos8700cq,
    Fxos8700cqNoise,
    noise_at_oversampling,
    oversampling,
)
from hiltest.world.sensors.mag3110 import Mag3110, output_rate_hz
from hiltest.world.temperature import Temperature
from hiltest.world.world import World

from .bus_master import read, write

FIELD = EarthField(48.5, 62.0)
CYCLE_S = 1.0 / 120e6


def words(data):
    return np.frombuffer(data, dtype=">i2").astype(int).tolist()


def active_mag3110(world, *, seed=1, at_s=0.01, control1=0x01, **options):
    part = Mag3110(world, MagneticDistortion(), seed=seed, **options)
    write(part, at_s, 0x10, control1)
    return part


def active_fxos8700cq(world, *, seed=1, at_s=0.01, distortion=None, modes=0x02, control1=0x0D, **options):
    part = Fxos8700cq(world, distortion or MagneticDistortion(), seed=seed, **options)
    for register, value in ((0x5B, 0x1F), (0x5C, 0x20), (0x0E, 0x01), (0x2B, modes), (0x2A, control1)):
        write(part, at_s, register, value)
    return part


def active_fxas21002c(world, *, seed=1, at_s=0.06, **options):
    part = Fxas21002c(world, seed=seed, **options)
    write(part, at_s, 0x13, 0x0A)
    return part


def test_configuring_one_cycle_later_changes_no_sample():
    world = World(FIELD)
    parts = [active_mag3110(world, at_s=0.01 + late * CYCLE_S) for late in (0, 1, 500)]
    for tick in range(10, 200):
        time_s = tick / 80.0 + 0.003
        first, *others = [read(part, time_s, 0x00, 7) for part in parts]
        assert others == [first, first]


@settings(max_examples=20)
@given(st.lists(st.integers(5, 400), min_size=1, max_size=30, unique=True))
def test_a_sample_is_the_same_whichever_others_were_read(ticks):
    world = World(FIELD)
    everything, some = active_mag3110(world), active_mag3110(world)
    whole = {tick: read(everything, tick / 80.0 + 0.001, 0x01, 6) for tick in range(5, 401)}
    for tick in sorted(ticks):
        assert read(some, tick / 80.0 + 0.009, 0x01, 6) == whole[tick]


def test_a_sampling_instant_is_met_at_the_very_cycle_it_falls_on():
    for tick in range(20, 2000, 7):
        part = active_mag3110(World(FIELD))
        cycle = tick * 1_500_000  # 12.5 ms of 120 MHz
        read(part, (cycle - 100_000) / 120e6, 0x01, 6)
        assert read(part, (cycle - 1) / 120e6, 0x00, 1) == b"\x00"
        assert read(part, cycle / 120e6, 0x00, 1) == b"\x0f"


def test_noise_at_a_judged_pose_is_the_same_whenever_one_gets_there():
    answers = []
    for command_s in (1.0, 4.2 + 1e-6, 17.0):
        world = World(FIELD)
        parts = [active_mag3110(world), active_fxos8700cq(world), active_fxas21002c(world)]
        arrival = world.turn_to(Pose(120, 0, 20), time_s=command_s, known_angle=31)
        answers.append([read(part, arrival + 0.002 + k / 20.0, 0x01, 6) for k in range(20) for part in parts])
    assert answers[0] == answers[1] == answers[2]


def test_another_seed_gives_other_noise_and_the_same_mean():
    world = World(FIELD)
    values = np.array(
        [
            [words(read(part, k / 80.0 + 0.001, 0x01, 6)) for k in range(10, 1010)]
            for part in (active_mag3110(world, seed=1), active_mag3110(world, seed=2))
        ]
    )
    assert (values[0] != values[1]).mean() > 0.8
    # 4 counts rms over sqrt(1000), times sqrt(2) for the difference, times 5.
    assert np.abs(values.mean(axis=1)[0] - values.mean(axis=1)[1]).max() < 5 * 4.0 * math.sqrt(2.0 / 1000)


@pytest.mark.parametrize(("code", "sigma_ut"), [(0, 0.4), (1, 0.35), (2, 0.3), (3, 0.25)])
def test_mag3110_noise_is_the_data_sheets_at_every_oversampling(code, sigma_ut):
    control1 = 0x01 | code << 3
    rate_hz = output_rate_hz(control1)
    part = active_mag3110(World(FIELD), control1=control1)
    values = np.array([words(read(part, k / rate_hz + 0.001, 0x01, 6)) for k in range(20, 2020)]) / 10.0
    # Rounding to 0.1 uT adds 1/12 of a count squared; a standard deviation of n samples is known to 1/sqrt(2n).
    expected = math.hypot(sigma_ut, 0.1 / math.sqrt(12.0))
    assert np.allclose(values.std(axis=0), expected, rtol=4.0 / math.sqrt(2 * 2000))


def test_accelerometer_and_gyroscope_noise_are_the_data_sheets():
    world = World(FIELD)
    accelerometer, gyroscope = active_fxos8700cq(world), active_fxas21002c(world)
    times = np.arange(100, 3100) / 200.0 + 0.001
    gravity = np.array([words(read(accelerometer, float(t), 0x01, 6)) for t in times]) / 8192.0
    rate = np.array([words(read(gyroscope, float(t), 0x01, 6)) for t in times]) / 16.0
    tolerance = 4.0 / math.sqrt(2 * 3000)
    # 126 ug/sqrt(Hz) over 100 Hz, and 1/2048 g of quantisation; 25 mdps/sqrt(Hz) over 64 Hz, and 1/16 dps.
    assert np.allclose(gravity.std(axis=0), math.hypot(1.26e-3, 1 / 2048 / math.sqrt(12)), rtol=tolerance)
    assert np.allclose(rate.std(axis=0), math.hypot(0.2, 1 / 16 / math.sqrt(12)), rtol=tolerance)


@pytest.mark.parametrize(
    ("modes", "control1", "ratio"),
    [
        (0x00, 0x0D, math.sqrt(2.0)),  # normal: 4 samples at 200 Hz instead of 8
        (0x03, 0x0D, 2.0),  # low power: 2
        (0x02, 0x09, 126.0 / 99.0),  # without low noise
        (0x03, 0x09, 2.0 * 126.0 / 99.0),
    ],
)
def test_modes_of_the_accelerometer_have_their_noise(modes, control1, ratio):
    part = active_fxos8700cq(World(FIELD), modes=modes, control1=control1)
    times = np.arange(100, 3100) / 200.0 + 0.001
    gravity = np.array([words(read(part, float(t), 0x01, 6)) for t in times]) / 8192.0
    expected_g = math.hypot(ratio * 1.26e-3, 1 / 2048 / math.sqrt(12))
    assert np.allclose(gravity.std(axis=0), expected_g, rtol=4.0 / math.sqrt(2 * 3000))


@pytest.mark.parametrize(
    ("modes", "control1", "conversions", "sigma"),
    [(0x1F, 0x00, 2, 15.0), (0x01, 0x00, 2, 15.0), (0x1D, 0x28, 128, 3.0)],  # 800 Hz, and 12.5 Hz [counts rms]
)
def test_a_single_measurement_of_the_field_ends_by_itself(modes, control1, conversions, sigma):
    world = World(FIELD)
    part = Fxos8700cq(world, MagneticDistortion(), seed=1)
    write(part, 0.1, 0x2A, control1)
    write(part, 0.1, 0x5B, modes | 0x20)
    assert read(part, 0.1001, 0x5B, 1) == bytes([modes | 0x20])
    assert read(part, 0.1001, 0x32, 1) == b"\x00"
    # The turn-on time of 1 ms, the conversions, and the next instant of their grid.
    end_s = 0.101 + 2 * conversions / 1600.0
    assert read(part, end_s, 0x5B, 1) == bytes([modes])
    assert read(part, end_s, 0x32, 1) == b"\x0f"
    first = read(part, end_s, 0x33, 6)
    others = [words(read(active_fxos8700cq(world), 0.1 + k / 200.0, 0x33, 6)) for k in range(100)]
    assert np.abs(np.array(words(first)) - np.mean(others, axis=0)).max() < 5.0 * sigma
    assert read(part, 1.0, 0x32, 1) == b"\x00"  # no other measurement follows
    assert read(part, 1.0, 0x33, 6) == first
    write(part, 1.1, 0x5B, modes | 0x20)
    assert read(part, 1.3, 0x33, 6) != first


SHIELD_TO_BODY = {
    # As fixed on the shield: what a driver must do with each part's words.
    "mag3110": lambda x, y, z: (-y, -x, z),
    "accelerometer": lambda x, y, z: (y, x, z),
    "magnetometer": lambda x, y, z: (-y, -x, -z),
    "gyroscope": lambda x, y, z: (-y, -x, -z),
}


@given(st.floats(0.0, 359.0), st.floats(-89.0, 89.0), st.floats(-179.0, 179.0))
@settings(max_examples=50)
def test_through_the_shields_axis_map_every_part_sees_the_body_frame(heading, pitch, roll):
    pose = Pose(heading, pitch, roll)
    world = World(FIELD, pose=pose)
    mag = active_mag3110(world, noise_ut=(0.0,) * 4)
    fxos = active_fxos8700cq(world, noise=Fxos8700cqNoise(0.0, (0.0, 0.0)))
    gyroscope = active_fxas21002c(world, bias_dps=(1.0, -2.0, 3.0), noise_density=0.0)
    rotation = rotation_body_from_ned(pose)
    field_counts = 10.0 * rotation @ FIELD.ned_ut
    # Half a count of rounding; 14 bits in a 16-bit word: half of 4.
    assert np.abs(SHIELD_TO_BODY["mag3110"](*words(read(mag, 1.0, 0x01, 6))) - field_counts).max() <= 0.5
    assert np.abs(SHIELD_TO_BODY["magnetometer"](*words(read(fxos, 1.0, 0x33, 6))) - field_counts).max() <= 0.5
    gravity = SHIELD_TO_BODY["accelerometer"](*words(read(fxos, 1.0, 0x01, 6)))
    assert np.abs(gravity - 8192.0 * rotation[:, 2]).max() <= 2.0
    assert SHIELD_TO_BODY["gyroscope"](*words(read(gyroscope, 1.0, 0x01, 6))) == (16, -32, 48)


@given(st.floats(0.0, 359.0), st.floats(-89.0, 89.0), st.integers(0, 100))
@settings(max_examples=30)
def test_acceleration_words_are_left_justified_and_aligned_with_the_field(heading, pitch, tick):
    part = active_fxos8700cq(World(FIELD, pose=Pose(heading, pitch)))
    burst = read(part, 0.5 + tick / 200.0, 0x00, 19)  # status, acceleration, field, acceleration once more
    assert all(word % 4 == 0 for word in words(burst[1:7]))
    assert burst[13:19] == burst[1:7]


def test_accelerometer_offset_and_gain_act_in_the_body_frame():
    errors = AccelerometerErrors(offset_g=(0.01, -0.02, 0.03), gain_error=(0.5, 0.25, -0.125))
    assert errors.apply((1.0, 0.0, 0.0), REFERENCE_DEGC) == pytest.approx((1.51, -0.02, 0.03))
    assert errors.apply((0.0, 1.0, 0.0), REFERENCE_DEGC) == pytest.approx((0.01, 1.23, 0.03))
    part = active_fxos8700cq(World(FIELD), errors=errors, noise=Fxos8700cqNoise(0.0))
    x, y, z = words(read(part, 0.5, 0x01, 6))
    assert (y, x, z) == (80, -164, 7412)  # 4 round(2048 g): 20.48, -40.96, 2048 * 0.905 = 1853.44


def test_strong_fields_saturate_instead_of_wrapping():
    strong = MagneticDistortion(hard_iron_ut=(5000.0, -5000.0, 5000.0))
    mag = Mag3110(World(FIELD), strong, seed=1)
    write(mag, 0.01, 0x11, 0x20)
    write(mag, 0.01, 0x10, 0x01)
    assert words(read(mag, 0.5, 0x01, 6)) == [20_000, -20_000, 20_000]  # part x = -body y, y = -body x
    fxos = active_fxos8700cq(World(FIELD), distortion=strong)
    assert words(read(fxos, 0.5, 0x33, 6)) == [12_000, -12_000, -12_000]


def test_acceleration_and_rate_saturate_at_their_words():
    much = AccelerometerErrors(offset_g=(9.0, -9.0, 0.0))
    part = active_fxos8700cq(World(FIELD), errors=much)
    assert words(read(part, 0.5, 0x01, 6))[:2] == [-8192 * 4, 8191 * 4]
    gyroscope = active_fxas21002c(World(FIELD), bias_dps=(3000.0, -3000.0, 0.0))
    assert words(read(gyroscope, 0.5, 0x01, 6))[:2] == [32_767, -32_768]


def test_a_turn_shows_in_the_gyroscope_with_the_right_sign_and_size():
    world = World(FIELD)
    gyroscope = active_fxas21002c(world, noise_density=0.0)
    arrival = world.turn_to(Pose(90), time_s=1.0)
    start = arrival - 0.75
    rates = [-words(read(gyroscope, start + k / 200.0 + 0.001, 0x01, 6))[2] / 16.0 for k in range(150)]
    # Turning right is positive about down; the trapezoid sum of the quintic's rate is the angle to 0.1 %.
    assert sum(rates) / 200.0 == pytest.approx(90.0, abs=0.1)
    assert max(rates) == pytest.approx(120.0 * 15 / 8, rel=0.01)


def test_a_burst_holds_one_sample_though_another_arrives_in_it():
    part = active_mag3110(World(FIELD), noise_ut=(50.0,) * 4)
    alone = read(part, 0.1126, 0x01, 6)
    part.start(False, 0.1249)
    part.write(0x01, 0.1249)
    part.start(True, 0.1249)
    split = bytes(part.read(0.1249 + k * 5e-5) for k in range(6))  # 0.125 s passes after the second byte
    part.stop(0.1253)
    assert split == alone
    assert read(part, 0.1253, 0x00, 1) == b"\x0f"  # the new sample is new, and nothing was overwritten
    assert read(part, 0.1253, 0x01, 6) != alone


def test_die_temperatures_follow_the_world():
    world = World(FIELD, temperature=Temperature(-10.0))
    assert read(active_mag3110(world, die_temperature_offset_degc=4.0), 1.0, 0x0F, 1) == bytes([256 - 6])
    assert read(active_fxos8700cq(world), 1.0, 0x51, 1) == bytes([256 - 10])  # -10 / 0.96 = -10.4
    assert read(active_fxas21002c(world), 1.0, 0x12, 1) == bytes([256 - 10])


def test_the_fxos8700cq_renews_its_temperature_with_the_field_alone():
    world = World(FIELD, temperature=Temperature(10.0, 40.0, ramp_s=1.0))
    part = Fxos8700cq(world, MagneticDistortion(), seed=1)
    assert read(part, 0.5, 0x51, 1) == b"\x00"
    write(part, 0.5, 0x5B, 0x1F)
    write(part, 0.5, 0x2A, 0x0D)
    warm = read(part, 0.7, 0x51, 1)
    assert warm == bytes([round(31 / 0.96)])
    write(part, 0.7, 0x2A, 0x0C)
    assert read(part, 2.0, 0x51, 1) == warm
    write(part, 2.0, 0x5B, 0x1C)  # the accelerometer alone
    write(part, 2.0, 0x2A, 0x0D)
    assert read(part, 3.0, 0x51, 1) == warm


@pytest.mark.parametrize(
    ("control1", "rate_hz"), [(0x00, 80.0), (0x08, 40.0), (0x18, 10.0), (0x20, 40.0), (0xE0, 0.625), (0xF8, 0.078125)]
)
def test_mag3110_rates_are_the_data_sheets(control1, rate_hz):
    assert output_rate_hz(control1) == rate_hz


def test_fxos8700cq_oversampling_follows_its_table():
    assert [oversampling(200.0, code) for code in range(8)] == [2, 2, 2, 2, 2, 2, 4, 8]
    assert [oversampling(1.5625, code) for code in range(8)] == [16, 16, 32, 64, 128, 256, 512, 1024]
    assert noise_at_oversampling(2, (1.5, 0.3)) == 1.5
    assert noise_at_oversampling(32, (1.5, 0.3)) == noise_at_oversampling(1024, (1.5, 0.3)) == 0.3
    assert 0.3 < noise_at_oversampling(8, (1.5, 0.3)) < 1.5


def test_the_words_of_a_noisy_world_are_pinned():
    # The same on every host, or runs of one seed could not be compared: see hiltest.world.noise.
    world = World(FIELD, mounting_yaw_deg=1.7)
    parts = [active_mag3110(world), active_fxos8700cq(world), active_fxas21002c(world)]
    end = world.tumble(time_s=0.1, duration_s=4.0)
    assert [words(read(part, end - 2.0001, 0x01, 6)) for part in parts] == [
        [40, -471, -104],
        [-576, 7856, 2224],
        [637, -9342, 42],
    ]
