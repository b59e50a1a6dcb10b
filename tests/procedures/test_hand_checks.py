"""Poses that stick out are found by the raw field alone: those that were set wrong, and no others."""

from __future__ import annotations

import numpy as np
import pytest

from hiltest.orientation.angles import Pose, rotation_body_from_ned
from hiltest.procedures.hand_checks import setting_errors_deg, side_in_words

FIELD_NED_UT = 48.5 * np.array([np.cos(np.radians(62.0)), 0.0, np.sin(np.radians(62.0))])
TILTS = ((0, 0), (20, 25), (-25, -15), (20, -25), (-20, 15))
POSES = [Pose(heading, pitch, roll) for pitch, roll in TILTS for heading in range(0, 360, 30)]
U_DEG = 1.0
RUNS = 400


def wrong_poses(draws: np.random.Generator, poses: list[Pose], errors_deg: dict[int, float]) -> dict[int, float]:
    """Return the poses that stick out for a board with any iron and an operator with U = 1 and these slips."""
    turns = np.array([rotation_body_from_ned(pose) for pose in poses])
    slips = np.array([errors_deg.get(index, 0.0) for index in range(len(poses))])
    true = [
        rotation_body_from_ned(Pose(pose.heading_deg + error, pose.pitch_deg, pose.roll_deg))
        for pose, error in zip(poses, slips + draws.normal(0.0, U_DEG / 2.0, len(poses)), strict=True)
    ]
    iron = np.eye(3) + draws.normal(0.0, 0.1, (3, 3))
    read = np.array(true) @ FIELD_NED_UT @ iron.T + draws.normal(0.0, 40.0, 3) + draws.normal(0.0, 0.1, (len(poses), 3))
    return setting_errors_deg(turns @ FIELD_NED_UT, turns[:, :, 2], read, U_DEG)


@pytest.mark.parametrize("count", [12, 60])
def test_slips_are_found_and_honest_poses_seldom_are(count: int) -> None:
    draws = np.random.default_rng(3)
    poses = POSES[:: len(POSES) // count]
    honest = [wrong_poses(draws, poses, {}) for _ in range(RUNS)]
    missed = offered = 0
    for _ in range(RUNS):
        slips = {int(index): 28.0 for index in draws.choice(count, count // 12, replace=False)}
        found = wrong_poses(draws, poses, slips)
        missed += bool(slips.keys() - found.keys())
        offered += len(found.keys() - slips.keys())
    # A robust deviation of 60 values is known to 10 %, of 12 to a quarter: their tails are longer.
    assert sum(map(len, honest)) / RUNS < {12: 0.6, 60: 0.3}[count]
    assert offered / RUNS < {12: 0.6, 60: 0.3}[count]
    assert missed <= {12: 0.05, 60: 0.0}[count] * RUNS


def test_a_stuck_sensor_and_few_poses_give_no_error() -> None:
    turns = np.array([rotation_body_from_ned(pose) for pose in POSES])
    known = turns @ FIELD_NED_UT
    assert setting_errors_deg(known, turns[:, :, 2], np.ones((60, 3)), U_DEG) == {}
    assert setting_errors_deg(known[:7], turns[:7, :, 2], known[:7], U_DEG) == {}


def test_a_direction_is_told_by_the_sides_of_the_board() -> None:
    assert side_in_words((0.7, 0.1, 0.7)) == "nose and underside"
    assert side_in_words((-0.58, -0.58, -0.58)) == "tail and left side and top"
