"""The Allan deviation is what its definition says, and its figures are those that a log was made with."""

from __future__ import annotations

import numpy as np
import pytest

from hiltest.calibration.allan import FLICKER, Estimate, allan_curve, averages
from hiltest.errors import CalibrationError

from .synthetic_rates import flicker, random_walk, white

# Of a consumer part: 25 mdps/sqrt(Hz) one-sided, 20 deg/h.
WALK, INSTABILITY = 0.025 / np.sqrt(2.0), 20.0 / 3600.0
TWO_HOURS_S, RATE_HZ = 7200.0, 50.0


def value(estimate: Estimate | None) -> float:
    """What was found; the test fails where nothing was."""
    assert estimate is not None
    return estimate.value


def by_definition(rates: np.ndarray, m: int) -> float:
    """Half the mean square difference of neighbouring means of m samples, over all places they can begin at."""
    differences = [rates[k + m : k + 2 * m].mean() - rates[k : k + m].mean() for k in range(len(rates) - 2 * m + 1)]
    return float(np.sqrt(0.5 * np.mean(np.square(differences))))


def test_it_is_the_mean_over_all_pairs_of_neighbouring_averages() -> None:
    rates = np.random.default_rng(1).normal([3.0, -100.0], 1.0, size=(1200, 2))
    curve = allan_curve(rates, rate_hz=10.0)
    assert np.array_equal(curve.tau_s, averages(1200) / 10.0)
    for index in (0, 3, 9, len(curve.tau_s) - 1):
        m = int(averages(1200)[index])
        for axis in range(2):
            assert curve.deviation[index, axis] == pytest.approx(by_definition(rates[:, axis], m), rel=1e-9)


def test_known_courses_have_the_deviation_of_the_standard() -> None:
    time_s = np.arange(2000) / 100.0
    ramp = allan_curve((0.3 * time_s)[:, None], rate_hz=100.0)
    assert ramp.deviation[:, 0] == pytest.approx(0.3 * ramp.tau_s / np.sqrt(2.0))  # IEEE Std 952, rate ramp
    angle = allan_curve(np.sin(2.0 * np.pi * 5.0 * time_s)[:, None], rate_hz=100.0)
    x = np.pi * 5.0 * angle.tau_s  # IEEE Std 952, sinusoid; its time averages, of 20 samples a period
    assert angle.deviation[3:8, 0] == pytest.approx((np.sin(x) ** 2 / x)[3:8], rel=0.05, abs=0.01)


@pytest.fixture(scope="module")
def two_hours() -> np.ndarray:
    rng, n = np.random.default_rng(952), int(TWO_HOURS_S * RATE_HZ)
    return np.column_stack(
        [
            white(rng, n, rate_hz=RATE_HZ, angle_random_walk=WALK)
            + flicker(rng, n, rate_hz=RATE_HZ, bias_instability=INSTABILITY)
            for _ in range(3)
        ]
    )


def test_two_hours_give_random_walk_and_instability_back(two_hours: np.ndarray) -> None:
    for reading in allan_curve(two_hours, rate_hz=RATE_HZ).readings:
        assert value(reading.angle_random_walk) == pytest.approx(WALK, rel=0.05)
        assert value(reading.bias_instability) == pytest.approx(INSTABILITY, rel=0.30)
        assert reading.lowest.value == pytest.approx(np.sqrt(FLICKER) * INSTABILITY, rel=0.5)


@pytest.mark.parametrize("factor", [np.pi / 180.0, 1000.0])
def test_a_wrong_unit_or_rate_of_sampling_is_as_wrong_as_it_is(two_hours: np.ndarray, factor: float) -> None:
    one = two_hours[:100_000, :1]
    reading = allan_curve(factor * one, rate_hz=RATE_HZ).readings[0]
    assert value(reading.angle_random_walk) == pytest.approx(factor * WALK, rel=0.05)
    # Half the rate of sampling makes averages twice as long, and the walk larger by the root of two.
    slower = allan_curve(one, rate_hz=0.5 * RATE_HZ).readings[0]
    assert value(slower.angle_random_walk) == pytest.approx(np.sqrt(2.0) * WALK, rel=0.05)


def test_in_68_of_100_logs_the_true_numbers_are_within_their_intervals() -> None:
    """White noise and flicker, whose density is one, and the deviation what both make."""
    n, rate_hz, walk, instability = 20_000, 10.0, 0.1, 0.05
    results, hits = [], []
    for seed in range(40):
        rng = np.random.default_rng(seed)
        curve = allan_curve(
            white(rng, n, rate_hz=rate_hz, angle_random_walk=walk)[:, None]
            + flicker(rng, n, rate_hz=rate_hz, bias_instability=instability)[:, None],
            rate_hz=rate_hz,
        )
        (reading,) = curve.readings
        results.append((value(reading.angle_random_walk), value(reading.bias_instability)))
        truth = np.sqrt(walk**2 / curve.tau_s + FLICKER * instability**2)
        within = (curve.low[:, 0] <= truth) & (truth <= curve.high[:, 0])
        hits.append(
            [
                *within[::12],
                *(
                    item is not None and item.low <= true <= item.high
                    for item, true in ((reading.angle_random_walk, walk), (reading.bias_instability, instability))
                ),
            ]
        )
    # B comes out 3 % low, a third of one log's uncertainty: K, which is never negative, takes some of the flat part.
    assert np.mean(results, axis=0) == pytest.approx((walk, instability), rel=0.05)
    # 40 logs show 0.68 with a deviation of 0.074: all columns within three of them, and together within 0.08.
    assert np.abs(np.mean(hits, axis=0) - 0.68).max() < 0.22
    assert np.mean(hits) == pytest.approx(0.68, abs=0.08)


def test_white_noise_alone_shows_no_instability() -> None:
    rng = np.random.default_rng(3)
    reading = allan_curve(white(rng, 50_000, rate_hz=50.0, angle_random_walk=WALK)[:, None], rate_hz=50.0).readings[0]
    assert reading.bias_instability is None
    assert reading.rate_random_walk is None
    assert reading.bias_instability_at_most == pytest.approx(reading.lowest.high / np.sqrt(FLICKER))
    assert value(reading.angle_random_walk) == pytest.approx(WALK, rel=0.05)


def test_a_random_walk_of_the_rate_is_told_from_the_rest() -> None:
    rng, n = np.random.default_rng(4), 200_000
    rates = white(rng, n, rate_hz=50.0, angle_random_walk=WALK) + random_walk(
        rng, n, rate_hz=50.0, rate_random_walk=0.002
    )
    reading = allan_curve(rates[:, None], rate_hz=50.0).readings[0]
    assert value(reading.rate_random_walk) == pytest.approx(0.002, rel=0.3)
    assert value(reading.angle_random_walk) == pytest.approx(WALK, rel=0.05)


def test_what_is_no_log_of_noise_is_refused() -> None:
    with pytest.raises(CalibrationError, match=r"999 samples; .* at least 1000"):
        allan_curve(np.zeros((999, 1)), rate_hz=50.0)
    alternating = np.where(np.arange(2000) % 2, 1.0, -1.0)
    with pytest.raises(CalibrationError, match="repeats itself"):
        allan_curve(alternating[:, None], rate_hz=50.0)
    stuck = np.random.default_rng(5).normal(size=(2000, 3))
    stuck[:, 1] = 0.25
    with pytest.raises(CalibrationError, match="rate 2 of 3 has a single value"):
        allan_curve(stuck, rate_hz=50.0)
