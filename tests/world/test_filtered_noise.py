"""Noise behind a low-pass filter: its density is what was asked for, its rms what the bandwidth leaves."""

from __future__ import annotations

import math

import numpy as np
import pytest

from hiltest.world.filtered_noise import LowPassedNoise, low_pass_taps
from hiltest.world.noise import NoiseSource

BANDWIDTHS = (0.32, 0.16, 0.08, 0.04)


@pytest.mark.parametrize("bandwidth", BANDWIDTHS)
def test_taps_leave_slow_changes_and_the_bandwidth_s_share_of_white_noise(bandwidth: float) -> None:
    middle, *sides = low_pass_taps(bandwidth)
    assert middle + 2.0 * sum(sides) == 1.0
    # What taps below a thousandth, and rounding to 2^-20, leave out.
    assert middle**2 + 2.0 * sum(tap**2 for tap in sides) == pytest.approx(2.0 * bandwidth, rel=0.01)


def test_at_the_bandwidth_of_the_gyroscope_it_is_three_decibels_down() -> None:
    middle, side = low_pass_taps(0.32)
    gain = middle + 2.0 * side * math.cos(2.0 * math.pi * 0.32)
    assert 20.0 * math.log10(gain) == pytest.approx(-3.0, abs=0.5)


@pytest.mark.parametrize("bandwidth", [0.32, 0.08])
def test_low_frequencies_have_density_one_and_the_rms_is_that_of_the_bandwidth(bandwidth: float) -> None:
    noise = LowPassedNoise(NoiseSource(3, "rate"))
    noise.taps = low_pass_taps(bandwidth)
    n = 20_000
    samples = np.array([noise.sample(0, k) for k in range(n)])
    # 60 000 values: the variance is known to 0.6 % times at most 2 for neighbours that are alike; three sigma.
    assert samples.var() == pytest.approx(2.0 * bandwidth, rel=0.04)
    spectrum = np.abs(np.fft.rfft(samples, axis=0)) ** 2 / n
    low = spectrum[1 : n // 100]  # up to 1 % of the sampling rate, where the filter takes 0.3 % at most
    # 600 bins of chi-squared with 2 degrees of freedom: 4 %; three sigma.
    assert low.mean() == pytest.approx(1.0, rel=0.12)


def test_a_sample_does_not_depend_on_what_was_asked_before() -> None:
    first, second = (LowPassedNoise(NoiseSource(7, "rate")) for _ in range(2))
    first.taps = second.taps = low_pass_taps(0.32)
    forward = {(epoch, k): first.sample(epoch, k) for epoch in (0, 5) for k in range(200)}
    backward = {(epoch, k): second.sample(epoch, k) for k in reversed(range(200)) for epoch in (5, 0)}
    assert forward == backward
