"""Coverage is the part of the sphere that is seen: a cap left out is a cap missing, wherever the sphere lies."""

from __future__ import annotations

import numpy as np
import pytest
from numpy.typing import NDArray

from hiltest.calibration.quality import sphere_directions
from hiltest.procedures.coverage import largest_uncovered_cap, sphere_coverage

from ..instances import instance

FIELD_UT = 48.5
HARD_IRON_COUNTS = np.array([700.0, -300.0, 120.0])


def counts(directions: NDArray[np.float64]) -> NDArray[np.float64]:
    return np.rint(10.0 * FIELD_UT * directions + HARD_IRON_COUNTS)


@pytest.mark.parametrize("radius_deg", [30.0, 60.0, 90.0, 120.0])
def test_a_cap_left_out_is_the_largest_hole(radius_deg: float) -> None:
    even = sphere_directions(3000)
    remainder = even[even @ np.array([0.6, 0.0, 0.8]) < np.cos(np.radians(radius_deg))]
    # 3000 even points are 4 degrees apart, so one lies within 2.3 of the rim; the search's own grain is 2.
    assert largest_uncovered_cap(counts(remainder), field_ut=FIELD_UT)[0] == pytest.approx(radius_deg, abs=2.5)
    part = (1.0 + np.cos(np.radians(radius_deg))) / 2.0
    # The area's slope is sin/2 a radian at most: half of 2.5 degrees in radians.
    assert sphere_coverage(counts(remainder), field_ut=FIELD_UT) == pytest.approx(part, abs=0.022)


@pytest.mark.parametrize("part", [0.1, 0.2, 0.3, 0.5, 0.75])
def test_the_covered_part_of_the_thesis_generator_comes_out(part: float) -> None:
    sphere_coverages = [
        sphere_coverage(instance(seed, covered=(part, part), stretch=0.03).points_counts, field_ut=50.0)
        for seed in range(20)
    ]
    # 100 points leave holes of their own up to the rim: seeds 0..59 gave 0.06 at most.
    assert np.abs(np.array(sphere_coverages) - part).max() < 0.07


def test_one_turn_about_one_axis_leaves_a_hole_on_either_side() -> None:
    angle = np.linspace(0.0, 2.0 * np.pi, 100, endpoint=False)
    ring = np.column_stack([np.cos(angle), np.sin(angle), 0.1 * np.cos(2.0 * angle)])
    ring /= np.linalg.norm(ring, axis=1, keepdims=True)
    # The hole reaches from a pole to the ring, 0.1 radians less at the nearest: 84.3 degrees.
    assert largest_uncovered_cap(counts(ring), field_ut=FIELD_UT)[0] == pytest.approx(84.3, abs=2.5)


def test_a_board_that_lies_still_has_seen_nothing() -> None:
    noise = np.random.default_rng(3).normal(scale=4.0, size=(300, 3))
    still = np.rint(counts(np.array([[0.0, 0.6, 0.8]])) + noise)
    assert sphere_coverage(still, field_ut=FIELD_UT) == 0.0


@pytest.mark.parametrize("points", [np.zeros((0, 3)), np.zeros((5, 3)), np.eye(3)])
def test_too_few_points_have_seen_nothing(points: NDArray[np.float64]) -> None:
    assert sphere_coverage(points, field_ut=FIELD_UT) == 0.0
    assert largest_uncovered_cap(points, field_ut=FIELD_UT)[0] == 180.0
