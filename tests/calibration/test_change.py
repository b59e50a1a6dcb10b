"""A step of the hard iron is found and located; clean logs raise no alarm."""

from __future__ import annotations

import numpy as np
import pytest

from hiltest.calibration.change import find_change
from hiltest.calibration.quality import sphere_directions

from ..instances import instance
from .hand_turned import hand_turned

_FIELD_UT, _COUNT = 47.4, 1200


@pytest.mark.slow  # forty logs
@pytest.mark.parametrize(("percent", "least"), [(6.0, 19), (4.0, 15), (30.0, 19)])
def test_steps_are_found_where_they_are(percent: float, least: int) -> None:
    """At 30, 50 and 70 % of a log of a minute, with 0.3 uT of white noise and 0.3 uT that lasts for a second."""
    result = 0
    for seed in range(20):
        points, row = hand_turned(seed, _COUNT), _COUNT * (3, 5, 7)[seed % 3] // 10
        step = percent / 100.0 * _FIELD_UT * sphere_directions(20)[seed]
        points[row:] += step
        change = find_change(points)
        # Two blocks of 80, and half of the step: what is located elsewhere is not found.
        if change is not None and abs(change.row - row) <= _COUNT // 40:
            result += bool(np.linalg.norm(change.step - step) < 0.5 * np.linalg.norm(step))
    assert result >= least


@pytest.mark.slow
def test_clean_logs_raise_no_alarm() -> None:
    # One of twenty may; without the two thresholds, on a step's length and on what it explains, all would.
    assert sum(find_change(hand_turned(100 + seed, _COUNT)) is not None for seed in range(20)) <= 1


@pytest.mark.parametrize("covered", [0.2, 0.5, 1.0])
def test_points_in_no_order_show_no_step(covered: float) -> None:
    assert find_change(instance(1, 500, noise_ut=0.5, covered=(covered, covered)).points_counts) is None


def test_wild_rows_neither_hide_a_step_nor_make_one() -> None:
    points = hand_turned(5, _COUNT)
    points[[100, 700]] = (900.0, 0.0, 0.0), (0.0, -5000.0, 3.0)
    assert find_change(points) is None
    points[600:] += (0.0, 4.0, 0.0)
    change = find_change(points)
    assert change is not None
    assert change.row == pytest.approx(600, abs=_COUNT // 40)


@pytest.mark.parametrize(
    "points", [np.zeros((0, 3)), np.zeros((500, 3)), hand_turned(1, 100)], ids=["none", "one place", "few"]
)
def test_what_is_no_log_shows_no_step(points: np.ndarray) -> None:
    assert find_change(points) is None
