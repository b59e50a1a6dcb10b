"""What a study says of a printed figure follows from what was measured."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from hiltest.calibration.direct_batch import fit_quadrics
from hiltest.studies import compensation, ellipsoids
from hiltest.studies.compensation import OFFSET_PRINTED, SENSITIVITY_PRINTED, compensated
from hiltest.studies.instances import Model, draw_instances
from hiltest.studies.study import Block, Plan


@pytest.mark.parametrize(
    ("worst", "always", "nearly"), [(0, True, True), (930, False, True), (1000, False, None), (1070, False, False)]
)
def test_always_is_none_and_nearly_always_is_less_than_one_in_a_thousand(
    worst: int, always: bool, nearly: bool | None
) -> None:
    counts = [[(0,)]] * 12 + [[(worst - worst // 3,), (worst // 3,)]] + [[(0,)]] * 7
    result = ellipsoids.conclude(Plan("ellipsoids", 1, 1_000_000, 100), counts)
    assert [figure.reproduced for figure in result.printed] == [always, nearly]
    assert (
        next(measurement.value for measurement in result.measurements if measurement.name.endswith("non_ellipsoids"))
        == worst
    )
    assert result.table.column("non_ellipsoids")[12] == worst


def test_few_instances_decide_only_what_their_interval_excludes() -> None:
    always, nearly = ellipsoids.conclude(Plan("ellipsoids", 1, 8, 100), [[(0,)]] * 20).printed
    assert (always.reproduced, nearly.reproduced) == (None, None)
    assert always.because.startswith("too few instances")
    always, nearly = ellipsoids.conclude(Plan("ellipsoids", 1, 8, 100), [[(3,)]] * 20).printed
    assert (always.reproduced, nearly.reproduced) == (False, False)
    # Means of 80 % that scatter by 10 and by 40 points: half of their intervals is 9 and 36.
    for scatter, decided in ((10.0, {False}), (40.0, {None})):
        item = (8, *[8 * 80.0] * 3, *[8 * (80.0**2 + scatter**2)] * 3)
        printed = compensation.conclude(Plan("compensation", 1, 8, 100), [[item]] * 6).printed
        assert {figure.reproduced for figure in printed[:2]} == decided
        assert decided == {False} or printed[0].because.startswith("too few instances")


def test_without_noise_all_is_compensated() -> None:
    count, *sums = compensation.measure(Plan("compensation", 3, 200, 40), Block(0, 0, 200))
    assert count == 200
    # Cosines are rounded to 2**-30; what the radii of an ellipsoid differ by, here some uT at least, divides it.
    np.testing.assert_allclose(sums[:3], 100.0 * 200, rtol=1e-4)


def test_a_centre_that_is_off_by_a_tenth_of_the_offset_compensates_90_percent() -> None:
    drawn = draw_instances(Model(3, 40, 0.0), 0, 50)
    quadrics = fit_quadrics(drawn.points_ut)
    np.testing.assert_allclose(compensated(drawn, quadrics), 1.0, atol=1e-4)
    offset, _, sensitivity = compensated(drawn, replace(quadrics, centre=0.9 * drawn.hard_iron_ut))
    np.testing.assert_allclose(offset, 0.9, rtol=1e-12)
    np.testing.assert_allclose(sensitivity, 1.0, atol=1e-4)


def test_a_sphere_scales_what_is_left_of_offset_and_of_the_radii() -> None:
    drawn = draw_instances(Model(3, 40, 0.0), 0, 50)
    off = replace(fit_quadrics(drawn.points_ut), centre=0.9 * drawn.hard_iron_ut, level=np.full(50, 50.0**2))
    sphere = replace(off, shape=np.broadcast_to(np.eye(3), (50, 3, 3)))
    offset, calibrated, sensitivity = compensated(drawn, sphere)
    np.testing.assert_allclose([offset, calibrated], 0.9, rtol=1e-12)
    np.testing.assert_allclose(sensitivity, 0.0, atol=1e-12)  # a sphere of the field's radius changes nothing
    _, calibrated, sensitivity = compensated(drawn, replace(sphere, level=np.full(50, 100.0**2)))
    np.testing.assert_allclose(calibrated, 0.95, rtol=1e-12)
    np.testing.assert_allclose(sensitivity, 0.5, rtol=1e-12)


@given(
    off=st.lists(st.floats(-20.0, 20.0).filter(lambda item: abs(abs(item) - 2.0) > 1e-6), min_size=6, max_size=6),
    parts=st.integers(1, 4),
)
def test_a_figure_is_reproduced_within_two_points(off: list[float], parts: int) -> None:
    by_noise = [
        [(10, 10 * (answer + by), 0.0, 10 * other, 10 * (answer + by) ** 2, 0.0, 10 * other**2)] * parts
        for by, answer, other in zip(off, OFFSET_PRINTED, SENSITIVITY_PRINTED, strict=True)
    ]
    result = compensation.conclude(Plan("compensation", 1, 10 * parts, 100), by_noise)
    assert [figure.reproduced for figure in result.printed] == [abs(by) <= 2.0 for by in off] + [True] * 6
    measured = {measurement.name: measurement.value for measurement in result.measurements}
    assert measured["study.compensation.offset_reproduced"] == sum(abs(by) <= 2.0 for by in off)
    assert all(
        math.isclose(float(came or 0), answer)
        for came, answer in zip(result.table.column("sensitivity"), SENSITIVITY_PRINTED, strict=True)
    )
