"""Heading errors that noise makes unavoidable: no efficient fit is better, and what is smaller is impossible."""

from __future__ import annotations

import numpy as np
import pytest

from hiltest.calibration.direct import fit_direct
from hiltest.calibration.fit import FitStatus, MagnetometerFit
from hiltest.calibration.heading_bound import LEAST_CHANCE, HeadingBound, heading_bound
from hiltest.calibration.iterative import fit_iterative
from hiltest.calibration.quality import sphere_directions
from hiltest.orientation import tilt_heading
from hiltest.orientation.angles import Pose, heading_error_deg, rotation_body_from_ned

FIELD = np.array([228.0, 0.0, 428.0])
SOFT_IRON = np.array([[1.02, 0.01, -0.006], [0.01, 0.98, 0.009], [-0.006, 0.009, 1.0]])
HARD_IRON, NOISE, READINGS = np.array([24.0, -22.0, 40.0]), 4.0, 16
POSES = [Pose(30.0 * step, pitch, roll) for pitch, roll in ((0, 0), (20, 0), (0, -20)) for step in range(12)]
FIELDS = np.array([rotation_body_from_ned(pose) @ FIELD for pose in POSES])
GRAVITY = np.array([rotation_body_from_ned(pose) @ np.array([0.0, 0.0, 1.0]) for pose in POSES])
TRUE_FIT = MagnetometerFit(FitStatus.ELLIPSOID, False, 0, np.linalg.inv(SOFT_IRON) / np.linalg.norm(FIELD), HARD_IRON)
DIRECTIONS = sphere_directions(100)


def bound_of(points: np.ndarray | None) -> HeadingBound:
    return heading_bound(
        TRUE_FIT, points, field=FIELDS, gravity=GRAVITY, noise=NOISE, readings=np.full(len(POSES), READINGS)
    )


@pytest.fixture(scope="module")
def points() -> np.ndarray:
    return np.linalg.norm(FIELD) * DIRECTIONS @ SOFT_IRON.T + HARD_IRON


def errors_deg(fit: MagnetometerFit, draws: np.random.Generator) -> np.ndarray:
    """Return the errors of one run: each pose has the mean of its own noisy readings."""
    noise = draws.standard_normal(FIELDS.shape) * NOISE / np.sqrt(READINGS)
    read = FIELDS @ SOFT_IRON.T + HARD_IRON + noise
    return np.array(
        [
            heading_error_deg(tilt_heading(down, fit.soft_iron @ (row - fit.hard_iron)).heading_deg, pose.heading_deg)
            for down, row, pose in zip(GRAVITY, read, POSES, strict=True)
        ]
    )


@pytest.mark.parametrize("calibrator", [fit_direct, fit_iterative])
def test_calibrators_reach_the_bound_and_do_not_beat_it(points: np.ndarray, calibrator) -> None:
    bound, draws = bound_of(points), np.random.default_rng(3)
    errors = np.array(
        [errors_deg(calibrator(points + NOISE * draws.standard_normal(points.shape)), draws) for _ in range(300)]
    )
    rms = np.sqrt(np.mean(errors**2))
    # 300 runs determine the rms to 3 %; both calibrators have a bias of a few hundredths of a degree besides.
    assert 0.95 * bound.rms_deg < rms < 1.15 * bound.rms_deg
    largest = np.abs(errors).max(axis=1)
    assert np.median(largest) == pytest.approx(bound.expected_largest_deg, rel=0.1)
    assert np.mean(largest <= bound.expected_largest_deg) == pytest.approx(0.5, abs=0.12)


@pytest.mark.parametrize("share", [0.3, 0.1, 0.01])
def test_the_chance_of_a_small_largest_error_is_its_share_of_runs(points: np.ndarray, share: float) -> None:
    bound = bound_of(points)
    draws = np.random.default_rng(9)
    errors = draws.standard_normal((40_000, bound.fit_deg.shape[1])) @ bound.fit_deg.T
    errors += draws.standard_normal(errors.shape) * bound.readings_deg
    quantile = np.quantile(np.abs(errors).max(axis=1), share)
    # The binomial error of the share, and a few per cent of the importance sampling.
    assert bound.chance(quantile) == pytest.approx(share, rel=0.05 + 4.0 / np.sqrt(40_000 * share))


def test_the_chance_grows_with_the_error_down_to_the_smallest_numbers(points: np.ndarray) -> None:
    bound = bound_of(points)
    chances = [bound.chance(largest) for largest in (0.0, 1e-12, 1e-3, 0.1, 0.3, 1.0, 10.0)]
    assert chances == sorted(chances)
    assert chances[0] == 0.0
    assert chances[-1] == pytest.approx(1.0, rel=0.01)  # of the importance sampling
    assert bound.chance(0.99 * bound.least_deg) < LEAST_CHANCE <= bound.chance(bound.least_deg)


def test_readings_alone_are_a_product_of_independent_poses() -> None:
    bound = bound_of(None)
    assert bound.fit_rms_deg == 0.0
    assert bound.rms_deg == bound.readings_rms_deg
    draws = np.abs(np.random.default_rng(2).standard_normal((100_000, len(POSES))) * bound.readings_deg).max(axis=1)
    for share in (0.02, 0.5):
        assert bound.chance(np.quantile(draws, share)) == pytest.approx(share, rel=0.1)


def test_more_points_or_readings_lower_the_bound(points: np.ndarray) -> None:
    twice = np.vstack([points, points])
    assert bound_of(twice).fit_rms_deg == pytest.approx(bound_of(points).fit_rms_deg / np.sqrt(2.0))
    assert bound_of(twice).readings_rms_deg == bound_of(points).readings_rms_deg
    assert bound_of(points[:8]).fit_rms_deg > 1000.0  # nine parameters
