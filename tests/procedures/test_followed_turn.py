"""The turn of a board by its gyroscope: through any tilt, without its bias, and unknown after a gap."""

from __future__ import annotations

import numpy as np
import pytest

from hiltest.orientation.angles import Pose, rotation_body_from_ned
from hiltest.procedures.followed_turn import FollowedTurn

RATE_HZ = 200.0
BIAS_DPS = np.array([1.2, -0.7, 2.3])
REST_S, TURN_S = 0.3, 4.0


def samples(pose: Pose, rate_dps: float, begin_s: float, duration_s: float) -> tuple[np.ndarray, np.ndarray]:
    """Return times and rates of a board that turns about the vertical at a constant rate."""
    times_s = begin_s + np.arange(round(duration_s * RATE_HZ)) / RATE_HZ
    # A turn about the vertical changes the heading alone, so that the vertical stays where it is in the body.
    down = rotation_body_from_ned(pose)[:, 2]
    noise = np.random.default_rng(1).normal(0.0, 0.25, (len(times_s), 3))
    return times_s, rate_dps * down + BIAS_DPS + noise


def followed(pose: Pose, rate_dps: float, *, gap_s: float = 0.0) -> FollowedTurn:
    turn = FollowedTurn()
    turn.stand(*samples(pose, 0.0, 0.0, REST_S))
    turn.begin()
    times_s, rates = samples(pose, rate_dps, REST_S, TURN_S)
    is_read = (times_s < 1.0) | (times_s >= 1.0 + gap_s)
    for part in np.array_split(np.flatnonzero(is_read), 20):
        turn.add(times_s[part], rates[part])
    return turn


@pytest.mark.parametrize("pose", [Pose(0.0), Pose(350.0, 25.0, -30.0), Pose(90.0, -60.0, 170.0)])
@pytest.mark.parametrize("rate_dps", [14.5, -40.0, 60.0])
def test_a_turn_about_the_vertical_is_known_in_any_tilt(pose: Pose, rate_dps: float) -> None:
    turned_deg = followed(pose, rate_dps).turned_deg(pose)
    assert turned_deg is not None
    # The bias is the mean of 60 samples: 0.03 deg/s, over 4 s.
    assert np.remainder(turned_deg - rate_dps * TURN_S + 180.0, 360.0) - 180.0 == pytest.approx(0.0, abs=0.6)


def test_a_short_gap_is_bridged_and_a_long_one_makes_the_turn_unknown() -> None:
    pose = Pose(0.0)
    assert followed(pose, 14.5, gap_s=0.3).turned_deg(pose) == pytest.approx(58.0, abs=0.6)
    assert followed(pose, 14.5, gap_s=0.5).turned_deg(pose) is None
    assert FollowedTurn().turned_deg(pose) is None


def test_the_scale_is_contradicted_beyond_the_error_of_an_uncalibrated_gyroscope() -> None:
    pose = Pose(0.0)
    turn = followed(pose, 14.5)
    assert turn.contradicts(pose, 30.0)
    assert turn.contradicts(pose, -58.0)
    # 10 % of 58 degrees and 10 degrees that no check is made of.
    assert not turn.contradicts(pose, 58.0 + 14.0)
    assert turn.contradicts(pose, 58.0 + 18.0)
    # In 0.3 s without samples, as of a slow computer, a hand may turn by 6 degrees more than the rate before and after.
    slow = followed(pose, 14.5, gap_s=0.3)
    assert not slow.contradicts(pose, 58.0 + 17.5)
    assert slow.contradicts(pose, 58.0 + 20.0)
    turn.begin()
    assert not turn.contradicts(pose, 0.0)
    assert not followed(pose, 14.5, gap_s=0.5).contradicts(pose, 0.0)
