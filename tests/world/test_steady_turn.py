"""A turn at a constant rate: whole, smooth, and about an axis that stands still in the body."""

from __future__ import annotations

import numpy as np
import pytest

from hiltest.orientation.angles import Pose, wrap_180
from hiltest.world.earth_field import EarthField
from hiltest.world.steady_turn import RAMP_S, steady_turn
from hiltest.world.world import World

DOWN = [(Pose(10.0, -90.0, 0.0), 0), (Pose(10.0, 0.0, 90.0), 1), (Pose(10.0), 2)]


@pytest.mark.parametrize("turn_deg", [360.0, -360.0, 725.0])
def test_it_keeps_the_rate_and_ends_where_it_should(turn_deg: float) -> None:
    turn = steady_turn(Pose(10.0), turn_deg, rate_dps=90.0, start_s=1.0)
    steady = [turn.angles(time_s)[1][0] for time_s in np.linspace(1.0 + RAMP_S, turn.end_s - RAMP_S, 7)]
    assert steady == pytest.approx([steady[0]] * 7)
    # It ends on a grid of 0.05 s.
    assert 90.0 * (1.0 - 0.05 / 4.0) < abs(steady[0]) <= 90.0
    assert turn.angles(1.0) == (Pose(10.0), (0.0, 0.0, 0.0))
    assert turn.angles(turn.end_s) == (Pose(10.0 + turn_deg), (0.0, 0.0, 0.0))


def test_its_rate_is_the_change_of_its_angle() -> None:
    turn = steady_turn(Pose(0.0), 360.0, rate_dps=60.0, start_s=0.0)
    h = 1e-6
    for time_s in np.linspace(h, turn.end_s - h, 101):
        slope = (turn.angles(time_s + h)[0].heading_deg - turn.angles(time_s - h)[0].heading_deg) / (2.0 * h)
        # Central difference: rounding of 360 degrees over 2e-6 s is 3e-8, its error in h^2 less.
        assert turn.angles(time_s)[1][0] == pytest.approx(slope, abs=1e-6)


@pytest.mark.parametrize(("pose", "axis"), DOWN)
def test_the_body_turns_about_the_axis_that_is_down(pose: Pose, axis: int) -> None:
    world = World(EarthField(48.5, 62.0), mounting_yaw_deg=1.7, pose=pose)
    end_s = world.turn_round(360.0, rate_dps=90.0, time_s=1.0)
    rates = np.array([world.state_at(time_s).rate_body_dps for time_s in np.arange(1.0, end_s, 0.005)])
    across = np.delete(rates, axis, axis=1)
    assert np.abs(across).max() < 1e-12
    # The rectangle rule over a course that begins and ends at rest, and is smooth; sampled 100 times a ramp.
    assert rates[:, axis].sum() * 0.005 == pytest.approx(360.0, abs=1e-3)
    assert wrap_180(world.state_at(end_s).pose.heading_deg - pose.heading_deg - 1.7) == pytest.approx(0.0, abs=1e-9)


def test_the_table_stands_still_until_it_begins() -> None:
    world = World(EarthField(48.5, 62.0))
    end_s = world.turn_round(90.0, rate_dps=90.0, time_s=2.0)
    assert world.state_at(1.9).rate_body_dps == (0.0, 0.0, 0.0)
    assert world.state_at(3.0).rate_body_dps[2] == pytest.approx(90.0)
    assert world.state_at(end_s).rate_body_dps == (0.0, 0.0, 0.0)
    assert world.state_at(end_s).pose.heading_deg == pytest.approx(90.0)
