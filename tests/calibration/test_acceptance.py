"""Thresholds, and what is said when one is passed."""

from __future__ import annotations

from dataclasses import replace

import pytest

from hiltest.calibration import FitStatus
from hiltest.calibration.acceptance import Acceptance, FitFigures, rate

_GOOD = FitFigures(
    FitStatus.ELLIPSOID,
    condition=11.0,
    n=300,
    residual_percent=0.8,
    axis_ratio=1.1,
    radius_ut=48.0,
    direction_error_deg=0.2,
)


def test_good_figures_need_no_reason() -> None:
    assert rate(_GOOD) == (Acceptance.GOOD, ())


@pytest.mark.parametrize(
    ("figure", "allowed", "broken", "verdict"),
    [
        ("n", 18, 17, Acceptance.POOR),
        ("n", None, 9, Acceptance.REFUSED),
        ("condition", 60.0, 60.1, Acceptance.FAIR),
        ("condition", None, 300.1, Acceptance.REFUSED),
        ("residual_percent", 2.0, 2.01, Acceptance.FAIR),
        ("residual_percent", None, 3.51, Acceptance.POOR),
        ("residual_percent", None, 20.1, Acceptance.REFUSED),
        ("radius_ut", 20.0, 19.9, Acceptance.REFUSED),
        ("radius_ut", 70.0, 70.1, Acceptance.REFUSED),
        ("direction_error_deg", 1.0, 1.01, Acceptance.FAIR),
        ("direction_error_deg", None, 2.01, Acceptance.POOR),
        ("direction_error_deg", None, 5.01, Acceptance.REFUSED),
        ("residual_of_spread", 0.5, 0.51, Acceptance.REFUSED),
        ("halves_difference", 3.0, 3.01, Acceptance.REFUSED),
        ("condition", None, float("nan"), Acceptance.REFUSED),
    ],
)
def test_each_threshold_allows_its_value_and_nothing_beyond(
    figure: str, allowed: float | None, broken: float, verdict: Acceptance
) -> None:
    if allowed is not None:
        assert rate(replace(_GOOD, **{figure: allowed}))[0] is Acceptance.GOOD
    result, (reason,) = rate(replace(_GOOD, **{figure: broken}))
    assert result is reason.verdict is verdict
    assert reason.figure == figure
    assert reason.meaning


def test_the_worst_reason_decides_and_every_figure_is_told_once() -> None:
    verdict, reasons = rate(replace(_GOOD, condition=500.0, residual_percent=4.0))
    assert verdict is Acceptance.REFUSED
    assert [(reason.figure, reason.verdict) for reason in reasons] == [
        ("condition", Acceptance.REFUSED),
        ("residual_percent", Acceptance.POOR),
    ]


@pytest.mark.parametrize("status", [status for status in FitStatus if status is not FitStatus.ELLIPSOID])
def test_what_is_no_ellipsoid_is_refused(status: FitStatus) -> None:
    verdict, (reason,) = rate(FitFigures(status, condition=11.0))
    assert verdict is Acceptance.REFUSED
    assert reason.value == status.name.lower().replace("_", " ")


def test_a_long_ellipsoid_is_refused_only_where_the_points_show_part_of_it() -> None:
    assert rate(replace(_GOOD, axis_ratio=2.5))[0] is Acceptance.GOOD
    verdict, reasons = rate(replace(_GOOD, axis_ratio=2.5, condition=60.1))
    assert verdict is Acceptance.REFUSED
    assert [reason.figure for reason in reasons] == ["condition", "axis_ratio"]


def test_an_unknown_unit_leaves_the_field_strength_unjudged() -> None:
    assert rate(replace(_GOOD, radius_ut=None))[0] is Acceptance.GOOD
