"""A tumble that is confined to a part of the sphere."""

import math

import numpy as np
import pytest

from hiltest.orientation.angles import rotation_body_from_ned
from hiltest.world.earth_field import EarthField
from hiltest.world.motion import MOVE_GRID_S
from hiltest.world.spiral import SPIRAL_S, Cap
from hiltest.world.world import World

FIELD = EarthField(strength_ut=48.5, dip_deg=62.0)
AXES = [(0.0, 0.0, 1.0), (0.0, 0.0, -2.0), (1.0, -1.0, 0.5)]


def seen(cap, *, mounting_yaw_deg=1.7, points=300):
    """Return the field's directions in the body frame at equal times over a tumble."""
    world = World(FIELD, mounting_yaw_deg=mounting_yaw_deg, covered=cap)
    end = world.tumble(time_s=0.0, duration_s=2.0)
    times = world.last_move_start_s + SPIRAL_S * (np.arange(points) + 0.5) / points
    assert times[-1] < end
    return np.array([world.state_at(float(time_s)).field_body_ut for time_s in times]) / FIELD.strength_ut


@pytest.mark.parametrize("axis", AXES)
@pytest.mark.parametrize("fraction", [0.2, 0.5, 1.0])
def test_the_field_comes_from_within_the_cap_and_evenly_over_it(axis, fraction):
    along = seen(Cap(axis, fraction)) @ np.array(axis) / math.hypot(*axis)
    # The poses are rounded to 1e-9 degrees.
    assert along.min() >= 1.0 - 2.0 * fraction - 1e-9
    # Areas are linear in the cosine: as many points in each tenth of it, less the 0.2 % at both ends.
    counts, _ = np.histogram((1.0 - along) / (2.0 * fraction), bins=10, range=(0.0, 1.0))
    assert counts.min() >= 29
    assert counts.max() <= 31


def test_the_points_of_a_half_sphere_are_spread_all_round_its_axis_and_on_no_spokes():
    x, y, _ = seen(Cap((0.0, 0.0, 1.0), 0.5)).T
    turns = np.sort(np.arctan2(y, x) / (2.0 * math.pi))
    gaps = np.diff(turns, append=turns[0] + 1.0)
    # 300 points are 1/300 of a turn apart; on 21 spokes, as many as a turn has points, they would be 1/21.
    assert gaps.max() < 0.01


def test_the_mounting_does_not_change_what_the_board_sees():
    cap = Cap((0.0, 0.0, 1.0), 0.5)
    assert np.allclose(seen(cap, mounting_yaw_deg=0.0), seen(cap, mounting_yaw_deg=40.0), atol=1e-10)


@pytest.mark.parametrize("axis", AXES)
@pytest.mark.parametrize("moment", [0.4, 3.3, 11.9])
def test_the_rate_is_the_derivative_of_the_attitude(axis, moment):
    world = World(FIELD, mounting_yaw_deg=12.0, covered=Cap(axis, 0.5))
    world.tumble(time_s=0.0, duration_s=2.0)
    time_s, step_s = world.last_move_start_s + moment, 1e-4
    before, after = (rotation_body_from_ned(world.state_at(time_s + sign * step_s).pose) for sign in (-1, 1))
    # d/dt R = -[w]x R for R body from earth.
    skew = -(after - before) / (2 * step_s) @ rotation_body_from_ned(world.state_at(time_s).pose).T
    rate = np.degrees([skew[2, 1], skew[0, 2], skew[1, 0]])
    # Central difference: (7 rad/s)^3 step^2 / 6 is 3e-5 deg/s; poses rounded to 1e-9 degrees over 2 steps, 5e-6.
    assert np.allclose(world.state_at(time_s).rate_body_dps, rate, atol=1e-4)


def test_a_spiral_has_its_own_pace_whatever_was_asked_and_a_hand_could_not_follow():
    for asked_s in (0.5, 5.6):
        world = World(FIELD, covered=Cap((0.0, 0.0, 1.0), 0.5))
        end = world.tumble(time_s=0.0, duration_s=asked_s)
        begin = world.last_move_start_s
        assert world.tumble_takes_s(asked_s) == SPIRAL_S == pytest.approx(end - begin, abs=MOVE_GRID_S)
        rates = [math.hypot(*world.state_at(begin + 0.01 * k).rate_body_dps) for k in range(1250)]
        assert 404.0 <= min(rates) <= max(rates) < 450.0
        assert world.state_at(end).rate_body_dps == (0.0, 0.0, 0.0)


def test_the_table_moves_smoothly_into_the_spiral_and_out_of_it():
    world = World(FIELD, mounting_yaw_deg=1.7, covered=Cap((0.0, 0.0, 1.0), 0.5))
    end = world.tumble(time_s=0.0, duration_s=2.0)
    world.hold(time_s=end)
    for moment in (world.last_move_start_s, end):
        before, after = (rotation_body_from_ned(world.state_at(moment + sign * 1e-6).pose) for sign in (-1, 1))
        # A microsecond at 450 degrees a second, both ways.
        assert np.degrees(np.abs(after - before).max()) < 2e-3
