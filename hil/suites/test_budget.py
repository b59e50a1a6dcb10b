"""Heading error against cycle budget: every calibrator with more and more effort, on the same points."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
import pytest

from hiltest.boards import Board
from hiltest.errors import CalibrationError
from hiltest.procedures import (
    UNCALIBRATED,
    CalibratorRun,
    Effort,
    Progress,
    RequestedAngles,
    Tumble,
    effort_curve,
    evenly_spread,
    heading_errors_deg,
    largest_effort_within,
    upload_points,
)
from hiltest.session.fixtures import Measure

pytestmark = [pytest.mark.hil, pytest.mark.full]

# The sizes that the thesis compares calibrators at. All of the tumble comes beside them: a streaming calibrator
# may want more points before it calibrates at all.
SIZES = (30, 100)


def thesis_cycles(points: int) -> int:
    """Return what the thesis says that its own calibrator takes."""
    return 168 * points + 2600


@pytest.fixture(scope="module")
def calibrators(board: Board) -> tuple[str, ...]:
    return (*board.identity.calibrators, *board.identity.stream_calibrators)


@pytest.fixture(scope="module")
def sizes(tumble: Tumble) -> tuple[int, ...]:
    return tuple(sorted({size for size in SIZES if size < len(tumble.points)} | {len(tumble.points)}))


@pytest.fixture(scope="module")
def efforts(
    board: Board,
    tumble: Tumble,
    calibrations: Mapping[str, CalibratorRun],
    known_angles: RequestedAngles,
    sizes: tuple[int, ...],
    calibrators: tuple[str, ...],
    hil_progress: Progress,
) -> list[Effort]:
    """All curves. The hundred points are the tumble's first, in an order that mixes them well; then come the others."""
    first, others = np.split(tumble.points, [max(SIZES)])
    upload_points(board, np.concatenate([each[evenly_spread(len(each))] for each in (first, others)]))
    work = [(size, name) for size in sizes for name in calibrators]
    found = []
    for done, (size, name) in enumerate(work):
        hil_progress("effort curves", done, len(work))
        found += effort_curve(board, name, points=size)
    hil_progress("effort curves", len(work), len(work))
    return found


def test_error_against_budget(efforts: list[Effort], known_angles: RequestedAngles, measure: Measure) -> None:
    measure.table(
        "budget.curve",
        {"calibrator": "", "points": "", "kind": "", "effort": "", "cycles": "cycle", "fit": ""}
        | {"sphere": "", "mean_error": "deg", "max_error": "deg"},
        [
            [
                effort.calibrator,
                effort.points,
                str(effort.kind),
                effort.effort,
                effort.cycles,
                effort.fit.status.name,
                effort.fit.is_sphere,
                *mean_and_max_deg(known_angles, effort),
            ]
            for effort in efforts
        ],
    )


def test_error_within_the_budget_of_the_thesis(
    board: Board,
    efforts: list[Effort],
    sizes: tuple[int, ...],
    calibrators: tuple[str, ...],
    known_angles: RequestedAngles,
    measure: Measure,
) -> None:
    unit = {effort.calibrator: effort.kind.unit for effort in efforts}
    for size in sizes:
        for name in calibrators:
            try:
                best = largest_effort_within(board, name, cycles=thesis_cycles(size), points=size)
            except CalibrationError:
                best = None  # even its smallest effort costs more
            mean_deg = None if best is None else mean_and_max_deg(known_angles, best)[0]
            measure(f"budget.{name}@{size}.effort", best and best.effort, unit[name])
            measure(f"budget.{name}@{size}.mean_error", mean_deg, "deg")


def mean_and_max_deg(known_angles: RequestedAngles, effort: Effort) -> tuple[float | None, float | None]:
    """By the host, in float64, from the means that the board took: there are more efforts than slots."""
    errors = heading_errors_deg(known_angles, effort.fit, known_angles.accelerometer_fits[UNCALIBRATED])
    return (None, None) if errors is None else (float(np.abs(errors).mean()), float(np.abs(errors).max()))
