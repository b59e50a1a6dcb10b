"""The noise density is that of the noise: not of the drift, and not of what the output filter leaves."""

from __future__ import annotations

import numpy as np
import pytest

from hiltest.calibration.noise_density import noise_density
from hiltest.errors import CalibrationError
from hiltest.world.filtered_noise import low_pass_taps

RATE_HZ, DENSITY = 200.0, 0.025


def filtered(rng: np.random.Generator, n: int) -> np.ndarray:
    """White noise of the density behind the gyroscope's filter, as the virtual part makes it."""
    middle, side = low_pass_taps(0.32)
    white = rng.normal(size=(n + 2, 3)) * DENSITY * np.sqrt(0.5 * RATE_HZ)
    return middle * white[1:-1] + side * (white[:-2] + white[2:])


def test_the_density_is_found_and_its_uncertainty_is_what_it_says() -> None:
    rng = np.random.default_rng(8)
    noise_densities = [noise_density(filtered(rng, 2000), rate_hz=RATE_HZ) for _ in range(300)]
    values = np.array([density.together for density in noise_densities]) / DENSITY
    # The filter takes 0.9 % in this band; the mean of 300 with 2.4 % is known to 0.14 %.
    assert values.mean() == pytest.approx(1.0 - 0.009, abs=0.005)
    assert values.std() == pytest.approx(noise_densities[0].relative_uncertainty, rel=0.15)  # 300 trials: 4 %
    per_axis = np.array([density.per_axis for density in noise_densities]) / DENSITY
    assert per_axis.mean(axis=0) == pytest.approx(np.full(3, 0.99), abs=0.01)


def test_a_drift_does_not_enter() -> None:
    rng = np.random.default_rng(9)
    samples = filtered(rng, 2000)
    time_s = np.arange(2000) / RATE_HZ
    still = noise_density(samples, rate_hz=RATE_HZ).together
    line = noise_density(samples + np.outer(time_s, [0.5, -0.2, 1.0]) + 3.0, rate_hz=RATE_HZ).together
    assert line == pytest.approx(still, rel=1e-9)
    # A bias that warms up by 0.5 dps with a time constant of 10 s: what a line leaves of it is below 1 Hz.
    warm = samples + 0.5 * np.exp(-time_s / 10.0)[:, None]
    assert noise_density(warm, rate_hz=RATE_HZ).together == pytest.approx(still, rel=0.01)
    assert warm.std() > 1.1 * samples.std()


def test_the_rms_of_filtered_samples_would_say_less_than_there_is() -> None:
    samples = filtered(np.random.default_rng(10), 20_000)
    assert samples.std() / np.sqrt(0.5 * RATE_HZ) == pytest.approx(0.8 * DENSITY, rel=0.02)
    assert noise_density(samples, rate_hz=RATE_HZ).together == pytest.approx(DENSITY, rel=0.03)


@pytest.mark.parametrize(("factor", "expected"), [(16.0, 16.0), (np.pi / 180.0, np.pi / 180.0)])
def test_a_wrong_unit_is_as_wrong_as_it_is(factor: float, expected: float) -> None:
    samples = factor * filtered(np.random.default_rng(11), 2000)
    assert noise_density(samples, rate_hz=RATE_HZ).together == pytest.approx(expected * DENSITY, rel=0.1)


def test_too_short_a_log_is_refused() -> None:
    with pytest.raises(CalibrationError, match=r"200 samples at 200 Hz have 16 frequencies .* needs 30"):
        noise_density(np.zeros((200, 3)), rate_hz=200.0)
