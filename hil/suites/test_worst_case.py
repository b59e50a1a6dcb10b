"""Worst cases: the inputs in `worst`, found by searches, are measured again. The board's points are replaced."""

from __future__ import annotations

from pathlib import Path

import pytest

from hiltest.boards import Board
from hiltest.calibration.fit import FitStatus
from hiltest.link.messages import Calibrate
from hiltest.procedures import upload_points
from hiltest.session.fixtures import Cycles, Measure
from hiltest.studies.worst_case import WorstCase, load_worst_case
from hiltest.virtual.profiling.arguments import parse_argument

pytestmark = pytest.mark.hil

WORST_CASES = Path(__file__).with_name("worst")


def measure_points(case: WorstCase, board: Board, measure: Measure) -> None:
    """Calibrate from the points of a worst case, and record the cycles."""
    upload_points(board, case.counts)
    reply = board.timed(Calibrate(len(case.points), case.function), case.function)
    if reply.cost is None:
        pytest.skip("this core counts no cycles")
    measure(
        f"cycles.{case.function}.worst_found",
        reply.cost.cycles if reply.fit is FitStatus.ELLIPSOID else None,
        "cycle",
        cycle_model=board.cycle_model,
        band=board.cycle_range(reply.cost, case.function),
        not_offered=""
        if reply.fit is FitStatus.ELLIPSOID
        else f"the firmware refuses the points ({reply.fit.name}): search again with hiltest profile worst "
        f"{case.function}",
        note=f"{len(case.points)} points, found in {case.calls} calls",
    )


def test_the_worst_cases_that_were_found(
    board: Board, tested_calibrators: list[str], cycles: Cycles, measure: Measure
) -> None:
    for file in sorted(WORST_CASES.glob("*.json")):
        case = load_worst_case(file)
        if case.function in tested_calibrators:
            measure_points(case, board, measure)
        elif case.arguments and board.executes_firmware:
            profile = cycles().call(case.function, *map(parse_argument, case.arguments))
            measure(f"cycles.{case.function}.worst_found", profile, note=f"found in {case.calls} calls")
