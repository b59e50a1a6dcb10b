"""Cycles of a calibrator: at n points, per point, fixed, and their spread."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace

import numpy as np
from numpy.typing import ArrayLike, NDArray

from hiltest.boards.board import Board
from hiltest.errors import DeviceError
from hiltest.link.messages import MAX_UPLOAD, MAX_UPLOAD_PAIRS, Calibrate, ClearPoints, Upload
from hiltest.link.replies import CycleSource, RunCost, Status
from hiltest.measurement import CycleRange
from hiltest.procedures.golden_points import golden_points
from hiltest.procedures.progress import Progress, silent

Ints = NDArray[np.int64]

REGRESSION_SIZES = (20, 60, 100, 140, 180, 220, 260, 300)


@dataclass(frozen=True, slots=True)
class CostLine:
    """A straight line through points, and the rms of its residuals."""

    slope: float
    intercept: float
    residual: float


@dataclass(frozen=True, slots=True)
class CountedRun:
    """One run of a calibrator: its cost, and its sweeps or iterations."""

    cost: RunCost
    iterations: int


@dataclass(frozen=True, slots=True, eq=False)
class CycleCost:
    """Cost of one calibrator on golden points."""

    calibrator: str
    model: str
    """Cycle model. Counts of different models are never compared."""
    n: int
    """Number of points of `total` and `spread`."""
    total: int
    """Cycles at n points of golden point set 0."""
    per_point: float
    fixed: float
    regression_residual: float
    """Least-squares line of cycles over n, and the rms of its residuals; for a calibrator that makes its steps with n
    points, only over sizes at which it makes them too. The number of iterations depends more on the point set than on
    n: a calibrator with mostly iterations makes a single one at each size, and the line excludes it, so ``total`` is
    near ``per_point * n + fixed + per_iteration * iterations``."""
    spread: int
    """Largest minus smallest over the point sets, each at n points."""
    instructions: int | None
    """Instructions of the same run as `total`; None if they are not counted: "not offered"."""
    band: CycleRange | None
    """Uncertainty range of `total`; None if unknown."""
    iterations: int
    """Sweeps or steps of the same run as `total`, 0 for a closed form."""
    per_iteration: float | None
    """Cycles of one further iteration on the same points, the mean of all but the first; None with fewer than two."""
    sizes: Ints
    cycles: Ints
    """Shape (k,). Cycles of complete calls, each with the iterations that it needs."""
    request: int | None = None
    """Cycles of the request of `total`, from its last byte to the first byte of the reply, without sleep and
    interrupts; None if the board cannot observe them."""
    unchecked: str = ""
    """Reason why the board did not check the firmware's count; empty if it did, or does not execute the firmware."""

    @property
    def is_mostly_iterations(self) -> bool:
        """True if iterations are most of its cost, instead of a few steps after a closed form."""
        return _is_mostly_iterations(self.per_iteration, self.iterations, self.total)

    @property
    def no_per_iteration(self) -> str:
        """Reason why there is no `per_iteration`; empty when there is one."""
        if self.per_iteration is not None:
            return ""
        return (
            f"it took {self.iterations or 'no'} iteration{'s' * (self.iterations != 1)}, but the cost of one needs two"
        )

    @property
    def no_sweeps(self) -> str:
        """Reason why its iterations are not counted as sweeps; empty if they are most of its cost."""
        return "" if self.is_mostly_iterations else "its iterations are not most of what it costs"


@dataclass(slots=True)
class _Counted:
    """Counts of one calibrator: by size and point set, and of single iterations by size."""

    runs: dict[tuple[int, int], CountedRun] = field(default_factory=dict)
    once: dict[int, int] = field(default_factory=dict)
    instructions: int | None = None
    band: CycleRange | None = None
    per_iteration: float | None = None
    request: int | None = None


def fit_line(x: ArrayLike, y: ArrayLike) -> CostLine:
    """Fit a line by least squares.

    Raises
    ------
    ValueError
        When fewer than two different x are given.
    """
    xs, ys = np.asarray(x, dtype=np.float64), np.asarray(y, dtype=np.float64)
    if xs.shape != ys.shape or len(set(xs.tolist())) < 2:
        raise ValueError("a line needs two different x, and as many y as x")
    dx = xs - xs.mean()
    slope = float((dx * ys).sum() / (dx * dx).sum())
    intercept = float(ys.mean() - slope * xs.mean())
    residuals = ys - (slope * xs + intercept)
    return CostLine(slope, intercept, float(np.sqrt((residuals * residuals).mean())))


def upload_points(board: Board, points: NDArray[np.int16]) -> None:
    """Replace the board's point buffer by points, shape (n, 3) [counts]."""
    board.session.request(ClearPoints())
    for first in range(0, len(points), MAX_UPLOAD):
        board.session.request(Upload(first, points[first : first + MAX_UPLOAD].tolist()))


def upload_pairs(board: Board, points: NDArray[np.int16], accelerometer: NDArray[np.int16]) -> None:
    """Replace the board's point buffer by points with their accelerometer samples, each of shape (n, 3) [counts]."""
    board.session.request(ClearPoints())
    rows = np.column_stack([points, accelerometer])
    for first in range(0, len(rows), MAX_UPLOAD_PAIRS):
        board.session.request(Upload(first, rows[first : first + MAX_UPLOAD_PAIRS].tolist()))


def measure_cycles(
    board: Board,
    calibrators: Sequence[str],
    *,
    n: int = 100,
    point_sets: int = 100,
    sizes: Sequence[int] = REGRESSION_SIZES,
    progress: Progress | None = None,
) -> dict[str, CycleCost]:
    """Count the cycles of calibrators on golden points.

    Parameters
    ----------
    board
        Board whose point buffer is replaced.
    calibrators
        Names of calibrators; each runs on every uploaded point set.
    n
        Number of points of the total and of the spread.
    point_sets
        Number of point sets of the spread, at least 1.
    sizes
        Numbers of points of the regression.

    Raises
    ------
    DeviceError
        When the board's core has no cycle counter.

    Notes
    -----
    On a virtual board the firmware's reception of the points, 60 kB over its UART, takes more than half of the wall
    time. This cannot be reduced: the spread needs different points, and a real board receives them the same way.
    """
    if board.identity.cycle_source is CycleSource.NONE:
        raise no_cycle_counter()
    tell = progress or silent
    work = [(n, index) for index in range(point_sets)] + [(size, 0) for size in sizes if size != n]
    counted = {name: _Counted() for name in calibrators}
    for done, (size, index) in enumerate(work):
        tell("cycles", done, len(work))
        upload_points(board, golden_points(size, index=index))
        for name, counts in counted.items():
            run = counts.runs[size, index] = _count(board, size, name)
            if (size, index) == (n, 0):
                cost = board.request_cost()
                counts.request = None if cost is None else cost.awake_cycles
                counts.instructions = instructions_of(board, run.cost)
                counts.band = board.cycle_range(run.cost, name)
                counts.per_iteration = _per_iteration(board, size, name, run)
            whole = counts.runs[n, 0]
            if index == 0 and _is_mostly_iterations(counts.per_iteration, whole.iterations, whole.cost.cycles):
                counts.once[size] = _count(board, size, name, iterations=1).cost.cycles
    tell("cycles", len(work), len(work))
    return {name: _cost(board, name, n, sizes, counts) for name, counts in counted.items()}


def _is_mostly_iterations(per_iteration: float | None, iterations: int, total: int) -> bool:
    return per_iteration is not None and 2.0 * per_iteration * iterations > total


def _per_iteration(board: Board, n: int, calibrator: str, whole: CountedRun) -> float | None:
    if whole.iterations < 2:
        return None
    first = _count(board, n, calibrator, iterations=1)
    return (whole.cost.cycles - first.cost.cycles) / (whole.iterations - 1)


def _count(board: Board, n: int, calibrator: str, *, iterations: int = 0) -> CountedRun:
    reply = board.timed(Calibrate(n, calibrator, iterations=iterations), calibrator)
    if reply.cost is None:
        raise no_cycle_counter()
    return CountedRun(reply.cost, reply.iterations)


def cycles_of(cost: RunCost | None) -> int:
    """Return the cycles of a timed run; raise a DeviceError without a cycle counter."""
    if cost is None:
        raise no_cycle_counter()
    return cost.cycles


def no_cycle_counter() -> DeviceError:
    """Return the error for a required cycle count on a core without a counter."""
    return DeviceError(
        "CALIBRATE",
        Status.NO_CYCLE_COUNTER.name,
        "this core has no cycle counter, so the cost of a calibrator is unknown; run the other suites with: pytest "
        "hil/suites -k 'not cycles'",
    )


def instructions_of(board: Board, cost: RunCost) -> int | None:
    """Count the instructions of a timed run, minus those of the empty call."""
    whole = board.instructions_counted(cost.cycles + cost.overhead_cycles)
    empty = board.instructions_counted(cost.overhead_cycles)
    return None if whole is None or empty is None else whole - empty


def _cost(board: Board, name: str, n: int, sizes: Sequence[int], counted: _Counted) -> CycleCost:
    runs, per_iteration = counted.runs, counted.per_iteration
    at_n = [run.cost.cycles for (size, _), run in runs.items() if size == n]
    over_sizes = [runs[size, 0].cost.cycles for size in sizes]
    if counted.once and per_iteration is not None:
        line = _line_of_the_rest(sizes, [runs[size, 0] for size in sizes], counted.once, per_iteration)
    else:
        line = _line_where_steps_are_made(sizes, over_sizes, [runs[size, 0] for size in sizes], runs[n, 0])
    return CycleCost(
        calibrator=name,
        model=board.cycle_model,
        n=n,
        total=at_n[0],
        per_point=line.slope,
        fixed=line.intercept,
        regression_residual=line.residual,
        spread=max(at_n) - min(at_n),
        instructions=counted.instructions,
        band=counted.band,
        iterations=runs[n, 0].iterations,
        per_iteration=per_iteration,
        sizes=np.array(sizes),
        cycles=np.array(over_sizes),
        request=counted.request,
        unchecked=board.unchecked(name),
    )


def _line_of_the_rest(
    sizes: Sequence[int], runs: Sequence[CountedRun], once: Mapping[int, int], per_iteration: float
) -> CostLine:
    """Fit the line to runs with one iteration, minus that iteration."""
    of_sizes = [
        (run.cost.cycles - once[size]) / (run.iterations - 1)
        for size, run in zip(sizes, runs, strict=True)
        if run.iterations > 1
    ]
    if len(of_sizes) == len(sizes) and of_sizes[-1] > 2.0 * of_sizes[0]:  # an iteration goes over all points
        return fit_line(sizes, [once[size] - cycles for size, cycles in zip(sizes, of_sizes, strict=True)])
    line = fit_line(sizes, [once[size] for size in sizes])
    return replace(line, intercept=line.intercept - per_iteration)


def _line_where_steps_are_made(
    sizes: Sequence[int], cycles: Sequence[int], runs: Sequence[CountedRun], at_n: CountedRun
) -> CostLine:
    """Fit the line to comparable runs: without its steps, as with few points, a calibrator does other work."""
    alike = np.array([(run.iterations > 0) == (at_n.iterations > 0) for run in runs])
    if alike.sum() < 2:
        alike[:] = True
    return fit_line(np.array(sizes)[alike], np.array(cycles)[alike])
