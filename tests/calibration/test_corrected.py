"""`corrected`: what it is for, and each step of its derivation, in float64."""

from __future__ import annotations

import itertools

import numpy as np
import pytest

from hiltest.calibration import FitStatus, corrected, fit_corrected, fit_direct
from hiltest.calibration.fit import half_range, mid_range, points_array
from hiltest.calibration.quality import COUNTS_PER_UT, direction_error_rms_deg, sphere_directions

from ..instances import Instance, instance

NOISE_UT = 2.5


def direction_error_deg(fit_of, drawn: Instance) -> float:
    """Return the rms over the sphere of true directions."""
    directions = sphere_directions(200)
    counts = COUNTS_PER_UT * (50.0 * directions @ drawn.soft_iron + drawn.hard_iron_ut)
    return direction_error_rms_deg(fit_of(drawn.points_counts), counts, directions)


def median_errors_deg(count: int, covered: tuple[float, float], seeds: int) -> tuple[float, float]:
    """Return the medians of `direct` and `corrected` over the thesis' generator, noise 2.5 uT."""
    drawn = [instance(seed, count, noise_ut=NOISE_UT, covered=covered) for seed in range(seeds)]
    direct, better = ([direction_error_deg(fit, draw) for draw in drawn] for fit in (fit_direct, fit_corrected))
    print(f"n = {count}, covered {covered}: direct {np.median(direct):.3f}, corrected {np.median(better):.3f} deg")
    return float(np.median(direct)), float(np.median(better))


@pytest.mark.slow
def test_a_thousand_noisy_points_are_worth_half_a_degree() -> None:
    """The goal that the generator's published simulation sets: 0.46 degrees there, against 1.07 of `direct`."""
    direct_deg, corrected_deg = median_errors_deg(1000, (0.5, 1.0), 1000)
    assert corrected_deg <= 0.55
    assert corrected_deg <= direct_deg / 2.0


def test_with_half_of_the_sphere_it_answers_where_direct_refuses() -> None:
    # Of 200 seeds it answers 182 with a median of 1.2 degrees, `direct` 32.
    errors_deg, of_direct = [], 0
    for seed in range(100):
        drawn = instance(seed, 1000, noise_ut=NOISE_UT, covered=(0.5, 0.5))
        of_direct += fit_direct(drawn.points_counts).has_fit
        if (fit := fit_corrected(drawn.points_counts)).has_fit:
            errors_deg.append(direction_error_deg(lambda _points, fit=fit: fit, drawn))
    assert len(errors_deg) > 80 > 40 > of_direct
    assert np.median(errors_deg) <= 1.5


@pytest.mark.parametrize("degree", range(5))
@pytest.mark.parametrize("truth", [-1.3, 0.0, 0.4])
def test_hermite_polynomials_of_noisy_values_have_the_powers_as_expectation(truth: float, degree: int) -> None:
    """Gauss-Hermite quadrature of 5 nodes integrates polynomials up to degree 9 exactly."""
    variance = 0.3
    nodes, weights = np.polynomial.hermite_e.hermegauss(5)
    noisy = np.zeros((5, 3))
    noisy[:, 0] = truth + np.sqrt(variance) * nodes
    expected = sum(
        weight * corrected._denoised_sums(corrected.power_sums(point[None]), variance)[degree, 0, 0]
        for point, weight in zip(noisy, weights / weights.sum(), strict=True)
    )
    assert expected == pytest.approx(truth**degree, abs=1e-13)


def test_the_newton_step_follows_the_slope_of_the_smallest_sum_of_squares() -> None:
    """J = step * slopes at two variances close to each other, and J' = -slopes between them."""
    points = instance(3, 300, noise_ut=NOISE_UT).points_counts
    sums = corrected.power_sums((points - points.mean(axis=0)) / 500.0)
    h = 1e-6

    def smallest_squares(variance: float) -> float:
        scatter = corrected._UNIT_TRACE @ corrected._denoised_sums(sums, variance)[corrected._PRODUCTS]
        rows = scatter @ corrected._UNIT_TRACE.T
        return float(rows[9, 9] - rows[9, :9] @ np.linalg.solve(rows[:9, :9], rows[:9, 9]))

    for variance in (0.0, 0.001, 0.0025):
        solved = corrected._solve(sums, variance)
        assert solved is not None
        slope = (smallest_squares(variance + h) - smallest_squares(variance - h)) / (2 * h)
        # The difference quotient errs by h^2 J''' and by rounding of 300 points over h: 1e-16 * 300 / 1e-6.
        assert solved.newton_step == pytest.approx(-smallest_squares(variance) / slope, rel=1e-6)


def test_the_noise_comes_out_of_the_steps() -> None:
    """The spread of an estimate from n points is sigma / sqrt(2 n): 2 % of it here, 0.3 % of the median of 50."""
    drawn = [instance(seed, 1000, noise_ut=NOISE_UT, covered=(0.7, 1.0)) for seed in range(50)]
    results = []
    for draw in drawn:
        points = points_array(draw.points_counts)
        adjusted = corrected._newton(corrected.power_sums((points - mid_range(points)) / half_range(points)))
        assert adjusted is not None
        results.append(half_range(points) * np.sqrt(adjusted.variance))
    assert np.median(results) == pytest.approx(COUNTS_PER_UT * NOISE_UT, rel=0.01)


def test_a_third_step_would_change_nothing_that_matters(monkeypatch: pytest.MonkeyPatch) -> None:
    drawn = [instance(seed, 1000, noise_ut=NOISE_UT) for seed in range(100)]
    errors = {}
    for steps in (1, 2, 3):
        monkeypatch.setattr(corrected, "NEWTON_STEPS", steps)
        errors[steps] = np.array([direction_error_deg(fit_corrected, draw) for draw in drawn])
    # A hundredth of the half degree that they err by, in nine of ten; some others are shrunk, and go on from there.
    assert np.percentile(np.abs(errors[3] - errors[2]), 90) < 0.005
    assert np.percentile(np.abs(errors[2] - errors[1]), 90) > 0.025


def test_a_variance_that_leaves_no_ellipsoid_is_shrunk() -> None:
    backed_off = 0
    for seed in range(100):
        points = instance(seed, 60, noise_ut=5.0, covered=(0.5, 0.5)).points_counts
        assert fit_corrected(points).status in (FitStatus.ELLIPSOID, FitStatus.POOR_COVERAGE)
        counts = points - (points.min(axis=0) + points.max(axis=0)) / 2
        sums = corrected.power_sums(counts / np.ptp(points, axis=0).max() * 2)
        direct = corrected._solve(sums, 0.0)
        if direct is not None and corrected._solve(sums, direct.newton_step) is None:
            backed_off += corrected._newton(sums) is not None
    assert backed_off > 0


@pytest.mark.slow
def test_with_a_tenth_of_the_field_as_noise_it_removes_the_bias_as_well() -> None:
    """200 instances, 5 uT, 1000 points: 1.16 degrees against 2.60 of `direct`, whose fit it was before."""
    drawn = [instance(seed, 1000, noise_ut=5.0) for seed in range(200)]

    def median_deg(fit_of) -> float:
        fits = [fit_of(draw.points_counts, largest_error_deg=np.inf) for draw in drawn]
        assert all(fit.has_fit for fit in fits)
        errors = [direction_error_deg(lambda _, fit=fit: fit, draw) for fit, draw in zip(fits, drawn, strict=True)]
        return float(np.median(errors))

    direct_deg, corrected_deg = median_deg(fit_direct), median_deg(fit_corrected)
    print(f"direct {direct_deg:.2f}, corrected {corrected_deg:.2f} deg")
    # A median of 200 errors that spread by 1 degree is known within 0.1.
    assert corrected_deg <= 1.3
    assert corrected_deg <= direct_deg / 2.0


@pytest.mark.parametrize(("noise_ut", "count"), [(6.0, 300), (8.0, 300), (8.0, 1000)])
def test_much_noise_is_answered_and_refused_by_the_error_that_the_corrected_sums_predict(
    noise_ut: float, count: int
) -> None:
    answers = 0
    too_far = 0
    for seed in range(60):
        drawn = instance(seed, count, noise_ut=noise_ut)
        fit = fit_corrected(drawn.points_counts)
        if fit.iterations:
            answers += 1
            too_far += direction_error_deg(lambda _points, fit=fit: fit, drawn) > 5.0
    # 55 % to 80 % of the seeds get an answer of which one in ten may err by more than the 5 degrees of the prediction,
    # an rms; without the prediction from the corrected sums it is one in five with 300 points of 8 uT.
    assert answers > 25
    assert too_far <= answers / 10


@pytest.mark.parametrize(
    ("count", "noise_ut", "falls_back"),
    [(49, 1.0, True), (50, 1.0, False), (400, 3.0, False), (400, 9.0, False)],
    ids=["49 points", "50 points", "noise of 6 %", "noise of 18 %"],
)
def test_few_points_are_left_to_direct_and_noise_is_not(count: int, noise_ut: float, *, falls_back: bool) -> None:
    for seed in range(20):
        points = instance(seed, count, noise_ut=noise_ut, covered=(0.9, 1.0), stretch=0.1).points_counts
        fit, direct = fit_corrected(points), fit_direct(points)
        assert (fit.iterations == 0) is falls_back
        assert np.array_equal(fit.soft_iron, direct.soft_iron) is falls_back
        assert fit.coverage == direct.coverage


def test_it_follows_a_permutation_of_the_axes() -> None:
    points = instance(11, 300, noise_ut=NOISE_UT).points_counts
    fit = fit_corrected(points)
    for order in itertools.permutations(range(3)):
        turned = fit_corrected(points[:, order])
        # Rounding times the condition of the normal equations.
        assert np.allclose(turned.soft_iron, fit.soft_iron[np.ix_(order, order)], rtol=0, atol=1e-12)
        assert np.allclose(turned.hard_iron, fit.hard_iron[list(order)], rtol=0, atol=1e-9)
