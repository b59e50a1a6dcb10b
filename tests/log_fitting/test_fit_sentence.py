"""A fit in one sentence, and the heading error in it."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from hiltest.calibration.quality import sphere_directions
from hiltest.log_fitting import FieldUnit, Samples
from hiltest.log_fitting.fit_sentence import HEADINGS_DEG, calibrated_heading_error_deg, heading_errors_deg, headline
from hiltest.log_fitting.sample_fit import fit_on_host

from ..calibration.hand_turned import hand_turned


def _samples(points: np.ndarray) -> Samples:
    return Samples(Path("folder/log.csv"), points, FieldUnit.UT, "option", ("x", "y", "z"), 0)


def test_headings_as_read_err_by_the_hard_iron_across_them() -> None:
    best = fit_on_host(_samples(48.0 * sphere_directions(400) + [0.0, 2.4, 30.0]), "direct").best
    errors = heading_errors_deg(best, 60.0)
    assert errors is not None
    # 2.4 uT across a level field of 24 uT; along it, at 90 and 270 degrees, and by vertical iron there is no error.
    across = np.degrees(np.arctan2(2.4, 24.0))
    by_heading = dict(zip(HEADINGS_DEG.tolist(), errors.tolist(), strict=True))
    assert by_heading[0.0] == pytest.approx(-across, abs=0.01)
    assert by_heading[180.0] == pytest.approx(across, abs=0.01)
    assert (by_heading[90.0], by_heading[270.0]) == (pytest.approx(0.0, abs=0.01), pytest.approx(0.0, abs=0.01))


def test_the_predicted_heading_error_is_that_of_simulated_logs() -> None:
    """The same field at a dip of 60 degrees, level, under calibrations of logs of one sensor."""
    fits = [fit_on_host(_samples(hand_turned(seed, 600)), "direct") for seed in range(24)]
    curves = [heading_errors_deg(fit.best, 60.0) for fit in fits]
    off = np.array([curve for curve in curves if curve is not None])
    off = off - off.mean(axis=0)
    predicted = np.sqrt(np.mean([(calibrated_heading_error_deg(fit) or 0.0) ** 2 for fit in fits]))
    # Headings differ as calibrations do where the readings are not near zero; 24 logs: 15 %, and predictions within 2.
    assert 0.5 < np.median(off.std(axis=0)) / predicted < 2.0


@pytest.mark.usefixtures("own_package")
@pytest.mark.parametrize("stretch", [0.03, 0.06, 0.09])
def test_the_error_of_a_calibrator_that_does_not_fit_is_its_own(stretch: float) -> None:
    """A sphere is fitted to an ellipsoid: the stated heading error is the true one, not that of the ellipsoid."""
    random = np.random.default_rng(7)
    soft_iron = np.diag([1.0 + stretch, 1.0 - stretch, 1.0]) + 0.3 * stretch * (np.ones((3, 3)) - np.eye(3))
    hard_iron = np.array([12.0, -30.0, 5.5])
    # The noise on each sample is 0.4 uT.
    readings = 48.5 * sphere_directions(1000) @ soft_iron + hard_iron + random.normal(0.0, 0.4, (1000, 3))
    fit = fit_on_host(_samples(readings), "sphere-fit")
    headings, down = np.radians(HEADINGS_DEG[1:]), np.radians(60.0)
    level = np.cos(down) * np.column_stack([np.cos(headings), -np.sin(headings)])
    field = 48.5 * np.column_stack([level, np.full(len(headings), np.sin(down))]) @ soft_iron
    x, y, _ = ((field + hard_iron - np.array(fit.best.hard_iron)) @ np.array(fit.best.soft_iron).T).T
    off_deg = (np.degrees(np.arctan2(-y, x)) - HEADINGS_DEG[1:] + 180.0) % 360.0 - 180.0
    true_deg = float(np.sqrt((off_deg**2).mean()))
    # The ellipsoid errs by 0.1 deg of heading itself, which is a tenth of the smallest of these errors.
    assert calibrated_heading_error_deg(fit) == pytest.approx(true_deg, rel=0.1)
    assert fit.best.error_is_measured
    assert "(measured against the ellipsoid of the same samples, plus any rotation)" in headline(fit)
    ellipsoid = fit_on_host(_samples(readings), "direct")
    assert not ellipsoid.best.error_is_measured
    assert "(predicted, plus any rotation)" in headline(ellipsoid)
    assert true_deg > 5.0 * (calibrated_heading_error_deg(ellipsoid) or 0.0)


def test_the_sentence_has_verdict_iron_and_both_errors() -> None:
    fit = fit_on_host(_samples(hand_turned(1, 1200)), "direct")
    sentence = headline(fit)
    assert sentence.startswith(f"log.csv: {fit.best.verdict}, with 23")
    assert sentence.count("deg") == 3
    refused = headline(replace(fit, calibrators=fit_on_host(_samples(np.zeros((5, 3))), "direct").calibrators))
    assert refused.startswith("log.csv: refused, use no calibration from this log: ")
