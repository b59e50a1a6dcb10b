"""Calibrators within a budget of cycles, on the virtual board: virtual cycles are exact."""

from __future__ import annotations

import numpy as np
import pytest
from numpy.typing import NDArray

from hiltest.boards import Board
from hiltest.calibration.fit import FitStatus
from hiltest.errors import CalibrationError
from hiltest.procedures import (
    EffortKind,
    effort_curve,
    evenly_spread,
    golden_points,
    largest_effort_within,
    upload_points,
)
from hiltest.procedures.calibrate import calibrate_once
from hiltest.procedures.cycles import cycles_of

POINTS = 60
CALIBRATORS = ("direct", "corrected", "iterative", "direct-stream")


@pytest.fixture(autouse=True)
def cloud(virtual_board: Board) -> None:
    upload_points(virtual_board, golden_points(POINTS)[evenly_spread(POINTS)])


@pytest.mark.parametrize("calibrator", CALIBRATORS)
def test_more_effort_costs_more_and_ends_at_all_of_it(virtual_board: Board, calibrator: str) -> None:
    curve = effort_curve(virtual_board, calibrator, points=POINTS)
    efforts, cycles = [point.effort for point in curve], [point.cycles for point in curve]
    assert efforts == sorted(set(efforts))
    assert cycles == sorted(set(cycles))
    name = calibrator.removesuffix("-stream")
    whole, _ = calibrate_once(virtual_board, name, POINTS)
    # direct-stream sums exactly, direct in float32: the entries differ by its rounding.
    assert curve[-1].fit.soft_iron == pytest.approx(whole.soft_iron, rel=1e-4, abs=1e-7)
    assert curve[-1].fit.status is FitStatus.ELLIPSOID
    assert curve[-1].fit.hard_iron == pytest.approx(whole.hard_iron, abs=0.05)
    # And the first is not yet that.
    assert np.abs(curve[0].fit.hard_iron - whole.hard_iron).max() > 0.05


def test_each_calibrator_does_less_of_what_it_can_do_less_of(virtual_board: Board) -> None:
    names = (*CALIBRATORS, "li", "gauss-newton")
    kinds = {name: effort_curve(virtual_board, name, points=POINTS)[0].kind for name in names}
    assert kinds == {
        "direct": EffortKind.POINTS,
        "corrected": EffortKind.POINTS,
        "iterative": EffortKind.SWEEPS,
        "li": EffortKind.POINTS,
        "direct-stream": EffortKind.POINTS_SO_FAR,
        "gauss-newton": EffortKind.SWEEPS,
    }


@pytest.mark.parametrize("calibrator", CALIBRATORS)
def test_the_largest_effort_within_a_budget_is_the_largest(virtual_board: Board, calibrator: str) -> None:
    curve = effort_curve(virtual_board, calibrator, points=POINTS)
    expected, above = curve[-3], curve[-2]
    exactly = largest_effort_within(virtual_board, calibrator, cycles=expected.cycles, points=POINTS)
    assert (exactly.effort, exactly.cycles) == (expected.effort, expected.cycles)
    less = largest_effort_within(virtual_board, calibrator, cycles=expected.cycles - 1, points=POINTS)
    assert less.effort == expected.effort - 1
    between = largest_effort_within(virtual_board, calibrator, cycles=above.cycles - 1, points=POINTS)
    assert expected.effort <= between.effort == above.effort - 1
    everything = largest_effort_within(virtual_board, calibrator, cycles=10**9, points=POINTS)
    assert (everything.effort, everything.cycles) == (curve[-1].effort, curve[-1].cycles)


def half_a_sphere(points: int) -> NDArray[np.int16]:
    """Noise of 1 uT on the half around +z: few of the first points determine no ellipsoid, some do by chance."""
    noise = np.random.default_rng(4)
    ray = noise.normal(size=(points, 3))
    ray[:, 2] = np.abs(ray[:, 2])
    ray *= 485.0 / np.linalg.norm(ray, axis=1, keepdims=True)
    return np.rint(ray + noise.normal(scale=10.0, size=ray.shape) + (1700, -1210, 1240)).astype(np.int16)


def test_of_hundreds_of_sweeps_a_curve_has_some_and_a_budget_all(virtual_board: Board) -> None:
    upload_points(virtual_board, half_a_sphere(100))
    curve = effort_curve(virtual_board, "gradient-descent", points=100)
    assert curve[-1].kind is EffortKind.SWEEPS
    assert len(curve) < 50 < curve[-1].effort
    for budget in (curve[5].cycles, curve[-2].cycles + 1, curve[-1].cycles - 1):
        result = largest_effort_within(virtual_board, "gradient-descent", cycles=budget, points=100)
        _, above = calibrate_once(virtual_board, "gradient-descent", 100, iterations=result.effort + 1)
        assert result.cycles <= budget < cycles_of(above)


@pytest.mark.slow
@pytest.mark.parametrize("calibrator", ["direct", "direct-stream"])
def test_the_largest_effort_within_a_budget_is_found_among_refused_fits_too(
    virtual_board: Board, calibrator: str
) -> None:
    upload_points(virtual_board, half_a_sphere(24))
    by_effort = {}
    for points in range(9, 25):
        last = effort_curve(virtual_board, calibrator, points=points)[-1]
        by_effort[points] = last.cycles
    for budget in sorted(by_effort.values()):
        largest = max(effort for effort, cycles in by_effort.items() if cycles <= budget)
        result = largest_effort_within(virtual_board, calibrator, cycles=budget, points=24)
        assert (result.effort, result.cycles) == (largest, by_effort[largest])


def test_a_stream_that_refuses_a_point_has_no_effort_beyond_it(virtual_board: Board) -> None:
    cloud = golden_points(POINTS)[evenly_spread(POINTS)].copy()
    cloud[25] = cloud[0] + 2048  # a count beyond what the exact sums have room for
    upload_points(virtual_board, cloud)
    curve = effort_curve(virtual_board, "direct-stream", points=POINTS)
    best = largest_effort_within(virtual_board, "direct-stream", cycles=10**9, points=POINTS)
    assert curve[-1].effort == best.effort == 25
    assert curve[-1].cycles == best.cycles


def test_a_budget_for_nothing_is_refused_with_both_numbers(virtual_board: Board) -> None:
    with pytest.raises(CalibrationError, match=r"takes \d+ cycles with 1 sweeps, more than the budget of 7640"):
        largest_effort_within(virtual_board, "iterative", cycles=7640, points=POINTS)


def test_too_few_points_for_any_effort_are_no_effort(virtual_board: Board) -> None:
    with pytest.raises(CalibrationError, match="direct fits no calibration to 8 points"):
        largest_effort_within(virtual_board, "direct", cycles=10**9, points=8)
