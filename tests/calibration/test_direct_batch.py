"""Many instances at once are fitted as each is alone."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from hiltest.calibration import FitStatus, fit_direct
from hiltest.calibration.direct import design
from hiltest.calibration.direct_batch import fit_quadrics

from ..instances import instance

# Of the agreement: rounding of two ways to solve one system, over its condition number.
ROUNDING = 1e-12


def points_of(seed: int, count: int, n: int, **arguments: object) -> np.ndarray:
    return np.array([instance(seed + k, n, **arguments).points_counts for k in range(count)], dtype=float)  # type: ignore[arg-type]


def condition(points: np.ndarray) -> float:
    """Condition number of the normal equations of one instance, in its own range."""
    middle, half = (points.max(axis=0) + points.min(axis=0)) / 2, np.ptp(points, axis=0).max() / 2
    return float(np.linalg.cond(design((points - middle) / half)[0])) ** 2


@settings(max_examples=25, deadline=None)
@given(seed=st.integers(0, 1 << 30), n=st.integers(12, 200), noise_ut=st.sampled_from([0.0, 0.3, 5.0, 25.0]))
def test_each_is_the_single_fit(seed: int, n: int, noise_ut: float) -> None:
    points = points_of(seed, 8, n, noise_ut=noise_ut)
    quadrics = fit_quadrics(points.reshape(2, 4, n, 3))
    for k, single in enumerate(map(fit_direct, points)):
        place = divmod(k, 4)
        if single.status is not FitStatus.ELLIPSOID:
            continue
        assert quadrics.is_ellipsoid[place]
        within = ROUNDING * condition(points[k])
        squared = single.soft_iron @ single.soft_iron
        shape = quadrics.shape[place] / quadrics.level[place]
        # Squaring doubles a relative difference.
        np.testing.assert_allclose(shape, squared, rtol=0, atol=2.0 * within * np.abs(squared).max())
        # A centre may lie far outside of the points, where few of much noise are nearly a paraboloid.
        half = max(np.ptp(points[k], axis=0).max() / 2, np.abs(single.hard_iron - points[k].mean(axis=0)).max())
        np.testing.assert_allclose(quadrics.centre[place], single.hard_iron, rtol=0, atol=within * half)


def test_no_instance_is_no_quadric() -> None:
    assert fit_quadrics(np.zeros((0, 20, 3))).level.shape == (0,)


def test_a_plane_a_line_and_a_heap_among_good_ones_spoil_none_of_them() -> None:
    points = points_of(1, 5, 60, noise_ut=0.3)
    alone = fit_quadrics(points[[0, 4]])
    points[1, :, 2] = 7.0
    points[2, :, 1:] = 7.0
    points[3] = 7.0
    quadrics = fit_quadrics(points)
    assert not quadrics.is_ellipsoid[[2, 3]].any()
    assert np.array_equal(quadrics.shape[[0, 4]], alone.shape)


def test_what_is_no_array_of_points_is_refused() -> None:
    with pytest.raises(ValueError, match="not \\(\\.\\.\\., n, 3\\)"):
        fit_quadrics(np.zeros((3, 20, 2)))
    with pytest.raises(ValueError, match="finite"):
        fit_quadrics(np.full((1, 20, 3), np.nan))


def test_noiseless_points_give_their_own_ellipsoid() -> None:
    random = np.random.default_rng(3)
    directions = random.standard_normal((40, 3))
    directions /= np.linalg.norm(directions, axis=1)[:, None]
    iron = np.array([[1.2, 0.1, 0.0], [0.1, 0.9, -0.2], [0.0, -0.2, 1.1]])
    quadrics = fit_quadrics(500.0 * directions @ iron + [300.0, -200.0, 100.0])
    true = np.linalg.inv(iron @ iron)
    # 1e-12 over the condition number of M, some 50 here
    np.testing.assert_allclose(quadrics.shape, true / np.trace(true), rtol=0, atol=1e-10)
    np.testing.assert_allclose(quadrics.centre, [300.0, -200.0, 100.0], rtol=1e-10)
    np.testing.assert_allclose(quadrics.level, 500.0**2 / np.trace(true), rtol=1e-10)
    assert quadrics.is_ellipsoid
