"""Cycles of each calibrator: total at n points, per point, fixed part, and spread."""

from __future__ import annotations

from collections.abc import Mapping

import pytest

from hiltest.boards import Board
from hiltest.boards.board import NO_REQUEST_COST
from hiltest.measurement import Limit
from hiltest.procedures import (
    DPI,
    FAST,
    JOINT,
    CycleCost,
    FastFit,
    Progress,
    measure_cycles,
    measure_dpi_cycles,
    measure_fast_fit,
)
from hiltest.rig import Rig
from hiltest.session.fixtures import Measure

pytestmark = pytest.mark.hil

# Largest distance from float64 of the fast calibrator on golden points, which are spread evenly: typically 0.002 deg,
# and 0.004 at most over 30 sets. A larger distance shows different arithmetic, not different points.
DISTANCE = Limit(max=0.01)
# Other points give larger distances: firmware_stub/DESIGN.md has those of 10 000 random point sets.
# Cycles of a request outside the timed calibration: frame, dispatch, the empty call and the reply take 3 400 to 4 400.
OUTSIDE_AT_MOST = 6_000
EVEN = "points spread evenly; 1 random set in 100 exceeds 0.06 to 0.18 deg"


@pytest.fixture(scope="module")
def costs(board: Board, tested_calibrators: list[str], rig: Rig, hil_progress: Progress) -> Mapping[str, CycleCost]:
    """Cycles on golden points, which are the same on every host and board."""
    return measure_cycles(board, tested_calibrators, n=rig.procedure.calibration_points, progress=hil_progress)


@pytest.fixture(scope="module")
def fast(board: Board, rig: Rig) -> FastFit:
    """Distance of the fast calibrator from float64 on golden points; only for firmware that has this calibrator."""
    return measure_fast_fit(board, n=rig.procedure.calibration_points)


def measure_cost(name: str, cost: CycleCost, measure: Measure) -> None:
    """Record the cost at the rig's number of points, and the line fitted over other numbers of points."""
    measure(
        f"cycles.{name}.total", cost.total, "cycle", cycle_model=cost.model, band=cost.band, not_checked=cost.unchecked
    )
    measure(
        f"cycles.{name}.request",
        cost.request,
        "cycle",
        cycle_model=cost.model,
        not_offered="" if cost.request is not None else NO_REQUEST_COST,
    )
    for part, cycles in (
        ("per_point", cost.per_point),
        ("fixed", cost.fixed),
        ("regression_residual", cost.regression_residual),
        ("spread", cost.spread),
    ):
        measure(f"cycles.{name}.{part}", cycles, "cycle", cycle_model=cost.model)


def refuse_work_outside_the_timer(costs: Mapping[str, CycleCost]) -> None:
    """Fail if a request takes much more than the calibration that the firmware has timed within it."""
    outside = {name: cost.request - cost.total for name, cost in costs.items() if cost.request is not None}
    moved = [f"{name} {cycles}" for name, cycles in outside.items() if cycles > OUTSIDE_AT_MOST]
    assert not moved, (
        f"work outside the timer: cycles of the request beside the timed calibration, at most {OUTSIDE_AT_MOST}: "
        f"{', '.join(moved)}"
    )


def test_cycles_of_every_calibrator(
    costs: Mapping[str, CycleCost], measure: Measure, request: pytest.FixtureRequest
) -> None:
    """One test for all, so that the fast calibrator's cycles never appear without its accuracy and cost of storing."""
    for name, cost in costs.items():
        measure_cost(name, cost, measure)
        measure(
            f"cycles.{name}.per_iteration",
            cost.per_iteration,
            "cycle",
            cycle_model=cost.model,
            not_offered=cost.no_per_iteration,
        )
    refuse_work_outside_the_timer(costs)
    if FAST in costs:
        # Requested last: if it fails, the costs of the other calibrators are already recorded.
        fast: FastFit = request.getfixturevalue("fast")
        measure(f"cycles.{FAST}.float64_distance", fast.distance_deg, "deg", limit=DISTANCE, note=EVEN)
        measure(f"cycles.{FAST}.store_per_point", fast.store_per_point, "cycle", cycle_model=costs[FAST].model)


def test_instructions_of_every_calibrator(costs: Mapping[str, CycleCost], measure: Measure) -> None:
    for name, cost in costs.items():
        measure(f"cycles.{name}.instructions", cost.instructions, "instruction")
        sweeps = cost.iterations if cost.is_mostly_iterations else None
        per_sweep = cost.instructions / sweeps if cost.instructions is not None and sweeps else None
        measure(f"cycles.{name}.sweeps", sweeps, "", not_offered=cost.no_sweeps)
        measure(f"cycles.{name}.instructions_per_sweep", per_sweep, "instruction", not_offered=cost.no_sweeps)


def test_cycles_over_the_number_of_points(costs: Mapping[str, CycleCost], measure: Measure) -> None:
    sizes = next(iter(costs.values())).sizes.tolist()
    measure.table(
        "cycles.sizes",
        {"n": ""} | dict.fromkeys(costs, "cycle"),
        zip(sizes, *(cost.cycles.tolist() for cost in costs.values()), strict=True),
    )


@pytest.mark.parametrize("name", [JOINT, pytest.param(DPI, marks=pytest.mark.full)])
def test_cycles_of_the_calibrations_against_gravity(
    board: Board, rig: Rig, measure: Measure, hil_progress: Progress, name: str
) -> None:
    if rig.procedure.dpi == "none":
        pytest.skip("the rig's [procedure] has no calibration against gravity")
    cost = measure_dpi_cycles(board, is_joint=name == JOINT, progress=hil_progress)
    measure_cost(name, cost, measure)
    measure(f"cycles.{name}.instructions", cost.instructions, "instruction")
    refuse_work_outside_the_timer({name: cost})
