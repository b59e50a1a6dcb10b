"""A tumble that visits given poses."""

import numpy as np
import pytest

from hiltest.orientation.angles import Pose
from hiltest.world.earth_field import EarthField
from hiltest.world.motion import PoseTour
from hiltest.world.world import World

POSES = (Pose(350.0, 10.0, -20.0), Pose(10.0, 45.0, 80.0), Pose(40.0, -45.0, -80.0))
TOUR = PoseTour(1.0, 7.0, POSES)


def test_the_table_stands_at_each_pose_for_half_of_its_time_and_turns_the_shorter_way() -> None:
    for index, pose in enumerate(POSES):
        for time_s in (1.0 + 2.0 * index, 1.999 + 2.0 * index):
            assert TOUR.angles(time_s) == (pose, (0.0, 0.0, 0.0))
    headings = [TOUR.angles(time_s)[0].heading_deg for time_s in (2.0, 2.5, 2.999)]
    assert headings == pytest.approx([350.0, 360.0, 370.0], abs=1e-3)
    assert TOUR.angles(100.0) == (POSES[-1], (0.0, 0.0, 0.0))


@pytest.mark.parametrize("time_s", [1.5, 2.3, 2.7, 4.5])
def test_the_rates_are_those_of_the_angles(time_s: float) -> None:
    before, after = (TOUR.angles(time_s + offset_s)[0] for offset_s in (-1e-6, 1e-6))
    changes = np.subtract(
        (after.heading_deg, after.pitch_deg, after.roll_deg), (before.heading_deg, before.pitch_deg, before.roll_deg)
    )
    assert TOUR.angles(time_s)[1] == pytest.approx(changes / 2e-6, abs=1e-3)


def test_a_tumble_begins_when_the_table_has_turned_to_the_first_pose_and_ends_at_the_last() -> None:
    world = World(EarthField(48.5, 62.0), tumble_poses=POSES)
    end_s = world.tumble(time_s=0.0, duration_s=6.0)
    begin_s = world.last_move_start_s
    assert end_s - begin_s == pytest.approx(6.0)
    assert world.state_at(begin_s + 0.5).pose == POSES[0]
    assert world.state_at(end_s + 1.0).pose == POSES[-1]
