"""The thesis' instance generator."""

from __future__ import annotations

import numpy as np
import pytest

from .instances import instance


def test_the_same_seed_gives_the_same_points() -> None:
    assert np.array_equal(instance(5).points_counts, instance(5).points_counts)
    assert not np.array_equal(instance(5).points_counts, instance(6).points_counts)


def test_points_lie_on_the_distorted_sphere() -> None:
    drawn = instance(3, 200, noise_ut=0.0)
    field = np.linalg.solve(drawn.soft_iron, (drawn.points_counts / 10.0 - drawn.hard_iron_ut).T).T
    # Rounding to 0.1 uT moves a point by at most 0.05 sqrt(3) uT, which the inverse soft iron (at most 2) magnifies.
    assert np.abs(np.linalg.norm(field, axis=1) - 50.0).max() <= 0.05 * np.sqrt(3.0) * 2.0


@pytest.mark.parametrize("part", [0.05, 0.2, 0.5])
def test_points_stay_inside_the_covered_cap(part: float) -> None:
    drawn = instance(11, 500, noise_ut=0.0, stretch=0.0, covered=(part, part))
    directions = drawn.points_counts / 10.0 - drawn.hard_iron_ut
    directions /= np.linalg.norm(directions, axis=1)[:, None]
    axis = directions.mean(axis=0) / np.linalg.norm(directions.mean(axis=0))
    # The mean of 500 points is off the axis by about 1/sqrt(500) rad; a cap of part f reaches down to cosine 1 - 2f.
    assert (directions @ axis).min() >= 1.0 - 2.0 * part - 3.0 / np.sqrt(500.0)


def test_hard_iron_and_soft_iron_stay_within_their_limits() -> None:
    drawn = [instance(seed, 9) for seed in range(300)]
    lengths = [np.linalg.norm(one.hard_iron_ut) for one in drawn]
    assert max(lengths) <= 500.0
    assert np.mean(lengths) == pytest.approx(250.0, abs=3 * 144.0 / np.sqrt(300.0))  # uniform: sigma = 500 / sqrt(12)
    eigenvalues = np.array([np.linalg.eigvalsh(one.soft_iron) for one in drawn])
    assert eigenvalues.min() >= 0.5 - 1e-12
    assert eigenvalues.max() <= 1.5 + 1e-12
