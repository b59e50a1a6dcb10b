"""The attitude filter: the float64 reference, and where the fixture says so the firmware's C."""

from __future__ import annotations

import math
from collections.abc import Callable

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from hiltest.orientation.angles import Pose
from hiltest.orientation.attitude_filter import (
    AttitudeFilter,
    AttitudeFilterSettings,
    AttitudeFilterStatus,
    filter_attitudes,
)
from hiltest.orientation.quaternions import from_pose, normalised, pose_of, rotation_ned_from_body

from .filters import swaying_motion
from .quaternion_algebra import angle_between_deg, conjugate, from_rotation_vector, product

OK, FIELD_LEFT_OUT = AttitudeFilterStatus.OK, AttitudeFilterStatus.FIELD_LEFT_OUT
NO_ATTITUDE, BAD_STEP = AttitudeFilterStatus.NO_ATTITUDE, AttitudeFilterStatus.BAD_STEP
DT_S = 0.01
STILL = (0.0, 0.0, 0.0)
LEVEL_G = (0.0, 0.0, 1.0)
DIP_RAD = math.radians(60.0)
FIELD = (math.cos(DIP_RAD), 0.0, math.sin(DIP_RAD))
TIMES = AttitudeFilterSettings()
# float64 keeps 1e-16 of a quaternion; an arc tangent of a hundred thousand such roundings is below this.
FLOAT64_DEG = 1e-9

FilterMaker = Callable[..., AttitudeFilter]
components = st.floats(-1.0, 1.0, width=32)
units = (
    st.tuples(components, components, components, components)
    .filter(lambda values: math.hypot(*values) > 0.1)
    .map(np.array)
    .map(normalised)
)


def field_at(heading_deg: float, *, scale: float = 1.0) -> tuple[float, float, float]:
    """Return the field that a level body with this heading measures."""
    angle = math.radians(heading_deg)
    horizontal = scale * math.cos(DIP_RAD)
    return horizontal * math.cos(angle), -horizontal * math.sin(angle), scale * math.sin(DIP_RAD)


def rest(attitude_filter: AttitudeFilter, seconds: float, gravity_g=LEVEL_G, field=FIELD, rate_rad_s=STILL) -> set:
    """Update with the same readings for a time; return the statuses."""
    return {attitude_filter.update(rate_rad_s, gravity_g, field, DT_S) for _ in range(round(seconds / DT_S))}


def heading_deg(attitude_filter: AttitudeFilter) -> float:
    return math.degrees(2.0 * math.atan2(attitude_filter.attitude[2], attitude_filter.attitude[3]))


def inclination_deg(attitude_filter: AttitudeFilter) -> float:
    x, y, _, _ = attitude_filter.attitude
    return math.degrees(2.0 * math.asin(math.hypot(x, y)))


# --- exact where nothing is wrong ---------------------------------------------------------------------------------


def test_on_perfect_data_the_filter_stays_on_the_truth(either_filter: FilterMaker, rounding_deg: float):
    motion = swaying_motion(60.0)
    attitude_filter = either_filter()
    errors_deg = []
    for rate, gravity, field, truth in zip(
        np.radians(motion.rates_dps), motion.gravity_g, motion.field, motion.attitudes[1:], strict=True
    ):
        assert attitude_filter.update(rate, gravity, field, motion.dt_s) is OK
        errors_deg.append(angle_between_deg(attitude_filter.attitude, truth))
    assert max(errors_deg) < max(1e-6, rounding_deg)


def test_without_corrections_a_constant_rate_is_integrated_exactly(either_filter: FilterMaker, rounding_deg: float):
    attitude_filter = either_filter()
    rate_rad_s = np.radians((30.0, -40.0, 120.0))
    for _ in range(1000):
        assert attitude_filter.turn(rate_rad_s, 0.005) is OK
    assert angle_between_deg(attitude_filter.attitude, from_rotation_vector(5.0 * rate_rad_s)) < rounding_deg


@given(units)
@settings(max_examples=10)
def test_rotated_sensors_give_the_rotated_attitude(mounting: np.ndarray):
    """However the sensors are mounted, the filter has the same errors: nothing in it prefers an axis of the body."""
    motion, noise = swaying_motion(10.0), np.random.default_rng(5).normal(0.0, 0.02, (3, 1000, 3))
    readings = [np.radians(motion.rates_dps) + noise[0], motion.gravity_g + noise[1], motion.field + noise[2]]
    to_sensor = rotation_ned_from_body(mounting).T
    straight = filter_attitudes(*readings, 100.0)
    rotated = filter_attitudes(*(values @ to_sensor.T for values in readings), 100.0)
    for attitude, other in zip(straight[::100], rotated[::100], strict=True):
        assert angle_between_deg(product(attitude, mounting), other) < 1e-6


def test_the_bias_is_subtracted_from_the_rate(either_filter: FilterMaker, rounding_deg: float):
    attitude_filter = either_filter((0.1, -0.2, 0.3))
    assert rest(attitude_filter, 5.0, rate_rad_s=(0.1, -0.2, 0.3)) == {OK}
    assert angle_between_deg(attitude_filter.attitude, (0.0, 0.0, 0.0, 1.0)) < rounding_deg


@given(units)
@settings(max_examples=30)
def test_the_first_attitude_is_the_measured_one(either_filter: FilterMaker, rounding_deg: float, truth: np.ndarray):
    to_body = rotation_ned_from_body(truth).T
    attitude_filter = either_filter()
    assert attitude_filter.update(STILL, to_body[:, 2], to_body @ FIELD, DT_S) is OK
    assert angle_between_deg(attitude_filter.attitude, truth) < rounding_deg


def test_the_first_seconds_are_a_mean_that_weighs_each_measurement_by_its_time(either_filter: FilterMaker):
    """So noise falls with the root of the number of samples, and the first ones are forgotten."""
    noise_deg = np.random.default_rng(7).normal(0.0, 2.0, (40, 200))
    errors_deg, expected_deg = [], []
    for row in noise_deg:
        attitude_filter = either_filter()
        for value in row:
            attitude_filter.update(STILL, LEVEL_G, field_at(value), DT_S)
        errors_deg.append(heading_deg(attitude_filter))
        expected_deg.append(np.average(row, weights=np.arange(1, 201)))
    # The correction is the sine of the angle: 6 degrees, three deviations, are 0.01 degrees more than their sine.
    assert errors_deg == pytest.approx(expected_deg, abs=0.01)


# --- time constants -------------------------------------------------------------------------------------------------


def test_an_error_of_the_rate_tilts_the_attitude_by_its_product_with_the_time(either_filter: FilterMaker):
    attitude_filter = either_filter()
    rest(attitude_filter, 60.0, rate_rad_s=(math.radians(0.1), 0.0, 0.0))
    # After 57 s the transient is exp(-57 / 3) of it; a step of 10 ms is 0.3 % of the time.
    assert inclination_deg(attitude_filter) == pytest.approx(0.1 * TIMES.tilt_time_s, rel=0.01)


def test_an_error_of_the_rate_turns_the_heading_by_its_product_with_the_time(either_filter: FilterMaker):
    attitude_filter = either_filter()
    rest(attitude_filter, 200.0, rate_rad_s=(0.0, 0.0, math.radians(0.1)))
    # exp(-200 / 20) is left of the way there.
    assert heading_deg(attitude_filter) == pytest.approx(0.1 * TIMES.heading_time_s, rel=0.01)


@pytest.mark.parametrize("frequency_hz", [0.5, 1.0, 2.0])
def test_a_translation_to_and_fro_tilts_the_attitude_by_two_amplitudes_over_g_times_the_squared_time(
    either_filter: FilterMaker, frequency_hz: float
):
    """A second-order low-pass divides the acceleration by the squared frequency that it is a multiple of."""
    attitude_filter = either_filter()
    amplitude_m, omega = 0.1, 2.0 * math.pi * frequency_hz
    rest(attitude_filter, 10.0)
    tilts_deg = []
    for step in range(round(40.0 / DT_S)):
        acceleration_g = amplitude_m * omega**2 * math.sin(omega * step * DT_S) / 9.80665
        attitude_filter.update(STILL, (-acceleration_g, 0.0, 1.0), FIELD, DT_S)
        tilts_deg.append(inclination_deg(attitude_filter))
    expected_deg = math.degrees(2.0 * amplitude_m / (9.80665 * TIMES.tilt_time_s**2))
    # The cut-off of 0.075 Hz is a seventh of 0.5 Hz, which takes 1 %; steps of 10 ms take 3 % of a sine of 2 Hz.
    assert max(tilts_deg[-200:]) == pytest.approx(expected_deg, rel=0.03 if frequency_hz < 2.0 else 0.08)


def test_a_wrong_heading_falls_to_1_over_e_within_the_time(either_filter: FilterMaker):
    attitude_filter = either_filter()
    rest(attitude_filter, 60.0)
    assert rest(attitude_filter, TIMES.heading_time_s, field=field_at(10.0)) == {OK}
    # The sine of 10 degrees is 0.5 % less than the angle.
    assert 10.0 - heading_deg(attitude_filter) == pytest.approx(10.0 / math.e, rel=0.01)
    assert inclination_deg(attitude_filter) < 0.01


def test_an_upside_down_heading_is_corrected_too(either_filter: FilterMaker):
    attitude_filter = either_filter()
    rest(attitude_filter, 0.1)
    rest(attitude_filter, 400.0, field=field_at(179.0))
    assert abs(heading_deg(attitude_filter)) == pytest.approx(179.0, abs=0.1)


# --- disturbances -----------------------------------------------------------------------------------------------------


def test_a_strong_magnet_does_not_turn_the_heading_and_is_forgotten_at_once(either_filter: FilterMaker):
    attitude_filter = either_filter()
    rest(attitude_filter, 60.0)
    assert rest(attitude_filter, 60.0, field=(-8.0, 9.0, 3.0)) == {FIELD_LEFT_OUT}
    assert abs(heading_deg(attitude_filter)) < 0.01
    assert rest(attitude_filter, 1.0) == {OK}


def test_a_new_place_with_a_stronger_field_is_accepted_in_the_end(either_filter: FilterMaker):
    """The expected field moves by a tenth of itself in its time constant; 0.3 is two tenths beyond the gate."""
    attitude_filter = either_filter()
    rest(attitude_filter, 200.0)
    assert rest(attitude_filter, 100.0, field=field_at(10.0, scale=1.3)) == {FIELD_LEFT_OUT}
    rest(attitude_filter, 100.0, field=field_at(10.0, scale=1.3))
    assert rest(attitude_filter, 100.0, field=field_at(10.0, scale=1.3)) == {OK}
    assert heading_deg(attitude_filter) == pytest.approx(10.0, abs=0.5)


@pytest.mark.parametrize(
    "field",
    [(0.0, 0.0, 0.0), (math.nan, 0.0, 1.0), (1e30, 0.0, 0.0), (0.0, 0.0, 1.0)],
    ids=["none", "NaN", "huge", "vertical"],
)
def test_without_a_usable_field_the_tilt_is_still_corrected(either_filter: FilterMaker, field: tuple[float, ...]):
    attitude_filter = either_filter()
    rest(attitude_filter, 5.0)
    attitude_filter.turn((math.radians(20.0), 0.0, 0.0), 1.0)
    attitude_filter.correct(LEVEL_G, FIELD)
    before_deg = inclination_deg(attitude_filter)
    assert before_deg > 15.0
    assert rest(attitude_filter, 20.0, field=field) == {FIELD_LEFT_OUT}
    assert inclination_deg(attitude_filter) < 0.1


def test_free_fall_leaves_the_tilt_alone(either_filter: FilterMaker, rounding_deg: float):
    attitude_filter = either_filter()
    rest(attitude_filter, 5.0)
    assert rest(attitude_filter, 5.0, gravity_g=(0.0, 0.0, 0.0)) == {OK}
    assert inclination_deg(attitude_filter) < rounding_deg


def test_a_start_in_motion_is_forgotten_with_the_square_of_the_samples(either_filter: FilterMaker):
    """The first of n samples has the weight 2 / (n (n + 1)) in the mean."""
    attitude_filter = either_filter()
    attitude_filter.update(STILL, (1.0, 0.0, 1.0), FIELD, DT_S)
    assert inclination_deg(attitude_filter) == pytest.approx(45.0, abs=1e-3)
    rest(attitude_filter, 1.0)
    # The corrections are sines: that of 45 degrees is a tenth less than the angle, which leaves some more.
    assert 0.0 < inclination_deg(attitude_filter) < 1.5 * 45.0 * 2.0 / (100 * 101)


def test_a_heading_that_begins_wrong_beside_a_magnet_is_corrected_after_it(either_filter: FilterMaker):
    """While the tilt is young, for 6 s, each field is expected, so the magnet's does not keep the earth's out."""
    attitude_filter = either_filter()
    rest(attitude_filter, 2.0, field=(-2.0, 3.0, -1.0))
    assert abs(heading_deg(attitude_filter)) > 120.0
    rest(attitude_filter, 60.0)
    turned = (heading_deg(attitude_filter) + 180.0) % 360.0 - 180.0
    # A correction is at most 57 degrees times its gain, so 146 degrees last longer than the mean would tell.
    assert abs(turned) < 5.0


# --- what is refused ------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("rate_rad_s", "dt_s"),
    [
        ((math.nan, 0.0, 0.0), DT_S),
        ((math.inf, 0.0, 0.0), DT_S),
        (STILL, math.nan),
        (STILL, math.inf),
        (STILL, -DT_S),
        ((3.2, 0.0, 0.0), 1.0),
    ],
)
def test_an_impossible_step_changes_nothing(
    either_filter: FilterMaker, rate_rad_s: tuple[float, float, float], dt_s: float
):
    attitude_filter, other = either_filter(), either_filter()
    for result in (attitude_filter, other):
        rest(result, 1.0, field=field_at(20.0))
    assert attitude_filter.update(rate_rad_s, LEVEL_G, FIELD, dt_s) is BAD_STEP
    for result in (attitude_filter, other):
        rest(result, 1.0, field=field_at(30.0))
    assert attitude_filter.attitude.tolist() == other.attitude.tolist()


@pytest.mark.parametrize("gravity_g", [(math.nan, 0.0, 1.0), (0.0, math.inf, 1.0), (0.0, 0.0, 1e7)])
def test_unusable_gravity_corrects_nothing(either_filter: FilterMaker, gravity_g: tuple[float, float, float]):
    attitude_filter = either_filter()
    rest(attitude_filter, 1.0)
    before = attitude_filter.attitude.tolist()
    assert attitude_filter.update(STILL, gravity_g, field_at(30.0), DT_S) is NO_ATTITUDE
    assert attitude_filter.attitude.tolist() == pytest.approx(before, abs=1e-7)


@pytest.mark.parametrize(
    ("gravity_g", "field"),
    [
        ((0.0, 0.0, 0.0), FIELD),
        (LEVEL_G, (0.0, 0.0, 0.0)),
        (LEVEL_G, LEVEL_G),
        ((0.0, 0.6, -0.8), (0.0, -6.0, 8.0)),
        ((0.0, 0.0, math.inf), FIELD),
        (LEVEL_G, (math.nan, 0.0, 0.0)),
        (LEVEL_G, (1e20, 0.0, 0.0)),
        (LEVEL_G, (1e-20, 0.0, 0.0)),
        (LEVEL_G, (5e-4, 0.0, 1.0)),
    ],
    ids=["no gravity", "no field", "parallel", "antiparallel", "infinite", "NaN", "huge", "tiny", "0.03 deg"],
)
def test_no_attitude_begins_without_gravity_and_a_field_across_it(
    either_filter: FilterMaker, gravity_g: tuple[float, float, float], field: tuple[float, float, float]
):
    attitude_filter = either_filter()
    assert attitude_filter.update(STILL, gravity_g, field, DT_S) is NO_ATTITUDE
    assert attitude_filter.attitude.tolist() == [0.0, 0.0, 0.0, 1.0]
    assert attitude_filter.update(STILL, LEVEL_G, field_at(50.0), DT_S) is OK
    assert heading_deg(attitude_filter) == pytest.approx(50.0, abs=1e-3)


def test_a_second_correction_without_time_between_has_no_weight(either_filter: FilterMaker):
    attitude_filter = either_filter()
    rest(attitude_filter, 1.0)
    before = attitude_filter.attitude.tolist()
    assert attitude_filter.correct((0.5, 0.0, 0.8), field_at(40.0)) is OK
    assert attitude_filter.attitude.tolist() == before


def test_after_a_gap_one_measurement_counts_for_a_second_and_no_more(either_filter: FilterMaker):
    attitude_filter = either_filter()
    rest(attitude_filter, 60.0)
    attitude_filter.turn(STILL, 600.0)
    assert attitude_filter.correct(LEVEL_G, field_at(10.0)) is OK
    assert heading_deg(attitude_filter) == pytest.approx(10.0 / TIMES.heading_time_s, rel=0.01)


# --- C and reference ----------------------------------------------------------------------------------------------


def test_turned_by_hand_an_attitude_reads_as_its_pose():
    """The convention: body to north, east and down, x forward, y right, z down."""
    truth = Pose(200.0, 20.0, -30.0)
    to_body = rotation_ned_from_body(from_pose(truth)).T
    attitude_filter = AttitudeFilter(STILL)
    attitude_filter.update(STILL, to_body[:, 2], to_body @ FIELD, DT_S)
    pose = pose_of(attitude_filter.attitude)
    assert (pose.heading_deg, pose.pitch_deg, pose.roll_deg) == pytest.approx((200.0, 20.0, -30.0), abs=FLOAT64_DEG)
    assert product(conjugate(attitude_filter.attitude), from_pose(truth))[3] == pytest.approx(1.0)
