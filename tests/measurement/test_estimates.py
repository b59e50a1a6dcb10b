"""Quantiles over instances: their intervals hold for every distribution, and an unknown end is open."""

from __future__ import annotations

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.stats import cauchy, norm

from hiltest.measurement.estimates import Estimate, quantile


@pytest.mark.parametrize("distribution", [norm, cauchy])
@pytest.mark.parametrize("share", [0.5, 0.95, 0.99])
def test_the_interval_of_a_quantile_contains_the_true_one_in_95_of_100_samples(
    distribution: type[norm], share: float
) -> None:
    draws = distribution.rvs(size=(1000, 500), random_state=np.random.default_rng(1))
    true = distribution.ppf(share)
    estimates = [quantile(draw, share) for draw in draws]
    inside = [
        (-math.inf if estimate.low is None else estimate.low)
        <= true
        <= (math.inf if estimate.high is None else estimate.high)
        for estimate in estimates
    ]
    assert 0.93 < np.mean(inside) < 0.99  # order statistics are discrete, so that it is at least 0.95


@given(st.lists(st.floats(0.0, 1e3), min_size=1, max_size=200), st.sampled_from([0.5, 0.99]))
def test_an_interval_contains_its_value(values: list[float], share: float) -> None:
    estimate = quantile(values, share)
    assert estimate.value in values
    assert estimate.low is None or estimate.low <= estimate.value
    assert estimate.high is None or estimate.value <= estimate.high


def test_too_few_instances_leave_the_upper_end_open() -> None:
    assert quantile(range(1, 101), 0.99) == Estimate(99.0, 97.0, None)
    assert quantile(range(1, 101), 0.5) == Estimate(50.0, 40.0, 61.0)
    assert str(quantile(range(1, 101), 0.99)) == "99.00 (at least 97.00)"
    assert str(quantile([0.32], 0.5)) == "0.32 (too few instances for an interval)"
