"""The study of estimators: what it says of a calibrator is what the calibrator makes of the instances."""

from __future__ import annotations

import numpy as np
import pytest

from hiltest.calibration.fit import FitStatus, MagnetometerFit
from hiltest.calibration.quality import COUNTS_PER_UT, direction_difference_rms_deg
from hiltest.studies.estimators import CONDITIONS, JUDGED, NAMES, Condition, conclude, estimate, measure
from hiltest.studies.instances import Model, counted_fit, draw_instances
from hiltest.studies.study import Block, Conclusion, Plan

FEW = CONDITIONS.index(Condition(1.0))


def test_an_error_is_the_angle_between_calibration_and_truth() -> None:
    result = np.reshape(measure(Plan("estimators", 3, 2, 0), Block(FEW, 5, 2)), (2, len(NAMES), 2))
    drawn = draw_instances(Model(3, 100, 1.0, stream=FEW), 5, 2)
    for k in range(2):
        gain = np.linalg.inv(drawn.soft_iron[k]) / (50.0 * COUNTS_PER_UT)
        truth = MagnetometerFit(FitStatus.ELLIPSOID, False, 0, gain, COUNTS_PER_UT * drawn.hard_iron_ut[k])
        for index, name in enumerate(NAMES[2:], start=2):
            points = COUNTS_PER_UT * drawn.points_ut[k]
            fit = estimate(name, points)
            # Both are means over directions that are spread evenly, 200 and 500 of them.
            expected = pytest.approx(direction_difference_rms_deg(counted_fit(fit, points), truth), rel=0.05)
            assert result[k, index].tolist() == [expected, fit.status is FitStatus.ELLIPSOID], name


def concluded(**errors_deg: float) -> Conclusion:
    """Conclude from forty instances of each condition, spread evenly about these errors, or about 3 degrees."""
    spread = np.linspace(0.9, 1.1, 40)
    item = np.ones((40, len(NAMES), 2))
    for index, name in enumerate(NAMES):
        item[:, index, 0] = errors_deg.get(name, 3.0) * spread
    halves = [half.ravel().tolist() for half in (item[:20], item[20:])]
    return conclude(Plan("estimators", 1, 40, 0), [halves] * len(CONDITIONS))


def test_the_calibrator_that_errs_least_is_named_with_its_median() -> None:
    sentence = concluded(taubin=0.5, geometric=0.7).sentence
    # The 20th of 40, and the 14th and 27th around it.
    assert "taubin has the smallest error, 0.50 (0.48 to 0.52) deg in the median of 40 instances" in sentence
    assert "direct has 2.99 (2.90 to 3.10)" in sentence


def test_each_calibrator_has_a_row_of_each_condition_with_intervals() -> None:
    table = concluded(direct=1.0).table
    assert len(table.rows) == len(NAMES) * len(CONDITIONS)
    row = table.rows[NAMES.index("direct") + len(NAMES) * JUDGED]
    assert row[:5] == ("direct", 2.5, 1000, 50.0, 0.5)
    median, low, high, p95, p95_low, p95_high, share = row[5:]
    assert median == pytest.approx(0.9 + 0.2 * 19 / 39)
    assert p95 == pytest.approx(0.9 + 0.2 * 37 / 39)
    assert share == 100.0
    # By the binomial distribution the 14th and the 27th of 40 enclose the median, and no 40 end the interval of p95.
    assert low == pytest.approx(0.9 + 0.2 * 13 / 39)
    assert high == pytest.approx(0.9 + 0.2 * 26 / 39)
    assert p95_low == pytest.approx(0.9 + 0.2 * 34 / 39)
    assert p95_high is None


def test_measurements_are_those_of_the_condition_that_is_judged() -> None:
    measurements = {measurement.name: measurement for measurement in concluded(li=2.0).measurements}
    assert measurements["study.estimators.li.median"].value == pytest.approx(2.0 * (0.9 + 0.2 * 19 / 39))
    assert measurements["study.estimators.li.median"].note == "95 % confidence interval 1.93 to 2.07"
    assert measurements["study.estimators.li.p95"].value == pytest.approx(2.0 * (0.9 + 0.2 * 37 / 39))
    assert "study.estimators.sphere.median" not in measurements


@pytest.mark.parametrize(
    ("errors_deg", "reproduced"),
    [({"geometric": 0.4}, [False, True]), ({"direct": 1.0}, [True, False]), ({"li": 2.0}, [False, False])],
)
def test_what_the_thesis_claims_is_judged_by_the_medians(errors_deg: dict[str, float], reproduced: list[bool]) -> None:
    assert [item.reproduced for item in concluded(**errors_deg).printed] == reproduced
