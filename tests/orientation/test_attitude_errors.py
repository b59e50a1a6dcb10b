"""The benchmark's errors: total, heading and inclination, over phases of a recording."""

from __future__ import annotations

import math

import numpy as np
import pytest
from hypothesis import assume, given
from hypothesis import strategies as st

from hiltest.errors import ConfigError
from hiltest.orientation.angles import Pose
from hiltest.orientation.attitude_errors import AttitudeErrors, attitude_errors, phases, score_estimator
from hiltest.orientation.motion_recording import MotionRecording
from hiltest.orientation.quaternions import from_pose, normalised

from .quaternion_algebra import from_rotation_vector, product

# A quaternion of float64 is exact to 1e-16, and an angle of half of it as well.
FLOAT64_DEG = 1e-12

components = st.floats(-1.0, 1.0)
units = (
    st.tuples(components, components, components, components)
    .filter(lambda values: math.hypot(*values) > 0.1)
    .map(np.array)
    .map(normalised)
)


def errors_of(estimate: np.ndarray, truth: np.ndarray) -> tuple[float, float, float]:
    errors = attitude_errors(estimate[None], truth[None])
    return float(errors.total_deg[0]), float(errors.heading_deg[0]), float(errors.inclination_deg[0])


@pytest.mark.parametrize("angle_deg", [0.0, 1e-7, 5.0, 90.0, 179.0, -60.0])
def test_a_rotation_about_the_vertical_is_a_heading_error_and_no_inclination(angle_deg: float):
    truth = from_pose(Pose(30.0, 40.0, -50.0))
    estimate = product(from_rotation_vector([0.0, 0.0, math.radians(angle_deg)]), truth)
    assert errors_of(estimate, truth) == pytest.approx((abs(angle_deg), abs(angle_deg), 0.0), abs=FLOAT64_DEG * 100)


@pytest.mark.parametrize("angle_deg", [1e-7, 5.0, 90.0, 179.0])
def test_a_rotation_about_a_horizontal_axis_is_an_inclination_and_no_heading_error(angle_deg: float):
    truth = from_pose(Pose(30.0, 40.0, -50.0))
    axis = np.array([math.cos(1.0), math.sin(1.0), 0.0])
    estimate = product(from_rotation_vector(math.radians(angle_deg) * axis), truth)
    assert errors_of(estimate, truth) == pytest.approx((angle_deg, 0.0, angle_deg), abs=FLOAT64_DEG * 100)


@given(units, units)
def test_half_the_cosine_of_the_total_is_the_product_of_those_of_its_parts(estimate: np.ndarray, truth: np.ndarray):
    total, heading, inclination = np.radians(errors_of(estimate, truth))
    assert math.cos(total / 2) == pytest.approx(math.cos(heading / 2) * math.cos(inclination / 2), abs=1e-12)
    assert max(heading, inclination) <= total + 1e-7


@given(units, units, units, st.floats(-180.0, 180.0))
def test_neither_the_world_s_heading_nor_the_sensor_s_mounting_changes_an_error(
    estimate: np.ndarray, truth: np.ndarray, mounting: np.ndarray, turn_deg: float
):
    assume(errors_of(estimate, truth)[2] < 179.0)  # upside down there is no heading
    world = from_rotation_vector([0.0, 0.0, math.radians(turn_deg)])
    moved = [product(world, product(attitude, mounting)) for attitude in (estimate, truth)]
    # An angle near 180 degrees, of a quaternion's part near 0, is exact to the square root of a rounding.
    assert errors_of(*moved) == pytest.approx(errors_of(estimate, truth), abs=1e-5)


@given(units, units, st.floats(0.1, 10.0))
def test_sign_and_norm_of_a_quaternion_do_not_matter(estimate: np.ndarray, truth: np.ndarray, norm: float):
    assume(errors_of(estimate, truth)[2] < 179.0)
    assert errors_of(-norm * estimate, truth) == pytest.approx(errors_of(estimate, truth), abs=1e-5)


def test_a_score_is_the_rms_over_samples_that_have_a_truth():
    errors = AttitudeErrors(np.array([3.0, 4.0, np.nan, 9.0]), np.zeros(4), np.ones(4))
    mask = np.array([True, True, True, False])
    score = errors.score(mask)
    assert score is not None
    assert (score.total_deg, score.heading_deg, score.inclination_deg, score.samples) == (
        math.sqrt(12.5),
        0.0,
        1.0,
        2,
    )
    assert errors.score(np.array([False, False, True, False])) is None


@pytest.mark.parametrize(
    ("estimate", "fault"),
    [
        ([[0.0, 0.0, 0.0, 1.0], [math.nan, 0.0, 0.0, 1.0]], r"the estimate of sample 1 is no attitude: \[nan"),
        ([[0.0, 0.0, 0.0, 0.0], [0.0, 0.0, 0.0, 1.0]], "the estimate of sample 0 is no attitude"),
        ([[0.0, 0.0, 0.0, 1.0]], r"estimates have shape \(1, 4\), and the truth has \(2, 4\)"),
    ],
)
def test_an_estimate_that_is_no_attitude_is_refused(estimate: list[list[float]], fault: str):
    with pytest.raises(ConfigError, match=fault):
        attitude_errors(estimate, np.tile([0.0, 0.0, 0.0, 1.0], (2, 1)))


def level_recording(rate_hz: float = 10.0) -> MotionRecording:
    """Return 20 s of a level body: motion from 10 s on, pushed from 12 to 14 s, a magnet nearby from 16 to 18 s."""
    times_s = np.arange(200) / rate_hz
    acceleration = np.tile([0.0, 0.0, -9.80665], (200, 1))
    acceleration[(times_s >= 12.0) & (times_s < 14.0), 0] = 3.0
    field = np.tile([20.0, 0.0, 40.0], (200, 1))
    field[(times_s >= 16.0) & (times_s < 18.0), 1] = 10.0
    rates = np.tile([0.01, 0.02, 0.03], (200, 1))
    truth = np.tile([0.0, 0.0, 0.0, 1.0], (200, 1))
    truth[190:] = np.nan
    return MotionRecording("level", rate_hz, rates, acceleration, field, truth, times_s >= 10.0)


def test_phases_are_taken_from_the_truth():
    masks = phases(level_recording())
    times_s = {name: (np.flatnonzero(mask) / 10.0).tolist() for name, mask in masks.items()}
    assert (times_s["motion"][0], times_s["motion"][-1]) == (10.0, 19.9)
    assert (times_s["first seconds"][0], times_s["first seconds"][-1]) == (0.0, 4.9)
    assert (times_s["rest"][0], times_s["rest"][-1]) == (5.0, 9.9)
    assert times_s["translation"] == pytest.approx(np.arange(120, 140) / 10.0)
    assert times_s["disturbed field"] == pytest.approx(np.arange(160, 180) / 10.0)


def test_first_seconds_and_rest_begin_with_the_estimator():
    masks = phases(level_recording(), starts_s=3.05)
    times_s = {name: (np.flatnonzero(mask) / 10.0).tolist() for name, mask in masks.items()}
    assert (times_s["first seconds"][0], times_s["first seconds"][-1]) == (3.1, 8.0)
    assert (times_s["rest"][0], times_s["rest"][-1]) == (8.1, 9.9)
    assert times_s["motion"][0] == 10.0


def test_an_estimator_gets_gravity_in_g_and_rates_without_their_bias():
    recording, arguments = level_recording(), []

    def estimator(rates: np.ndarray, gravity_g: np.ndarray, field: np.ndarray, rate_hz: float) -> np.ndarray:
        arguments.extend([rates, gravity_g, field, rate_hz])
        return np.tile(from_rotation_vector([0.0, 0.0, math.radians(2.0)]), (len(rates), 1))

    scores = score_estimator(recording, estimator)
    assert arguments[0] == pytest.approx(np.zeros((200, 3)), abs=1e-15)
    assert arguments[1][0].tolist() == [0.0, 0.0, 1.0]
    assert arguments[2] is recording.field_ut
    assert arguments[3] == 10.0
    assert set(scores) == {"motion", "first seconds", "rest", "translation", "disturbed field"}
    assert scores["motion"].samples == 90
    assert scores["motion"].total_deg == pytest.approx(2.0)
    score_estimator(recording, estimator, subtract_bias=False)
    assert arguments[4].tolist() == recording.gyroscope_rad_s.tolist()


def test_a_phase_without_samples_has_no_row():
    recording = level_recording()
    still = MotionRecording(
        "still",
        10.0,
        recording.gyroscope_rad_s,
        np.tile([0.0, 0.0, -9.80665], (200, 1)),
        np.tile([20.0, 0.0, 40.0], (200, 1)),
        recording.truth,
        recording.movement,
    )
    scores = score_estimator(still, lambda rates, *_: np.tile([0.0, 0.0, 0.0, 1.0], (len(rates), 1)))
    assert set(scores) == {"motion", "first seconds", "rest"}
    assert scores["motion"].total_deg == 0.0
