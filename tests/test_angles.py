"""Angles and rotations: hand-computed cases, and properties over random ones."""

import math

import numpy as np
import pytest
from hypothesis import assume, given
from hypothesis import strategies as st

from hiltest.orientation.angles import (
    Pose,
    circular_mean_deg,
    heading_error_deg,
    pose_from_rotation,
    rotation_body_from_ned,
    sin_cos_deg,
    wrap_180,
    wrap_360,
)

angles = st.floats(-1000.0, 1000.0, allow_nan=False)
poses = st.builds(Pose, st.floats(0.0, 359.0), st.floats(-89.0, 89.0), st.floats(-179.0, 179.0))


@pytest.mark.parametrize(
    ("pose", "north_in_body", "down_in_body"),
    [
        (Pose(0, 0, 0), (1, 0, 0), (0, 0, 1)),
        (Pose(90, 0, 0), (0, -1, 0), (0, 0, 1)),  # facing east: north is on the left
        (Pose(180, 0, 0), (-1, 0, 0), (0, 0, 1)),
        (Pose(0, 90, 0), (0, 0, 1), (-1, 0, 0)),  # nose up: down is behind, north is where the belly points
        (Pose(0, -90, 0), (0, 0, -1), (1, 0, 0)),
        (Pose(0, 0, 90), (1, 0, 0), (0, 1, 0)),  # right wing down: down is to the right
        (Pose(90, 0, 90), (0, 0, 1), (0, 1, 0)),  # facing east, right wing down: north under the belly
    ],
)
def test_north_and_down_lie_where_a_hand_sketch_puts_them(pose, north_in_body, down_in_body):
    rotation = rotation_body_from_ned(pose)
    assert rotation[:, 0].tolist() == list(north_in_body)  # exact: sines of right angles are
    assert rotation[:, 2].tolist() == list(down_in_body)


@given(poses)
def test_a_pose_survives_the_way_through_its_rotation(pose):
    back = pose_from_rotation(rotation_body_from_ned(pose))
    # One ulp of a matrix element over cos(89 deg) = 0.017 is 1e-14 rad, 7e-13 deg.
    assert abs(heading_error_deg(back.heading_deg, pose.heading_deg)) < 1e-11
    assert abs(back.pitch_deg - pose.pitch_deg) < 1e-11
    assert abs(heading_error_deg(back.roll_deg, pose.roll_deg)) < 1e-11


@given(angles, angles, angles)
def test_every_pose_gives_a_rotation(heading, pitch, roll):
    rotation = rotation_body_from_ned(Pose(heading, pitch, roll))
    assert np.abs(rotation @ rotation.T - np.eye(3)).max() < 1e-15 * 8
    assert np.linalg.det(rotation) > 0.99


@given(st.floats(0.0, 359.0), st.sampled_from([90.0, -90.0]), st.floats(-179.0, 179.0))
def test_in_gimbal_lock_the_rotation_survives_though_the_angles_do_not(heading, pitch, roll):
    rotation = rotation_body_from_ned(Pose(heading, pitch, roll))
    back = pose_from_rotation(rotation)
    assert back.roll_deg == 0.0
    assert np.abs(rotation_body_from_ned(back) - rotation).max() < 1e-14


@pytest.mark.parametrize("bad", [np.zeros((3, 3)), np.diag([1, 1, -1]), np.eye(3) * 1.01, np.eye(2)])
def test_what_is_not_a_rotation_is_refused(bad):
    with pytest.raises(ValueError, match="not a rotation"):
        pose_from_rotation(bad)


@given(angles)
def test_wrapping_keeps_the_direction_and_the_interval(angle):
    low, high = wrap_180(angle), wrap_360(angle)
    assert -180.0 < low <= 180.0
    assert 0.0 <= high < 360.0
    assert abs(math.remainder(low - angle, 360.0)) < 1e-12
    # wrap_360 adds 360 to a small negative angle: half an ulp of 360 is lost.
    assert abs(math.remainder(high - angle, 360.0)) < 1e-12


def test_wrapping_at_the_ends_of_the_interval():
    assert [wrap_180(a) for a in (180.0, -180.0, 540.0, 0.0, -0.0)] == [180.0, 180.0, 180.0, 0.0, 0.0]
    assert [wrap_360(a) for a in (360.0, -360.0, 720.0, -1e-300)] == [0.0, 0.0, 0.0, 0.0]
    assert math.copysign(1.0, wrap_360(-0.0)) == 1.0


def test_heading_error_wraps_across_north():
    assert heading_error_deg(1.0, 359.0) == 2.0
    assert heading_error_deg(359.0, 1.0) == -2.0
    assert heading_error_deg(180.0, 0.0) == 180.0


@given(angles, st.floats(-179.0, 179.0))
def test_heading_error_is_what_was_added(reference, error):
    assert abs(heading_error_deg(reference + error, reference) - error) < 1e-11


@given(st.floats(0.0, 360.0), st.lists(st.floats(-60.0, 60.0), min_size=1, max_size=20))
def test_circular_mean_turns_with_its_angles(turn, spread):
    at_zero = circular_mean_deg(spread)
    turned = circular_mean_deg([turn + angle for angle in spread])
    assert abs(heading_error_deg(turned, at_zero + turn)) < 1e-9


def test_circular_mean_across_north_is_north():
    assert heading_error_deg(circular_mean_deg([350.0, 10.0]), 0.0) == pytest.approx(0.0, abs=1e-12)


@pytest.mark.parametrize("cancelling", [[], [0.0, 180.0], [0.0, 120.0, 240.0]])
def test_angles_without_a_mean_direction_are_refused(cancelling):
    with pytest.raises(ValueError, match=r"angles"):
        circular_mean_deg(cancelling)


@given(st.floats(-720.0, 720.0))
def test_sine_and_cosine_agree_with_the_c_library(angle):
    sine, cosine = sin_cos_deg(angle)
    assume(abs(angle) <= 720.0)
    # math.radians() itself errs by an ulp of up to 12.6 rad: 1.8e-15.
    assert abs(sine - math.sin(math.radians(angle))) < 4e-15
    assert abs(cosine - math.cos(math.radians(angle))) < 4e-15


def test_sine_and_cosine_are_pinned_to_the_bit():
    # Summed with exact rationals, rounded once; any host's function must give exactly these.
    assert [value.hex() for value in sin_cos_deg(18.7)] == ["0x1.484ec594f3f40p-2", "0x1.e4f8bedab562fp-1"]
    assert [sin_cos_deg(float(90 * k)) for k in range(-2, 3)] == [(0, -1), (-1, 0), (0, 1), (1, 0), (0, -1)]
    assert sin_cos_deg(30.0)[0] == pytest.approx(0.5, abs=1.2e-16)
