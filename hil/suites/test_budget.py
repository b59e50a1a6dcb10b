"""Heading error over cycle budget: each calibrator with increasing effort, on the same points."""

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

# Numbers of points in the thesis' comparison. The whole tumble is added, because a streaming calibrator may need more
# points before its first calibration.
SIZES = (30, 100)


def thesis_cycles(points: int) -> int:
    """Return the cycles of the thesis' own calibrator."""
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
    """All curves. The tumble's first hundred points precede the others; within each part points are evenly spread."""
    parts = np.split(tumble.points, [max(SIZES)])
    upload_points(board, np.concatenate([part[evenly_spread(len(part))] for part in parts]))
    work = [(size, name) for size in sizes for name in calibrators]
    curves = []
    for done, (size, name) in enumerate(work):
        hil_progress("effort curves", done, len(work))
        curves += effort_curve(board, name, points=size)
    hil_progress("effort curves", len(work), len(work))
    return curves


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
                best = None  # its smallest effort exceeds the budget
            mean_deg = None if best is None else mean_and_max_deg(known_angles, best)[0]
            measure(f"budget.{name}@{size}.effort", best and best.effort, unit[name])
            measure(f"budget.{name}@{size}.mean_error", mean_deg, "deg")


def mean_and_max_deg(known_angles: RequestedAngles, effort: Effort) -> tuple[float | None, float | None]:
    """Return errors that the host computes in float64 from the board's means: there are more efforts than slots."""
    errors = heading_errors_deg(known_angles, effort.fit, known_angles.accelerometer_fits[UNCALIBRATED])
    return (None, None) if errors is None else (float(np.abs(errors).mean()), float(np.abs(errors).max()))
