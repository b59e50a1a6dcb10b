"""The simulated world: what surrounds the board, and how the turntable moves it."""

import math
from itertools import pairwise

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from hiltest.orientation.angles import Pose, heading_error_deg, rotation_body_from_ned
from hiltest.world.distortion import MagneticDistortion
from hiltest.world.earth_field import EarthField
from hiltest.world.motion import MOVE_GRID_S, next_on_grid
from hiltest.world.world import World

FIELD = EarthField(strength_ut=50.0, dip_deg=60.0)
CYCLE_S = 1.0 / 120e6

angles = st.floats(-180.0, 180.0)


def test_level_and_north_the_body_sees_the_earth_frame():
    state = World(FIELD).state_at(1.0)
    assert state.field_body_ut == pytest.approx((25.0, 0.0, 50.0 * math.sqrt(0.75)), abs=1e-13)
    assert state.gravity_body_g == (0.0, 0.0, 1.0)
    assert state.rate_body_dps == (0.0, 0.0, 0.0)


def test_the_mounting_turns_the_board_by_its_yaw_at_every_tilt():
    world = World(FIELD, mounting_yaw_deg=1.7)
    for pose in (Pose(0), Pose(90, 20, 0), Pose(330, 0, -20)):
        arrival = world.turn_to(pose, time_s=1.0)
        board = world.state_at(arrival).pose
        assert board.heading_deg == pytest.approx((pose.heading_deg + 1.7) % 360, abs=1e-12)
        assert (board.pitch_deg, board.roll_deg) == (pose.pitch_deg, pose.roll_deg)


@given(angles, st.floats(-80.0, 80.0), angles)
def test_field_and_gravity_are_those_of_the_pose(heading, pitch, roll):
    world = World(FIELD)
    pose = Pose(heading, pitch, roll)
    state = world.state_at(world.turn_to(pose, time_s=0.5))
    rotation = rotation_body_from_ned(pose)
    assert np.allclose(state.field_body_ut, rotation @ FIELD.ned_ut, atol=1e-11)
    assert np.allclose(state.gravity_body_g, rotation[:, 2], atol=1e-13)


@given(st.floats(0.0, 1000.0))
def test_the_next_grid_point_is_the_first_one_after(time_s):
    following = next_on_grid(time_s)
    assert 0.0 < following - time_s <= MOVE_GRID_S + 1e-9
    assert abs(math.remainder(following, MOVE_GRID_S)) < 1e-9


def test_firmware_that_is_a_few_cycles_slower_sees_the_same_motion():
    fast, slow = World(FIELD), World(FIELD)
    for pose in (Pose(30), Pose(60, 20), Pose(350, 0, -20)):
        asked_s = 1.0 + pose.heading_deg / 10.0
        assert fast.turn_to(pose, time_s=asked_s) == slow.turn_to(pose, time_s=asked_s + 40 * CYCLE_S)
    for time_s in np.linspace(0.0, 60.0, 997):
        assert fast.state_at(float(time_s)) == slow.state_at(float(time_s))


def test_how_long_a_turn_lasts_depends_on_the_poses_only():
    world = World(FIELD)
    durations = []
    for time_s in (1.0, 3.3, 7.77):
        world.turn_to(Pose(0), time_s=time_s)
        start = next_on_grid(time_s + 1.0)
        durations.append(world.turn_to(Pose(90), time_s=time_s + 1.0) - start)
    assert durations == pytest.approx([0.75] * 3, abs=1e-9)  # 90 degrees at 120 deg/s


def test_a_turn_takes_the_short_way_across_north_and_is_smooth():
    world = World(FIELD)
    start = world.turn_to(Pose(350), time_s=0.0)
    arrival = world.turn_to(Pose(10), time_s=start)
    times = np.linspace(start, arrival + 0.1, 2001)
    states = [world.state_at(float(time_s)) for time_s in times]
    headings = [heading_error_deg(state.pose.heading_deg, 0.0) for state in states]
    assert min(headings) >= -10.0 - 1e-9
    assert max(headings) <= 10.0 + 1e-9
    assert all(later >= earlier - 1e-9 for earlier, later in pairwise(headings))
    # No jump of rate: the quintic's largest acceleration is 5.77 angle / duration^2.
    rates = np.array([state.rate_body_dps[2] for state in states])
    bound = 5.78 * 20.0 / (arrival - start - MOVE_GRID_S) ** 2 * (times[1] - times[0])
    assert np.abs(np.diff(rates)).max() <= bound


def test_a_move_asked_for_during_another_waits_for_its_end():
    world = World(FIELD)
    first = world.turn_to(Pose(180), time_s=0.0)
    second = world.turn_to(Pose(0), time_s=0.1)
    assert second == pytest.approx(first + 1.5)
    assert world.state_at(first).pose.heading_deg == pytest.approx(180.0)


def test_at_and_after_arrival_the_pose_is_exact_and_still():
    world = World(FIELD)
    arrival = world.turn_to(Pose(210.0, 20.0, 0.0), time_s=2.0)
    for time_s in (arrival, arrival + CYCLE_S, arrival + 100.0):
        assert world.state_at(time_s).pose == Pose(210.0, 20.0, 0.0)
        assert world.state_at(time_s).rate_body_dps == (0.0, 0.0, 0.0)


@pytest.mark.parametrize("moment", [0.3, 1.1, 2.9])
def test_the_rate_is_the_derivative_of_the_attitude(moment):
    world = World(FIELD, mounting_yaw_deg=12.0)
    end = world.tumble(time_s=0.0, duration_s=4.0)
    time_s, step_s = end - moment, 1e-5
    before, after = (rotation_body_from_ned(world.state_at(time_s + sign * step_s).pose) for sign in (-1, 1))
    # d/dt R = -[w]x R for R body from earth.
    skew = -(after - before) / (2 * step_s) @ rotation_body_from_ned(world.state_at(time_s).pose).T
    rate = np.degrees([skew[2, 1], skew[0, 2], skew[1, 0]])
    # Central difference: third derivative times step^2 / 6, about (10 rad/s)^3 * 1e-10 / 6 rad/s.
    assert np.allclose(world.state_at(time_s).rate_body_dps, rate, atol=1e-4)


def coverage(directions):
    """Return the direct fit's coverage figure: largest M_ii / d_i, anchored at the mid-range."""
    x, y, z = (directions - (directions.max(axis=0) + directions.min(axis=0)) / 2).T
    rows = np.stack([x * x - z * z, y * y - z * z, x * y, x * z, y * z, x, y, z, np.ones_like(x)], axis=1)
    moments = rows.T @ rows
    return (np.diag(moments) / np.diag(np.linalg.cholesky(moments)) ** 2).max()


@pytest.mark.parametrize("late", range(8))
def test_any_hundred_points_from_the_tumbles_start_cover_the_sphere(late):
    world = World(EarthField(48.5, 62.0), mounting_yaw_deg=1.7)
    end = world.tumble(time_s=0.0, duration_s=4.0)
    times = end - 4.0 + (np.arange(100) + late) / 80.0
    field = np.array([world.state_at(float(time_s)).field_body_ut for time_s in times]) / 48.5
    # A full sphere of random points: 1.33 in the median, 1.8 at worst; 75 % of a sphere has up to 4.
    assert coverage(field) < 2.0


def test_a_tumble_stays_below_600_degrees_a_second_and_has_300_samples_at_80_hz():
    world = World(FIELD)
    end = world.tumble(time_s=0.0, duration_s=4.0)
    rates = [math.hypot(*world.state_at(end - 4.0 + k / 80.0).rate_body_dps) for k in range(320)]
    assert max(rates) < 600.0
    assert min(rates) > 300.0
    assert world.state_at(end).rate_body_dps == (0.0, 0.0, 0.0)


def test_a_tumble_starts_from_its_first_pose_wherever_the_table_was():
    begins = []
    for pose in (Pose(0), Pose(77, -20, 5)):
        world = World(FIELD, pose=pose)
        end = world.tumble(time_s=0.3, duration_s=3.99)
        assert end - world.last_move_start_s == pytest.approx(4.0)
        begins.append(world.state_at(world.last_move_start_s).pose)
        before = world.state_at(world.last_move_start_s - 1e-6).pose
        assert before.roll_deg == pytest.approx(begins[-1].roll_deg, abs=1e-3)
        again = world.turn_to(begins[-1], time_s=end)
        assert world.tumble(time_s=again, duration_s=1.0) - again == pytest.approx(1.0 + MOVE_GRID_S)
    assert begins[0] == begins[1]


def test_noise_at_a_judged_pose_is_counted_from_arrival():
    early, late = World(FIELD), World(FIELD)
    arrivals = [world.turn_to(Pose(90), time_s=time_s, known_angle=7) for world, time_s in ((early, 1.0), (late, 9.0))]
    (key, start), (other_key, other_start) = (
        world.noise_epoch(arrival + 0.3) for world, arrival in zip((early, late), arrivals, strict=True)
    )
    assert key == other_key
    assert (start, other_start) == tuple(arrivals)
    assert early.noise_epoch(arrivals[0]) == (key, arrivals[0])


def test_each_judged_pose_tumble_and_hold_has_its_own_noise_and_moves_have_the_clocks():
    world = World(FIELD)
    tumble_end = world.tumble(time_s=0.0, duration_s=4.0)
    first = world.turn_to(Pose(0), time_s=tumble_end + 1.0, known_angle=0)
    second = world.turn_to(Pose(30), time_s=first + 1.0, known_angle=1)
    held = world.hold(time_s=second + 1.0, known_angle=2)
    keys = [world.noise_epoch(time_s)[0] for time_s in (0.0, tumble_end - 1.0, first, second, held)]
    assert len(set(keys)) == 5
    assert world.noise_epoch(second - 0.01) == (0, 0.0)


def test_distortion_is_soft_iron_then_hard_iron():
    distortion = MagneticDistortion(((2.0, 0.0, 1.0), (0.0, 1.0, 0.0), (0.0, 0.5, 1.0)), (10.0, 20.0, 30.0))
    assert distortion.apply((1.0, 2.0, 3.0)) == (2.0 + 3.0 + 10.0, 2.0 + 20.0, 1.0 + 3.0 + 30.0)


def test_the_default_distortion_changes_nothing():
    assert MagneticDistortion().apply((1.0, -2.0, 3.0)) == (1.0, -2.0, 3.0)
