"""The algebra of attitude quaternions: against rotation matrices, which are another way to say the same."""

from __future__ import annotations

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from hiltest.orientation.angles import Pose, heading_error_deg, rotation_body_from_ned
from hiltest.orientation.quaternions import (
    from_ned_axes,
    from_pose,
    normalised,
    pose_of,
    rotation_ned_from_body,
)
from hiltest.world.motion import body_rate_dps

from .quaternion_algebra import angle_between_deg, conjugate, from_rotation_vector, product

# Sums and products of a few numbers up to 1 in float64, each rounded to 1.1e-16.
ROUNDING = 1e-14

components = st.floats(-1.0, 1.0)
anything = st.tuples(components, components, components, components).map(np.array)
units = anything.filter(lambda values: bool(np.linalg.norm(values) > 0.1)).map(normalised)
vectors = st.tuples(components, components, components).map(np.array)
poses = st.builds(Pose, st.floats(0.0, 360.0), st.floats(-90.0, 90.0), st.floats(-180.0, 180.0))


@given(units, units)
def test_a_product_turns_as_the_product_of_the_matrices_does(first, second):
    together = rotation_ned_from_body(first) @ rotation_ned_from_body(second)
    assert rotation_ned_from_body(product(first, second)) == pytest.approx(together, abs=ROUNDING)


@given(units, vectors)
def test_the_matrix_is_the_sandwich(unit, vector):
    turned = product(product(unit, np.append(vector, 0.0)), conjugate(unit))
    assert turned == pytest.approx(np.append(rotation_ned_from_body(unit) @ vector, 0.0), abs=ROUNDING)


@given(poses)
def test_the_quaternion_of_a_pose_has_its_rotation_and_its_angles(pose):
    unit = from_pose(pose)
    assert rotation_ned_from_body(unit) == pytest.approx(rotation_body_from_ned(pose).T, abs=ROUNDING)
    back = pose_of(unit)
    assert rotation_body_from_ned(back) == pytest.approx(rotation_body_from_ned(pose), abs=1e-7)  # acos-like near +-90
    if abs(pose.pitch_deg) < 80.0:
        assert abs(heading_error_deg(back.heading_deg, pose.heading_deg)) < 1e-11


@given(units)
def test_both_signs_of_a_quaternion_are_one_attitude(unit):
    assert rotation_ned_from_body(-unit).tolist() == rotation_ned_from_body(unit).tolist()
    back = from_ned_axes(rotation_ned_from_body(unit))
    assert back[3] >= 0.0
    assert min(np.linalg.norm(back - unit), np.linalg.norm(back + unit)) < ROUNDING
    assert angle_between_deg(unit, -unit) < 1e-6


@given(st.tuples(*[st.floats(-3.0, 3.0)] * 3).map(np.array))
def test_a_rotation_vector_turns_about_itself_by_its_length(vector):
    turn = from_rotation_vector(vector)
    assert rotation_ned_from_body(turn) @ vector == pytest.approx(vector, abs=1e-13)
    angle_rad = np.linalg.norm(vector)
    assert turn[3] == pytest.approx(math.cos(angle_rad / 2.0), abs=ROUNDING)
    # Two halves are the whole: no step length is special.
    assert product(from_rotation_vector(vector / 2.0), from_rotation_vector(vector / 2.0)) == pytest.approx(
        turn, abs=ROUNDING
    )


@given(poses, st.tuples(*[st.floats(-90.0, 90.0)] * 3))
def test_body_rates_multiply_on_the_right(pose, angle_rates):
    """What is easily turned round: the rates of the angles, and those of the body, lead to the same place."""
    dt_s = 1e-5
    later = Pose(
        pose.heading_deg + angle_rates[0] * dt_s,
        pose.pitch_deg + angle_rates[1] * dt_s,
        pose.roll_deg + angle_rates[2] * dt_s,
    )
    turn = from_rotation_vector(np.radians(body_rate_dps(pose, angle_rates)) * dt_s)
    # The rates change within the step: by the square of the angles it turns, 1.6e-5 rad each.
    assert np.radians(angle_between_deg(product(from_pose(pose), turn), from_pose(later))) < 3e-9
