"""Cycles of the calibrators on golden points, which are the same on every host and board."""

from __future__ import annotations

import warnings
from collections.abc import Collection
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
import pytest
from numpy.typing import NDArray

from hiltest.boards import Board
from hiltest.calibration import REFERENCES
from hiltest.calibration.accelerometer import NOMINAL
from hiltest.calibration.quality import direction_difference_rms_deg
from hiltest.errors import ConfigError
from hiltest.link.dpi import FitDpi
from hiltest.link.messages import Calibrate
from hiltest.link.replies import CalibrateReply, RunCost
from hiltest.link.streams import MAX_FEED, StreamFeed, StreamRemove, StreamReset
from hiltest.procedures import (
    DPI,
    FAST,
    JOINT,
    UNCALIBRATED_SLOT,
    golden_pairs,
    golden_points,
    run_streams,
    store_accelerometer,
    upload_pairs,
    upload_points,
)
from hiltest.procedures.calibrate import fit_of
from hiltest.session.benchmark_hooks import BenchmarkCycles
from hiltest.session.fixtures import Cycles
from hiltest.virtual.calls.buffers import Address, Structure
from hiltest.virtual.calls.procedure_call import Argument
from hiltest.virtual.counts.profiling import CallProfile
from hiltest.virtual.profiling.image import ProfiledImage

pytestmark = pytest.mark.hil

# Tests are collected before the board reports its calibrators; a warning names those missing here.
CALIBRATORS = (
    "direct",
    "direct-fast",
    "corrected",
    "iterative",
    "inverse-iteration",
    "li",
    "gauss-newton",
    "gradient-descent",
)
STREAMS = ("direct-stream", "iterative-stream")
SIZES = (30, 100, 300)
PAIRS = (300, 500)  # 300 is the fewest that the firmware fits
ROUNDS = 5  # number of point sets


@dataclass
class Runs:
    """Cycles of a calibrator for each point set, and its distances from float64 [deg]."""

    costs: list[RunCost | None] = field(default_factory=list)
    distances_deg: list[float] = field(default_factory=list)

    def add(self, reply: CalibrateReply, name: str, points: NDArray[np.int16]) -> None:
        """Add a run. Other points than the golden ones give larger distances: firmware_stub/DESIGN.md."""
        fit = fit_of(reply)
        self.costs.append(reply.cost)
        if name in REFERENCES and fit.has_fit:
            self.distances_deg.append(direction_difference_rms_deg(fit, REFERENCES[name](points)))

    @property
    def worst_deg(self) -> float | None:
        """Largest distance from float64; None for a calibrator without a reference."""
        return max(self.distances_deg, default=None)

    def show(self, kernel: str, benchmark_cycles: BenchmarkCycles, board: Board) -> None:
        """Show the cycles with the accuracy."""
        benchmark_cycles(
            kernel, counted_cycles(self.costs), cycle_model=board.cycle_model, from_float64_deg=self.worst_deg
        )


@pytest.fixture(scope="module")
def runs(board: Board, request: pytest.FixtureRequest) -> dict[str, Runs]:
    """Runs of every calibrator."""
    size: int = request.param
    runs = {name: Runs() for name in board.identity.calibrators}
    for index in range(ROUNDS):
        points = golden_points(size, index=index)
        upload_points(board, points)
        for name, calibrator_runs in runs.items():
            calibrator_runs.add(board.timed(Calibrate(size, name), name), name, points)
    warn_about_missing(board.identity.calibrators, CALIBRATORS, "CALIBRATORS")
    return runs


@pytest.mark.parametrize("runs", SIZES, indirect=True)
@pytest.mark.parametrize("calibrator", CALIBRATORS)
def test_calibrator(board: Board, runs: dict[str, Runs], calibrator: str, benchmark_cycles: BenchmarkCycles) -> None:
    if calibrator not in runs:
        pytest.skip(f"this firmware has no calibrator {calibrator!r}")
    runs[calibrator].show(calibrator, benchmark_cycles, board)


def test_newton_step(board: Board, benchmark_cycles: BenchmarkCycles) -> None:
    """Cycles of the second step: two steps less one, on the same points."""
    if "corrected" not in board.identity.calibrators:
        pytest.skip("this firmware has no calibrator 'corrected'")
    steps = []
    for index in range(ROUNDS):
        upload_points(board, golden_points(100, index=index))
        costs = [board.timed(Calibrate(100, "corrected", iterations=count), "corrected").cost for count in (1, 2)]
        one, two = counted_cycles(costs)
        steps.append(two - one)
    benchmark_cycles("step of corrected", steps, cycle_model=board.cycle_model)


@pytest.mark.parametrize(("runs", "size"), [(100, 100), (300, 300)], indirect=["runs"])
def test_accumulation(runs: dict[str, Runs], size: int, cycles: Cycles, benchmark_cycles: BenchmarkCycles) -> None:
    """The sums of `direct-fast` alone, called on another virtual board, with the accuracy of the whole fit."""
    if FAST not in runs:
        pytest.skip(f"this firmware has no calibrator {FAST!r}")
    counts, sums = np.ascontiguousarray(golden_points(size), "<i2"), bytearray(140)
    low, high = counts.min(axis=0), counts.max(axis=0)
    anchor = np.array((low.astype(int) + high) // 2, "<i4")
    points = Structure(Address(counts), np.array([size], "<u2"), low, high, np.zeros(1, "<u2"))
    profile = call(cycles(), "packed_moments_sum", points, anchor, sums)
    assert np.frombuffer(sums, "<f4")[0] == size
    benchmark_cycles(f"sums of {FAST}", profile, from_float64_deg=runs[FAST].worst_deg)


@pytest.mark.parametrize("pairs", PAIRS)
def test_against_gravity(board: Board, pairs: int, benchmark_cycles: BenchmarkCycles) -> None:
    store_accelerometer(board, NOMINAL, [UNCALIBRATED_SLOT])  # an earlier suite may have stored another calibration
    costs = []
    for index in range(2):
        upload_pairs(board, *golden_pairs(pairs, index=index))
        costs.append(board.session.request(FitDpi(pairs, UNCALIBRATED_SLOT)).cost)
    benchmark_cycles(DPI, counted_cycles(costs), cycle_model=board.cycle_model)


@pytest.mark.parametrize("pairs", [100, 300])
def test_norms_and_gravity_together(board: Board, pairs: int, benchmark_cycles: BenchmarkCycles) -> None:
    store_accelerometer(board, NOMINAL, [UNCALIBRATED_SLOT])
    costs = []
    for index in range(2):
        upload_pairs(board, *golden_pairs(pairs, index=index))
        costs.append(board.session.request(FitDpi(pairs, UNCALIBRATED_SLOT, is_joint=True)).cost)
    benchmark_cycles(JOINT, counted_cycles(costs), cycle_model=board.cycle_model)


@pytest.fixture(scope="module")
def streams(board: Board) -> dict[str, list[int]]:
    """Cycles of each streaming calibrator for each new point."""
    size = max(SIZES)
    upload_points(board, golden_points(size))
    runs = run_streams(board, size, stages=())
    warn_about_missing(board.identity.stream_calibrators, STREAMS, "STREAMS")
    if any(run.cycles is None for run in runs.values()):
        pytest.skip("this core counts no cycles")
    return {name: run.cycles.tolist() for name, run in runs.items() if run.cycles is not None}


@pytest.mark.parametrize("stream", [*STREAMS, *(f"{name}-sliced" for name in STREAMS)])
def test_new_point(board: Board, streams: dict[str, list[int]], stream: str, benchmark_cycles: BenchmarkCycles) -> None:
    if stream not in streams:
        pytest.skip(f"this firmware has no stream calibrator {stream!r}, or slicing does not change it")
    benchmark_cycles("new point of a stream", streams[stream], cycle_model=board.cycle_model)


def test_exact_remove(board: Board, benchmark_cycles: BenchmarkCycles) -> None:
    """Cycles of `direct-stream` for the exact removal of a point."""
    if "direct-stream" not in board.identity.stream_calibrators:
        pytest.skip("this firmware has no stream calibrator 'direct-stream'")
    upload_points(board, golden_points(MAX_FEED))
    board.session.request(StreamReset("direct-stream"))
    board.session.request(StreamFeed("direct-stream", 0, MAX_FEED))
    removed = board.session.request(StreamRemove("direct-stream", 0, MAX_FEED // 2))
    assert removed.taken == MAX_FEED // 2
    benchmark_cycles("exact remove", counted_cycles(list(removed.costs or [None])), cycle_model=board.cycle_model)


def call(firmware: ProfiledImage, function: str, *arguments: Argument) -> CallProfile:
    """Call a function, and skip the test if the firmware has no function of this name."""
    try:
        return firmware.call(function, *arguments)
    except ConfigError as error:
        if "no function" not in str(error):
            raise
        pytest.skip(str(error))


def warn_about_missing(names: Collection[str], listed: Collection[str], table: str) -> None:
    """Warn about names of the board that a table of this file does not list."""
    for name in sorted(set(names) - set(listed)):
        warnings.warn(f"{name} is in no table: add it to {table} in {Path(__file__).name}", stacklevel=2)


def counted_cycles(costs: list[RunCost | None]) -> list[int]:
    """Return the cycles, or skip the test if the core counts none."""
    if any(cost is None for cost in costs):
        pytest.skip("this core counts no cycles")
    return [cost.cycles for cost in costs if cost is not None]
