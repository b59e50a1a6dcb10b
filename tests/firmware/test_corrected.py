"""`corrected` in the firmware: how far from the truth, when it is `direct`, and what its steps cost."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from hiltest.calibration import FitStatus, fit_corrected

from ..instances import instance

NOISE_UT = 2.5


@pytest.mark.parametrize(
    ("count", "noise_ut", "covered"),
    [
        (60, 5.0, (0.5, 1.0)),
        (50, 4.0, (0.5, 1.0)),
        (60, 10.0, (0.5, 1.0)),
        (300, 8.0, (0.5, 1.0)),
        (512, 5.0, (0.5, 0.6)),
        (300, 0.0, (0.5, 1.0)),
    ],
)
def test_noise_that_shrinks_or_refuses_the_step_does_so_in_both(
    host_calibrators: Any, count: int, noise_ut: float, covered: tuple[float, float]
) -> None:
    """Where a step is shrunk or refused two numbers are compared: the rounding of 16-bit products flips 1 of these."""
    ends, flipped = set(), []
    for seed in range(300):
        points = instance(seed, count, noise_ut=noise_ut, covered=covered).points_counts
        ours, expected = host_calibrators.calibrate("corrected", points), fit_corrected(points)
        if (ours.status, ours.iterations) != (expected.status, expected.iterations):
            flipped.append(seed)
        ends.add(ours.iterations)
    assert 2 in ends
    assert len(flipped) <= 1, flipped


@pytest.mark.parametrize("count", [9, 49])
def test_few_points_have_the_bits_of_direct(calibrators: Any, count: int) -> None:
    for seed in range(20):
        points = instance(seed, count, covered=(0.9, 1.0), stretch=0.1).points_counts
        ours, direct = (calibrators.calibrate(name, points) for name in ("corrected", "direct"))
        assert (ours.status, ours.iterations, ours.coverage) == (direct.status, 0, direct.coverage)
        assert np.array_equal(ours.soft_iron, direct.soft_iron)
        assert np.array_equal(ours.hard_iron, direct.hard_iron)


def test_one_step_is_not_converged_and_lies_between(host_calibrators: Any) -> None:
    points = instance(8, 200, noise_ut=NOISE_UT, covered=(0.8, 0.8)).points_counts
    none, one, both = (
        host_calibrators.calibrate(name, points, iterations=steps)
        for name, steps in (("direct", 0), ("corrected", 1), ("corrected", 0))
    )
    assert (one.status, one.iterations) == (FitStatus.NOT_CONVERGED, 1)
    assert (both.status, both.iterations) == (FitStatus.ELLIPSOID, 2)
    # Newton's method converges quadratically: most of the way is done by the first step.
    assert np.abs(one.soft_iron - both.soft_iron).max() < 0.3 * np.abs(none.soft_iron - both.soft_iron).max()
    for steps in (2, 3, 65535):
        again = host_calibrators.calibrate("corrected", points, iterations=steps)
        assert np.array_equal(again.soft_iron, both.soft_iron)


def test_a_step_costs_1560_cycles_whatever_the_number_of_points(board_calibrators: Any) -> None:
    steps = set()
    for count in (60, 100, 300):
        points = instance(1, count, stretch=0.1, covered=(1.0, 1.0)).points_counts
        one, both = (board_calibrators.cost("corrected", points, iterations=steps).cycles for steps in (1, 2))
        fast = board_calibrators.cost("direct-fast", points).cycles
        print(f"corrected, n = {count}: {both} cycles, {both - one} the second step; direct-fast {fast}")
        # Two steps and the choice between two fits are all that it does beyond `direct-fast`.
        assert both - fast <= 2 * (both - one) + 150
        steps.add(both - one)
    assert max(steps) <= 1560
    assert max(steps) - min(steps) <= 30  # the square root's own steps differ by one


def test_the_worst_back_off_is_bounded(board_calibrators: Any) -> None:
    """Nine fits a step at most."""
    costs = [
        board_calibrators.cost("corrected", instance(seed, 50, noise_ut=5.0, covered=(0.5, 0.5)).points_counts).cycles
        for seed in range(100)
    ]
    print(f"corrected, n = 50, much noise: {min(costs)} to {max(costs)} cycles")
    assert max(costs) <= 103 * 50 + 1700 + 2 * 9 * 1560
