"""The condition number of a cloud: what it is for known coverage, and what it does not depend on."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from hiltest.calibration.conditioning import CONDITION_SINGULAR, TRACELESS, CentredPoints, ellipsoid_condition
from hiltest.calibration.quality import sphere_directions
from hiltest.orientation.angles import Pose, rotation_body_from_ned

from ..instances import instance


def _conditions(part: float, *, count: int = 200) -> np.ndarray:
    clouds = (instance(seed, 100, noise_ut=0.4, stretch=0.03, covered=(part, part)) for seed in range(count))
    return np.array([ellipsoid_condition(cloud.points_counts) for cloud in clouds])


def test_the_basis_is_orthonormal_and_without_trace() -> None:
    flat = TRACELESS.reshape(5, 9)
    np.testing.assert_allclose(flat @ flat.T, np.eye(5), atol=1e-15)
    np.testing.assert_allclose(np.trace(TRACELESS, axis1=1, axis2=2), 0.0, atol=1e-15)


def test_the_rows_are_those_of_the_definition() -> None:
    cloud = CentredPoints.centre(np.random.default_rng(1).normal(size=(20, 3)))
    assert cloud is not None
    x, y, z = cloud.points.T
    two, six = np.sqrt(2.0), np.sqrt(6.0)
    expected = [
        (x * x - y * y) / two,
        (x * x + y * y - 2 * z * z) / six,
        two * x * y,
        two * x * z,
        two * y * z,
        x,
        y,
        z,
    ]
    np.testing.assert_allclose(cloud.rows(), np.column_stack([*expected, np.ones(20)]), atol=1e-14)


def test_a_whole_sphere_has_the_smallest_condition() -> None:
    """The mean squares of the columns over a sphere are 2/15, 1/3 and 1, and the columns are orthogonal: 15/2."""
    # 1e-3: what a lattice of 2000 points differs from the integrals.
    assert ellipsoid_condition(sphere_directions(2000)) == pytest.approx(7.5, rel=1e-3)


@pytest.mark.parametrize(
    ("part", "median", "low", "high"),
    [
        (1.0, 11, 9, 14),
        (0.75, 26, 18, 38),
        (0.6, 58, 40, 85),
        (0.5, 105, 71, 163),
        (0.4, 215, 137, 339),
        (0.3, 500, 290, 820),
    ],
)
def test_the_condition_tells_the_coverage(part: float, median: float, low: float, high: float) -> None:
    """Between the 1st and 99th percentile that thresholds were chosen by, at the same noise and soft iron."""
    conditions = _conditions(part)
    # The median of 200 draws is good to a twelfth of the width between the percentiles, here to 5 %.
    assert np.median(conditions) == pytest.approx(median, rel=0.05)
    # 2 of 200 are expected outside on either side; more than 8 would come with a probability of 2e-4.
    assert ((conditions < low) | (conditions > high)).sum() <= 8


def test_a_tenth_of_the_sphere_is_always_beyond_refusal() -> None:
    assert _conditions(0.1).min() > 300.0


@given(
    st.integers(0, 1000),
    st.floats(-180.0, 180.0),
    st.floats(-89.0, 89.0),
    st.floats(-180.0, 180.0),
    st.floats(0.01, 100.0),
    st.floats(-1000.0, 1000.0),
)
def test_the_condition_depends_neither_on_turn_nor_unit_nor_origin(
    seed: int, yaw: float, pitch: float, roll: float, scale: float, shift: float
) -> None:
    points = instance(seed, 60, covered=(0.2, 1.0)).points_counts.astype(float)
    turned = scale * (points + shift) @ rotation_body_from_ned(Pose(yaw, pitch, roll))
    # The smallest eigenvalue is 1e-3 of the largest or less: of 16 digits rounding takes those 3, and the squares' 3.
    assert ellipsoid_condition(turned) == pytest.approx(ellipsoid_condition(points), rel=1e-8)


@pytest.mark.parametrize(
    "points",
    [np.zeros((0, 3)), np.zeros((20, 3)), sphere_directions(8), sphere_directions(50) * (1.0, 1.0, 0.0)],
    ids=["none", "all the same", "too few", "in a plane"],
)
def test_points_that_determine_nothing_are_singular(points: np.ndarray) -> None:
    assert ellipsoid_condition(points) == CONDITION_SINGULAR
