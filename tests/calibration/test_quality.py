"""Figures of merit of a calibration, against values derived by hand."""

from __future__ import annotations

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from hiltest.calibration import FitStatus, MagnetometerFit, fit_direct
from hiltest.calibration.quality import (
    direction_difference_rms_deg,
    direction_error_rms_deg,
    offset_error_ut,
    residual_percent,
    rotation_left_deg,
    sphere_directions,
)
from hiltest.orientation.angles import Pose, rotation_body_from_ned

from ..instances import instance


def _fit(soft_iron: np.ndarray, hard_iron: tuple[float, float, float] = (0.0, 0.0, 0.0)) -> MagnetometerFit:
    return MagnetometerFit(FitStatus.ELLIPSOID, False, 0, soft_iron, np.array(hard_iron))


def test_residual_is_the_rms_of_norms_about_one() -> None:
    """Norms 1.03 and 0.96: sqrt((0.03^2 + 0.04^2) / 2) = 3.5355 %."""
    fit = _fit(np.eye(3) / 100.0, (10.0, 0.0, 0.0))
    assert residual_percent([(113.0, 0.0, 0.0), (10.0, 96.0, 0.0)], fit) == pytest.approx(100 * 0.05 / math.sqrt(2))


@given(st.floats(0.0, 179.0), st.floats(0.1, 2.0), st.floats(0.5, 1.5))
def test_rotation_left_is_the_angle_of_the_rotation(angle_deg: float, scale: float, stretch: float) -> None:
    turn = rotation_body_from_ned(Pose(angle_deg))
    soft_iron = scale * np.diag([stretch, 1.0, 1.2])
    # 1e-6 degrees: a double-precision polar factor is good to some 1e-15, and a half turn loses half the digits.
    assert rotation_left_deg(_fit(np.eye(3)), turn @ soft_iron) == pytest.approx(angle_deg, abs=1e-6)


def test_a_rotated_distortion_leaves_its_rotation_whatever_the_residual() -> None:
    """Soft iron turned by 3 degrees about a horizontal axis: a perfect ellipsoid, and 3 degrees left."""
    symmetric = np.array([[1.03, 0.01, 0.0], [0.01, 0.98, 0.005], [0.0, 0.005, 1.0]])
    distortion = rotation_body_from_ned(Pose(0.0, 0.0, 3.0)) @ symmetric
    points = 500.0 * sphere_directions(200) @ distortion.T
    fit = fit_direct(points)
    assert residual_percent(points, fit) < 1e-9
    # The polar rotation of C E differs from 3 degrees by the stretch (3 %) times the angle.
    assert rotation_left_deg(fit, distortion) == pytest.approx(3.0, abs=0.09)


def test_a_symmetric_distortion_leaves_no_rotation() -> None:
    symmetric = np.array([[1.2, 0.1, 0.0], [0.1, 0.9, 0.05], [0.0, 0.05, 1.0]])
    fit = fit_direct(500.0 * sphere_directions(200) @ symmetric)
    assert rotation_left_deg(fit, symmetric) < 1e-9


def test_offset_error_is_a_distance_in_microtesla() -> None:
    """(30, 40, 0) counts are (3, 4, 0) uT, 5 uT from the origin."""
    assert offset_error_ut(_fit(np.eye(3), (30.0, 40.0, 0.0)), (0.0, 0.0, 0.0)) == pytest.approx(5.0)


def test_direction_difference_of_a_turned_calibration_is_that_of_its_turn() -> None:
    """A small turn by a moves a direction at angle t from its axis by a sin(t): rms a sqrt(2/3)."""
    turn = rotation_body_from_ned(Pose(0.1))
    difference = direction_difference_rms_deg(_fit(turn / 500.0), _fit(np.eye(3) / 500.0))
    assert difference == pytest.approx(0.1 * math.sqrt(2.0 / 3.0), rel=1e-4)  # 500 directions stand for the sphere


def test_direction_error_does_not_depend_on_scale() -> None:
    directions = sphere_directions(100)
    assert direction_error_rms_deg(_fit(np.eye(3) * 7.0), directions, directions) < 1e-9


def test_noise_alone_costs_direct_what_the_literature_run_says() -> None:
    """Half to full coverage, 0.3 uT, N = 100: median 0.184 degrees; +-15 % is what 200 instances tell of it."""
    errors = []
    for seed in range(200):
        drawn = instance(seed, largest_hard_iron_ut=100.0)
        truth = _fit(np.linalg.inv(drawn.soft_iron) / 500.0, tuple(10.0 * drawn.hard_iron_ut))
        fit = fit_direct(drawn.points_counts)
        if fit.status is FitStatus.ELLIPSOID:
            errors.append(direction_difference_rms_deg(fit, truth))
    assert np.median(errors) == pytest.approx(0.184, rel=0.15)
