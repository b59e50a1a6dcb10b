"""The calibrators on golden clouds, which are the same on every host and board."""

from __future__ import annotations

import warnings
from collections.abc import Collection
from pathlib import Path

import pytest

from hiltest.boards import Board
from hiltest.calibration.accelerometer import NOMINAL
from hiltest.cycle_benchmarks.hooks import BenchmarkCycles
from hiltest.link.dpi import FitDpi
from hiltest.link.messages import Calibrate
from hiltest.link.replies import RunCost
from hiltest.procedures import (
    DPI,
    UNCALIBRATED_SLOT,
    golden_cloud,
    golden_pairs,
    run_streams,
    store_accelerometer,
    upload_cloud,
    upload_pairs,
)

pytestmark = pytest.mark.hil

# Tables are made before the board says what it has; others that it has are named in a warning.
CALIBRATORS = ("direct", "direct-fast", "corrected", "iterative")
STREAMS = ("direct-stream", "iterative-stream")
SIZES = (30, 100, 300)
PAIRS = (300, 500)  # from the fewest that are fitted
ROUNDS = 5  # as many clouds


@pytest.fixture(scope="module")
def costs(board: Board, request: pytest.FixtureRequest) -> dict[str, list[RunCost | None]]:
    """What every calibrator took for so many points of each cloud."""
    size: int = request.param
    found: dict[str, list[RunCost | None]] = {name: [] for name in board.identity.calibrators}
    for index in range(ROUNDS):
        upload_cloud(board, golden_cloud(size, index=index))
        for name, each in found.items():
            each.append(board.session.request(Calibrate(size, name)).cost)
    warn_of_others(board.identity.calibrators, CALIBRATORS, "CALIBRATORS")
    return found


@pytest.mark.parametrize("costs", SIZES, indirect=True)
@pytest.mark.parametrize("calibrator", CALIBRATORS)
def test_calibrator(
    board: Board, costs: dict[str, list[RunCost | None]], calibrator: str, benchmark_cycles: BenchmarkCycles
) -> None:
    if calibrator not in costs:
        pytest.skip(f"this firmware has no calibrator {calibrator!r}")
    benchmark_cycles(calibrator, counted(costs[calibrator]), cycle_model=board.cycle_model)


@pytest.mark.parametrize("pairs", PAIRS)
def test_against_gravity(board: Board, pairs: int, benchmark_cycles: BenchmarkCycles) -> None:
    store_accelerometer(board, NOMINAL, [UNCALIBRATED_SLOT])  # a suite before may have stored what it measured
    costs = []
    for index in range(2):
        upload_pairs(board, *golden_pairs(pairs, index=index))
        costs.append(board.session.request(FitDpi(pairs, UNCALIBRATED_SLOT)).cost)
    benchmark_cycles(DPI, counted(costs), cycle_model=board.cycle_model)


@pytest.fixture(scope="module")
def streams(board: Board) -> dict[str, list[int]]:
    """What every stream calibrator took for each new point of a cloud."""
    size = max(SIZES)
    upload_cloud(board, golden_cloud(size))
    runs = run_streams(board, size, stages=())
    warn_of_others(board.identity.stream_calibrators, STREAMS, "STREAMS")
    if any(run.cycles is None for run in runs.values()):
        pytest.skip("this core counts no cycles")
    return {name: run.cycles.tolist() for name, run in runs.items() if run.cycles is not None}


@pytest.mark.parametrize("stream", [*STREAMS, *(f"{name}-sliced" for name in STREAMS)])
def test_new_point(
    board: Board, streams: dict[str, list[int]], stream: str, benchmark_cycles: BenchmarkCycles
) -> None:
    if stream not in streams:
        pytest.skip(f"this firmware has no stream calibrator {stream!r}, or it does the same unsliced")
    benchmark_cycles("new point of a stream", streams[stream], cycle_model=board.cycle_model)


def warn_of_others(there: Collection[str], listed: Collection[str], where: str) -> None:
    for name in sorted(set(there) - set(listed)):
        warnings.warn(f"{name} is in no table: put it into {where} of {Path(__file__).name}", stacklevel=2)


def counted(costs: list[RunCost | None]) -> list[int]:
    """Return the cycles, and skip the test where the core counts none."""
    if any(cost is None for cost in costs):
        pytest.skip("this core counts no cycles")
    return [cost.cycles for cost in costs if cost is not None]
