"""A failed heading gets the name of its cause."""

from __future__ import annotations

import math

import numpy as np
import pytest

from hiltest.calibration.fit import FitStatus
from hiltest.procedures import predicted_residual_percent
from hiltest.verdict.causes import Cause, HeadingSymptoms, name_cause

GOOD = {
    "max_deg": 1.0,
    "max_limit_deg": 1.8,
    "bias_deg": 0.1,
    "bias_limit_deg": 1.0,
    "max_centred_deg": 0.95,
    "residual_percent": 0.8,
    "residual_predicted_percent": 0.8,
    "accelerometer_norm_rms_mg": 2.0,
    "accelerometer_limit_mg": 5.0,
}


def cause(**changes: float | None) -> Cause:
    return name_cause(HeadingSymptoms(**(GOOD | changes)))  # type: ignore[arg-type]


def test_a_heading_within_its_limits_has_no_cause() -> None:
    assert cause() is Cause.NONE
    assert cause(accelerometer_norm_rms_mg=50.0, residual_percent=9.0) is Cause.NONE


def test_a_wrong_accelerometer_comes_first() -> None:
    worst = {"max_deg": 9.0, "max_centred_deg": 5.0, "bias_deg": 4.0, "residual_percent": 7.0}
    assert cause(accelerometer_norm_rms_mg=20.0, **worst) is Cause.ACCELEROMETER


def test_an_accelerometer_that_tilts_the_horizon_is_named_though_its_norm_is_good() -> None:
    # 20 mg at a right angle to gravity: 0.2 mg of norm, 1.15 degrees of tilt, 2.2 of heading at 62 degrees of dip.
    tilted = {"max_deg": 2.66, "max_centred_deg": 2.6, "tilt_error_deg": 1.15}
    assert cause(tilt_limit_deg=0.5, **tilted) is Cause.ACCELEROMETER
    assert cause(tilt_limit_deg=1.2, **tilted) is Cause.GOOD_FIT_BAD_HEADING
    assert cause(tilt_limit_deg=None, **tilted) is Cause.GOOD_FIT_BAD_HEADING


def test_a_sphere_is_no_good_fit_however_small_its_residual() -> None:
    bad = {"max_deg": 6.5, "max_centred_deg": 6.4}
    assert cause(fit=FitStatus.POOR_COVERAGE, **bad) is Cause.POOR_COVERAGE  # type: ignore[arg-type]
    assert cause(fit=FitStatus.NOT_AN_ELLIPSOID, **bad) is Cause.BAD_FIT  # type: ignore[arg-type]
    assert cause(fit=FitStatus.POOR_COVERAGE) is Cause.NONE  # type: ignore[arg-type]


def test_points_on_less_than_half_the_sphere_are_poor_coverage_though_no_calibrator_says_so() -> None:
    bad = {"max_deg": 6.5, "max_centred_deg": 6.4}
    assert cause(coverage_percent=49.9, **bad) is Cause.POOR_COVERAGE
    assert cause(coverage_percent=50.0, **bad) is Cause.GOOD_FIT_BAD_HEADING


def test_the_same_error_everywhere_is_a_constant_offset() -> None:
    assert cause(max_deg=4.0, bias_deg=-3.0, max_centred_deg=1.0) is Cause.CONSTANT_OFFSET
    # A bad residual does not change it: what is left without the offset is within the limit.
    assert cause(max_deg=4.0, bias_deg=3.0, max_centred_deg=1.0, residual_percent=9.0) is Cause.CONSTANT_OFFSET


def test_a_bias_over_its_limit_is_named_even_when_the_maximum_is_not() -> None:
    assert cause(max_deg=1.7, bias_deg=1.2, max_centred_deg=0.9) is Cause.CONSTANT_OFFSET


def test_a_good_fit_with_a_bad_heading_is_called_that() -> None:
    assert cause(max_deg=6.5, max_centred_deg=6.4, residual_percent=1.1) is Cause.GOOD_FIT_BAD_HEADING


def test_a_good_fit_ends_at_one_and_a_half_times_the_predicted_residual() -> None:
    bad = {"max_deg": 6.5, "max_centred_deg": 6.4, "residual_predicted_percent": 0.5}
    assert cause(residual_percent=0.75, **bad) is Cause.GOOD_FIT_BAD_HEADING
    assert cause(residual_percent=0.7501, **bad) is Cause.BAD_FIT


def test_a_bad_fit_is_what_remains() -> None:
    assert cause(max_deg=6.5, max_centred_deg=6.4, residual_percent=4.0) is Cause.BAD_FIT


def test_errors_all_round_have_no_bias_to_blame() -> None:
    assert cause(max_deg=180.0, bias_deg=None, max_centred_deg=None) is Cause.GOOD_FIT_BAD_HEADING


def test_a_limit_that_the_rig_does_not_give_is_not_exceeded() -> None:
    assert cause(max_deg=99.0, bias_deg=99.0, max_limit_deg=None, bias_limit_deg=None) is Cause.NONE
    over = {"max_deg": 6.5, "max_centred_deg": 6.4, "accelerometer_norm_rms_mg": 50.0}
    assert cause(accelerometer_limit_mg=None, **over) is Cause.GOOD_FIT_BAD_HEADING


def test_predicted_residual_by_hand() -> None:
    # sqrt(0.4^2 + 0.1^2/12) / 48.5 * sqrt(91/100)
    expected = 100.0 * math.sqrt(0.16 + 0.01 / 12.0) / 48.5 * math.sqrt(0.91)
    assert predicted_residual_percent(0.4, 48.5, 100) == pytest.approx(expected)
    assert expected == pytest.approx(0.789, abs=5e-4)


def test_predicted_residual_is_what_a_linear_fit_of_noise_leaves() -> None:
    # Near a sphere the ellipsoid fit is linear in 9 parameters: fit rounded radial noise by the quadric's
    # nine terms and compare. 400 fits of 60 points: the mean square scatters by sqrt(2/(51*400)) = 1 %.
    generator = np.random.default_rng(3)
    squares = []
    for _ in range(400):
        u = generator.normal(size=(60, 3))
        u /= np.linalg.norm(u, axis=1, keepdims=True)
        x, y, z = u.T
        terms = np.stack([x * x, y * y, z * z, x * y, x * z, y * z, x, y, z], axis=1)
        noise = (generator.normal(size=60) * 0.4 + (generator.random(60) - 0.5) * 0.1) / 48.5
        remainder = noise - terms @ np.linalg.lstsq(terms, noise, rcond=None)[0]
        squares.append(np.mean(remainder**2))
    predicted = predicted_residual_percent(0.4, 48.5, 60)
    assert 100.0 * math.sqrt(np.mean(squares)) == pytest.approx(predicted, rel=0.02)  # 4 sigma of the rms


def test_too_few_points_have_no_residual() -> None:
    with pytest.raises(ValueError, match="9 points for 9 parameters"):
        predicted_residual_percent(0.4, 48.5, 9)
