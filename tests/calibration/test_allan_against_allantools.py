"""Deviations and intervals of a log are those of the package allantools."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import allantools
import numpy as np
import pytest

from hiltest.calibration.allan import allan_curve, averages
from hiltest.calibration.degrees_of_freedom import degrees_of_freedom, interval, noise_exponents
from hiltest.log_fitting.allan_page import allan_document
from hiltest.log_fitting.rate_log import read_rate_log

from .synthetic_rates import Reals, flicker, random_walk, white

RATE_HZ, N = 50.0, 30_000
RNG = np.random.default_rng
#: A log by its noise, and its exponent.
LOGS: dict[str, tuple[Callable[[int], Reals], int]] = {
    "white angle": (lambda seed: np.diff(RNG(seed).normal(size=N + 1)), 2),
    "white": (lambda seed: white(RNG(seed), N, rate_hz=RATE_HZ, angle_random_walk=0.02), 0),
    "flicker": (lambda seed: flicker(RNG(seed), N, rate_hz=RATE_HZ, bias_instability=0.01), -1),
    "random walk": (lambda seed: random_walk(RNG(seed), N, rate_hz=RATE_HZ, rate_random_walk=0.01), -2),
}


def consumer_part(seed: int) -> Reals:
    """White noise to some seconds, then flicker, and at last a random walk."""
    white_and_flicker = white(RNG(seed), N, rate_hz=RATE_HZ, angle_random_walk=0.02) + flicker(
        RNG(seed + 1), N, rate_hz=RATE_HZ, bias_instability=0.01
    )
    return white_and_flicker + random_walk(RNG(seed + 2), N, rate_hz=RATE_HZ, rate_random_walk=0.001)


@pytest.mark.parametrize("alpha", [2, 1, 0, -1, -2])
@pytest.mark.parametrize("n", [1000, 30_000])
def test_degrees_of_freedom_are_those_of_greenhall(n: int, alpha: int) -> None:
    for m in averages(n).tolist():
        theirs = allantools.edf_greenhall(alpha=alpha, d=2, m=m, N=n + 1, overlapping=True, modified=False)
        # The same formulas; of the fourth differences of |t|^5 a few digits cancel.
        assert degrees_of_freedom(n, m, alpha) == pytest.approx(theirs, rel=1e-9)


@pytest.mark.parametrize("name", LOGS)
def test_the_kind_of_noise_is_told_as_theirs_tells_it(name: str) -> None:
    make, alpha = LOGS[name]
    for seed in range(3):
        theta = allantools.frequency2phase(make(seed), RATE_HZ)
        # Of 200 averages and more; with fewer, theirs takes white noise for another kind in one case of five.
        sizes = [m for m in averages(N).tolist() if 200 * m <= N]
        theirs = [min(2, allantools.autocorr_noise_id(theta, m)[0]) for m in sizes]
        result = noise_exponents(theta, sizes)
        assert result == theirs
        if alpha != -1:  # flicker lies between, and is taken for a random walk now and then
            assert set(result) == {alpha}


def test_few_averages_of_white_noise_are_not_taken_for_a_quieter_kind() -> None:
    for seed in range(20):
        theta = allantools.frequency2phase(LOGS["white"][0](seed), RATE_HZ)
        assert max(noise_exponents(theta, averages(N).tolist())[1:]) == 0


@pytest.mark.parametrize("make", [*(make for make, _ in LOGS.values()), consumer_part])
def test_deviations_and_intervals_agree_at_all_averaging_times(make: Callable[[int], Reals]) -> None:
    rates = make(8) + 3.0
    curve = allan_curve(rates[:, None], rate_hz=RATE_HZ)
    tau_s, theirs, _, _ = allantools.oadev(rates, rate=RATE_HZ, data_type="freq", taus=curve.tau_s)
    assert tau_s == pytest.approx(curve.tau_s, rel=1e-12)
    assert curve.deviation[:, 0] == pytest.approx(theirs, rel=1e-9)
    theta, compared = allantools.frequency2phase(rates, RATE_HZ), 0
    for index, m in enumerate(averages(N).tolist()):
        if 200 * m > N:
            continue  # it knows no kind below 30 averages, and often a wrong one below 200: see above
        low, high = allantools.confidence_interval_noiseID(theta, theirs[index], m, dev_type="oadev", data_type="phase")
        # "within 5 %": but for a sample's difference in n they are the same.
        assert (curve.low[index, 0], curve.high[index, 0]) == pytest.approx((low, high), rel=0.05)
        compared += 1
    assert compared > 20


def test_intervals_of_long_averages_are_those_of_the_noise_that_is_there() -> None:
    curve = allan_curve(LOGS["white"][0](8)[:, None], rate_hz=RATE_HZ)
    for index, m in enumerate(averages(N).tolist()):
        freedom = allantools.edf_greenhall(alpha=0, d=2, m=m, N=N + 1, overlapping=True, modified=False)
        theirs = allantools.confidence_interval(curve.deviation[index, 0], freedom)
        assert (curve.low[index, 0], curve.high[index, 0]) == pytest.approx(theirs, rel=0.05)
        assert interval(curve.deviation[index, 0], freedom) == pytest.approx(theirs, rel=1e-9)


def test_what_the_command_writes_agrees_on_an_evenly_stamped_log(tmp_path: Path) -> None:
    rates = np.column_stack([consumer_part(seed) for seed in (1, 4, 7)])
    stamped = np.column_stack([np.arange(N) / RATE_HZ, rates])
    np.savetxt(tmp_path / "rest.csv", stamped, "%.9g", ",", header="t_s,gx_dps,gy_dps,gz_dps", comments="")
    read = np.loadtxt(tmp_path / "rest.csv", delimiter=",", skiprows=1)
    log = read_rate_log(tmp_path / "rest.csv")
    curve = allan_document(log, allan_curve(log.rates, rate_hz=log.rate_hz)).curve
    for axis, name in enumerate(("gx_dps", "gy_dps", "gz_dps"), start=1):
        _, theirs, _, _ = allantools.oadev(read[:, axis], rate=RATE_HZ, data_type="freq", taus=np.array(curve["tau_s"]))
        assert curve["deviation"][name] == pytest.approx(theirs, rel=1e-9)
