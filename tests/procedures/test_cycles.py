"""Cycles: a line by least squares, and what the board counts on golden clouds."""

from __future__ import annotations

import pytest
from hypothesis import given
from hypothesis import strategies as st

from hiltest.boards import Board
from hiltest.procedures import FAST, measure_cycles, measure_fast_fit
from hiltest.procedures.cycles import fit_line


def test_a_line_by_hand() -> None:
    # Through (0, 1), (1, 2), (2, 6): slope 5/2, intercept 1/2, residuals 1/2, -1, 1/2.
    line = fit_line([0, 1, 2], [1, 2, 6])
    assert line.slope == pytest.approx(2.5)
    assert line.intercept == pytest.approx(0.5)
    assert line.residual == pytest.approx((1.5 / 3) ** 0.5)


@given(slope=st.integers(-1000, 1000), intercept=st.integers(-100_000, 100_000))
def test_an_exact_line_leaves_nothing(slope: int, intercept: int) -> None:
    line = fit_line([20, 60, 300], [slope * x + intercept for x in (20, 60, 300)])
    # Products up to 3e5: double rounding is below 1e-9 of them.
    assert line.slope == pytest.approx(slope, abs=1e-6)
    assert line.intercept == pytest.approx(intercept, abs=1e-6)
    assert line.residual == pytest.approx(0.0, abs=1e-6)


@pytest.mark.parametrize(("x", "y"), [([5, 5], [1, 2]), ([1], [1]), ([1, 2], [1, 2, 3])])
def test_a_line_needs_two_places(x: list[int], y: list[int]) -> None:
    with pytest.raises(ValueError, match="two different x"):
        fit_line(x, y)


def test_the_board_counts_every_calibrator_on_the_same_clouds(virtual_board: Board) -> None:
    messages: list[tuple[int, int]] = []
    costs = measure_cycles(
        virtual_board,
        ["direct", "direct-fast", "corrected", "iterative"],
        point_sets=3,
        sizes=(20, 100, 300),
        progress=lambda _, done, of: messages.append((done, of)),
    )
    direct, fast, corrected, iterative = costs.values()
    assert fast.total < corrected.total < direct.total < iterative.total
    assert direct.cycles[1] == direct.total
    assert direct.per_point * 100 + direct.fixed == pytest.approx(direct.total, rel=0.01)  # it is nearly a line
    assert (direct.iterations, corrected.iterations, iterative.iterations > 2) == (0, 2, True)
    assert direct.per_iteration is None
    assert direct.no_per_iteration == "it took no iterations, but the cost of one needs two"
    assert corrected.no_per_iteration == iterative.no_per_iteration == ""
    assert [bool(cost.no_sweeps) for cost in costs.values()] == [True, True, True, False]
    assert corrected.per_iteration is not None
    # Below 50 points it makes no step, and the line is not drawn through what it costs there.
    assert corrected.regression_residual == pytest.approx(0.0, abs=1e-6)
    # Two steps are all that it has beyond `direct-fast`: the first does not call less than the second.
    assert corrected.cycles[1:] - fast.cycles[1:] == pytest.approx(2 * corrected.per_iteration, rel=0.1)
    assert [cost.is_mostly_iterations for cost in costs.values()] == [False, False, False, True]
    # A sweep more or less on another cloud is not what a point costs: the line is drawn at one sweep, and is one then.
    assert iterative.per_point == pytest.approx(direct.per_point, rel=0.01)
    assert iterative.per_iteration is not None
    parts = 100 * iterative.per_point + iterative.fixed + iterative.iterations * iterative.per_iteration
    assert parts == pytest.approx(iterative.total, rel=0.005)
    assert iterative.regression_residual < 33  # what one of Newton's steps to the matrix' square root takes
    assert direct.model == iterative.model == virtual_board.cycle_model
    assert direct.instructions is not None
    # A Cortex-M4 executes at most one instruction a cycle.
    assert 0 < direct.instructions < direct.total
    assert direct.spread <= iterative.spread
    assert messages[0] == (0, 5)
    assert messages[-1] == (5, 5)


def test_counting_again_gives_the_same_number(virtual_board: Board) -> None:
    first, second = (
        measure_cycles(virtual_board, ["direct"], point_sets=1, sizes=(20, 100))["direct"].cycles.tolist()
        for _ in range(2)
    )
    assert first == second


def test_the_fast_fit_is_near_float64_and_storing_its_points_costs_less_than_it_saves(virtual_board: Board) -> None:
    costs = measure_cycles(virtual_board, [FAST, "direct"], point_sets=1, sizes=(20, 100))
    fast = measure_fast_fit(virtual_board)
    assert 0.0 < fast.distance_deg < 0.01  # its sums are rounded; the suite's own limit
    assert 0.0 < fast.store_per_point < (costs["direct"].total - costs[FAST].total) / 100
