"""A face that is not quite true tilts the board that lies on it, by its angle and about its axis."""

from __future__ import annotations

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from hiltest.calibration.still_pose import FACES, Face
from hiltest.orientation.angles import Pose, rotation_body_from_ned
from hiltest.world.faces import askew
from hiltest.world.sensors import AccelerometerErrors
from hiltest.world.sensors.drift import REFERENCE_DEGC

DOWN = np.array([0.0, 0.0, 1.0])
_turn = st.tuples(*[st.floats(-2.0, 2.0)] * 3)


def gravity_g(pose: Pose) -> np.ndarray:
    return rotation_body_from_ned(pose) @ DOWN


@pytest.mark.parametrize("face", FACES)
def test_a_true_face_is_the_pose_that_puts_its_axis_down(face: Face) -> None:
    assert gravity_g(askew(face.pose, (0.0, 0.0, 0.0))) == pytest.approx(face.gravity_g, abs=1e-15)


def test_a_level_board_turned_about_x_or_y_rolls_or_pitches() -> None:
    rolled, pitched = askew(Pose(30.0), (1.0, 0.0, 0.0)), askew(Pose(30.0), (0.0, 1.0, 0.0))
    assert (rolled.heading_deg, rolled.pitch_deg, rolled.roll_deg) == pytest.approx((30.0, 0.0, 1.0), abs=1e-12)
    assert (pitched.heading_deg, pitched.pitch_deg, pitched.roll_deg) == pytest.approx((30.0, 1.0, 0.0), abs=1e-12)


@given(face=st.sampled_from(FACES), turn=_turn)
def test_gravity_turns_by_the_part_of_the_angle_that_is_level(face: Face, turn: tuple[float, float, float]) -> None:
    observed = gravity_g(askew(face.pose, turn))
    across = math.hypot(*(angle for axis, angle in enumerate(turn) if axis != face // 2))
    apart_deg = math.degrees(
        math.atan2(float(np.linalg.norm(np.cross(observed, face.gravity_g))), observed @ face.gravity_g)
    )
    # Exact for a turn about a level axis alone; with one about the vertical beside it, to second order: 2 deg squared.
    assert apart_deg == pytest.approx(across, abs=0.001 if turn[face // 2] else 1e-9)


def test_the_part_reads_of_each_axis_what_its_errors_say() -> None:
    errors = AccelerometerErrors(
        (0.01, 0.02, 0.03), (0.1, 0.2, 0.3), ((0.0, 0.001, 0.002), (0.003, 0.0, 0.004), (0.005, 0.006, 0.0))
    )
    assert errors.apply((1.0, 0.0, 0.0), REFERENCE_DEGC) == pytest.approx((1.11, 0.023, 0.035))
    assert errors.apply((0.0, -1.0, 0.0), REFERENCE_DEGC) == pytest.approx((0.009, -1.18, 0.024))
    assert errors.apply((0.0, 0.0, 1.0), REFERENCE_DEGC) == pytest.approx((0.012, 0.024, 1.33))
