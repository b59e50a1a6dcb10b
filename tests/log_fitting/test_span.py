"""Part of a log: by hand, and the longest in which the field does not change."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from hiltest.calibration.acceptance import Acceptance
from hiltest.errors import ConfigError
from hiltest.log_fitting import FieldUnit, Samples
from hiltest.log_fitting.sample_fit import fit_on_host
from hiltest.log_fitting.span import (
    between,
    field_change,
    field_growth,
    instants,
    is_at_rest,
    is_in_order_of_time,
    steady,
)

from ..calibration.hand_turned import TRUTH, hand_turned

_COUNT = 1200


def _log(*, timed: bool) -> Samples:
    """Return a log of 60 s, with a step of 6 % of the field after 42 s."""
    points = hand_turned(3, _COUNT)
    points[840:] += (0.0, 0.0, 2.8)
    samples = Samples(Path("log.csv"), points, FieldUnit.UT, "option", ("x", "y", "z"), 0)
    return replace(samples, time_s=1000.0 + np.arange(_COUNT) / 20.0) if timed else samples


def test_a_change_is_poor_and_located_in_time() -> None:
    fit = fit_on_host(_log(timed=True))
    assert fit.best.verdict is Acceptance.POOR
    assert [reason.figure for reason in fit.best.reasons if reason.verdict is Acceptance.POOR] == ["change_percent"]
    assert fit.change is not None
    assert (fit.change.at, fit.change.at_unit) == (pytest.approx(42.0, abs=1.5), "s")  # two blocks of 0.75 s
    assert "The field changed at 4" in " ".join(fit.notes)


def test_the_longest_steady_part_is_good() -> None:
    log = _log(timed=True)
    start, end = steady(log)
    assert (start, end) == (0.0, pytest.approx(42.0, abs=1.5))
    part = between(log, start, end)
    assert fit_on_host(part).best.verdict is Acceptance.GOOD
    assert part.time_s is not None
    assert len(part.points) == len(part.time_s) == np.searchsorted(np.arange(_COUNT) / 20.0, end)


def test_without_times_instants_are_numbers_of_readings() -> None:
    log = _log(timed=False)
    change = field_change(log)
    assert change is not None
    assert (change.at, change.at_unit) == (pytest.approx(841, abs=30), "reading")
    assert len(between(log, 101.0, 201.0).points) == 100
    assert (between(log, 101.0, 201.0).points == log.points[100:200]).all()


@pytest.mark.parametrize(("timed", "first", "changed"), [(True, 10.0, 42.0), (False, 201.0, 841.0)])
def test_instants_of_a_part_are_those_of_the_log(timed: bool, first: float, changed: float) -> None:
    part = between(_log(timed=timed), first, None)
    change = field_change(part)
    assert change is not None
    assert change.at == pytest.approx(changed, rel=0.04)  # two blocks of 80
    assert instants(between(part, changed, None))[0][0] == changed


def test_a_part_without_readings_says_where_there_are_some() -> None:
    with pytest.raises(ConfigError, match=r"no reading from 90 to inf; there are some from 0 to 59\.95 \(seconds"):
        between(_log(timed=True), 90.0, None)
    with pytest.raises(ConfigError, match="numbers of the readings"):
        between(_log(timed=False), 5000.0, None)


@pytest.mark.parametrize("seed", range(4))
def test_rows_in_no_order_of_time_are_said(seed: int) -> None:
    turned = hand_turned(seed, 400)
    shuffled = np.random.default_rng(seed).permutation(turned)
    for points, in_order in ((turned, True), (shuffled, False), (shuffled[:39], True)):
        fit = fit_on_host(replace(_log(timed=False), points=points), "direct")
        assert fit.in_order is in_order
        assert ("not in order of time" in " ".join(fit.notes)) is not in_order


@pytest.mark.parametrize("scale", [1.0, 1e-3])
def test_a_sensor_at_rest_is_said_to_be_at_rest_and_not_out_of_order(scale: float) -> None:
    ball = scale * np.random.default_rng(1).normal((20.0, 3.0, -40.0), 0.3, (500, 3))
    fit = fit_on_host(replace(_log(timed=False), points=ball), "direct")
    assert (fit.at_rest, fit.best.verdict) == (True, Acceptance.REFUSED)
    assert "at rest" in " ".join(fit.notes)
    assert "order of time" not in " ".join(fit.notes)
    shuffled = np.random.default_rng(1).permutation(hand_turned(1, 500)) + 33_000.0
    assert not is_at_rest(replace(_log(timed=False), points=shuffled))


def test_a_field_that_grows_by_6_percent_is_noticed_and_is_no_step() -> None:
    for seed in range(20):
        points, middle = hand_turned(seed, 800), TRUTH.hard_iron
        assert field_growth(replace(_log(timed=False), points=points)) is None
        grown = middle + (points - middle) * np.linspace(0.97, 1.03, 800)[:, None]
        fit = fit_on_host(replace(_log(timed=False), points=grown), "direct")
        # 0.3 uT of noise that lasts a second: 0.6 % in 40 s.
        assert fit.growth_percent == pytest.approx(6.0, abs=2.0)
        assert (fit.change, fit.best.verdict is Acceptance.GOOD) == (None, False)
    assert field_growth(_log(timed=True)) is None  # a step


@pytest.mark.parametrize("revolutions", [1, 2, 4])
def test_turns_that_repeat_are_in_order(revolutions: int) -> None:
    angles = np.linspace(0.0, 2.0 * np.pi * revolutions, 400)
    turn = np.column_stack([20.0 * np.cos(angles), 20.0 * np.sin(angles), np.full(400, 40.0)])
    points = turn + np.random.default_rng(1).normal(0.0, 0.4, turn.shape)
    assert is_in_order_of_time(replace(_log(timed=False), points=points))
