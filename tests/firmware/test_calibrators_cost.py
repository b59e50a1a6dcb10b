"""What the calibrators cost on the virtual board, in its cycle model `cortex-m4-trm/1`."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from ..instances import instance

SEEDS = range(1, 31)


def _points(seed: int, count: int = 100) -> np.ndarray:
    """A board tumbled all around in ordinary iron."""
    return instance(seed, count, stretch=0.1, covered=(1.0, 1.0)).points_counts


def test_direct_fits_100_points_in_12000_cycles(board_calibrators: Any) -> None:
    cycles = [board_calibrators.cost("direct", _points(seed)).cycles for seed in SEEDS]
    print(f"direct, n = 100, seeds {SEEDS}: {min(cycles)} to {max(cycles)} cycles")
    assert max(cycles) <= 12_000


def test_direct_takes_103_cycles_a_point_and_2000_besides(board_calibrators: Any) -> None:
    counts = range(20, 301, 20)
    cycles = [board_calibrators.cost("direct", _points(1, count)).cycles for count in counts]
    per_point, fixed = np.polyfit(counts, cycles, 1)
    print(f"direct: {per_point:.2f} a point, {fixed:.0f} fixed")
    assert per_point <= 103.0
    assert fixed <= 2000.0


def test_iterative_is_no_lame_horse(board_calibrators: Any) -> None:
    """157 230 instructions is what the public release 5.00 of the 10-element solver executes on 100 such points."""
    instructions = [board_calibrators.cost("iterative", _points(seed)).instructions for seed in SEEDS]
    print(f"iterative, n = 100, seeds {SEEDS}: {min(instructions)} to {max(instructions)} instructions")
    assert max(instructions) <= 157_230


def test_the_worst_refusal_costs_little_more_than_a_fit(board_calibrators: Any) -> None:
    """Bounded time: the sphere fallback adds at most a tenth."""
    cap = instance(1, covered=(0.1, 0.1)).points_counts
    assert board_calibrators.cost("direct", cap).cycles <= 12_000


@pytest.mark.parametrize("count", [1, 8])
def test_too_few_points_cost_next_to_nothing(board_calibrators: Any, count: int) -> None:
    assert board_calibrators.cost("direct", _points(1)[:count]).cycles < 200


def test_the_empty_call_is_a_return(board_calibrators: Any) -> None:
    assert board_calibrators.cost("empty", _points(1)).instructions == 1
