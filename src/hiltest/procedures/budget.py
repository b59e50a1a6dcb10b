"""The largest effort of a calibrator within a budget of clock cycles.

The effort of a calibrator is the quantity that it can reduce: the points of a closed form, the sweeps of an iterative
one, the received points of a streaming one. A closed form with a few further steps, such as `corrected`, also reduces
its points.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from enum import StrEnum
from itertools import accumulate

from hiltest.boards.board import Board
from hiltest.calibration.fit import ELLIPSOID_UNKNOWNS, MagnetometerFit
from hiltest.errors import CalibrationError
from hiltest.link.streams import StreamReset, StreamStatus
from hiltest.procedures.calibrate import calibrate_once
from hiltest.procedures.cycles import cycles_of, no_cycle_counter
from hiltest.procedures.streams import Fed, feed, stage

# Numbers of points of a curve: dense where the error falls.
_LADDER = (9, 10, 11, 12, 14, 16, 18, 20, 24, 28, 30, 35, 40, 50, 60, 70, 80, 90, 100, 120, 150, 200, 250)
# Numbers of sweeps of a curve; a descent takes hundreds.
_SWEEPS = (*range(1, 9), *_LADDER, 300, 400, 500, 700, 1000, 1500, 2000, 3000, 5000, 7000)
# Sweeps differ in cost, and a fit without an ellipsoid also costs its sphere: largest number of sweeps to try beyond
# the number that the mean cost allows.
_BEYOND_THE_MEAN = 4


class EffortKind(StrEnum):
    """Kind of effort that a calibrator can reduce."""

    POINTS = "points"
    SWEEPS = "sweeps"
    POINTS_SO_FAR = "points so far"

    @property
    def unit(self) -> str:
        """Name of one unit of the effort."""
        return "sweep" if self is EffortKind.SWEEPS else "point"


@dataclass(frozen=True, slots=True, eq=False)
class Effort:
    """Result of a calibrator at a limited effort."""

    calibrator: str
    kind: EffortKind
    effort: int
    """Amount of that effort."""
    points: int
    """Points that were offered."""
    cycles: int
    """Core cycles that it took; for a stream, those of all points so far and of the answer."""
    fit: MagnetometerFit
    """Result, as the board computed it in float32 [counts]."""


def effort_curve(board: Board, calibrator: str, *, points: int) -> list[Effort]:
    """Run a calibrator with increasing effort on the first points of the board's buffer.

    Parameters
    ----------
    board
        Board with the points, in an order whose prefixes are all equally well spread.
    calibrator
        Name from the board's identity, streaming or not.
    points
        Number of points; the largest effort gets all of them.

    Raises
    ------
    DeviceError
        When the board's core counts no cycles.
    """
    scale = _scale(board, calibrator, points)
    ladder = _SWEEPS if scale.kind is EffortKind.SWEEPS else _LADDER
    efforts = sorted({effort for effort in ladder if effort < scale.largest} | {scale.largest})
    if scale.is_stream:
        return _stream_efforts(board, calibrator, efforts, points)
    return [_run(board, calibrator, scale, effort, points) for effort in efforts]


def largest_effort_within(board: Board, calibrator: str, *, cycles: int, points: int) -> Effort:
    """Run a calibrator with the largest effort whose measured cycles are within a budget.

    Parameters
    ----------
    board, calibrator, points
        See `effort_curve`.
    cycles
        The budget.

    Raises
    ------
    CalibrationError
        When even the cheapest effort costs more; the message has its cost.
    DeviceError
        When the board's core counts no cycles.
    """
    scale = _scale(board, calibrator, points)
    largest = _most_taken_within(board, calibrator, cycles, points) if scale.is_stream else scale.most_within(cycles)
    cheapest: Effort | None = None
    # Linear search from above, because a refused ellipsoid also costs its sphere fit, so that less effort may cost
    # more.
    for effort in range(largest, scale.smallest - 1, -1):
        tried = _run(board, calibrator, scale, effort, points)
        if tried.cycles <= cycles:
            return tried
        if cheapest is None or tried.cycles < cheapest.cycles:
            cheapest = tried
    if cheapest is None:
        raise CalibrationError(f"{calibrator} fits no calibration to {points} points")
    raise CalibrationError(
        f"{calibrator} takes {cheapest.cycles} cycles with {cheapest.effort} {scale.kind}, "
        f"more than the budget of {cycles}"
    )


@dataclass(frozen=True, slots=True)
class _Scale:
    """Range of a calibrator's effort; for sweeps also the cycles of the first, and the mean of each further one."""

    kind: EffortKind
    smallest: int
    largest: int
    once: int = 0
    per_sweep: float = 0.0

    @property
    def is_stream(self) -> bool:
        return self.kind is EffortKind.POINTS_SO_FAR

    def most_within(self, cycles: int) -> int:
        """Return an upper bound of the effort within a budget."""
        if self.kind is not EffortKind.SWEEPS:
            return self.largest
        further = max(0, int((cycles - self.once) / self.per_sweep))
        return min(self.largest, self.smallest + further + _BEYOND_THE_MEAN)


def _scale(board: Board, calibrator: str, points: int) -> _Scale:
    if calibrator in board.identity.stream_calibrators:
        return _Scale(EffortKind.POINTS_SO_FAR, 1, points)
    whole, cost = calibrate_once(board, calibrator, points)
    if whole.iterations > 1:
        _, least = calibrate_once(board, calibrator, points, iterations=1)
        once, all_of_them = cycles_of(least), cycles_of(cost)
        if 2 * once < all_of_them:  # most of its work is sweeps
            return _Scale(EffortKind.SWEEPS, 1, whole.iterations, once, (all_of_them - once) / (whole.iterations - 1))
    return _Scale(EffortKind.POINTS, ELLIPSOID_UNKNOWNS, points)


def _run(board: Board, calibrator: str, scale: _Scale, effort: int, points: int) -> Effort:
    if scale.is_stream:
        return _stream_efforts(board, calibrator, [effort], points)[0]
    if scale.kind is EffortKind.POINTS:
        fit, cost = calibrate_once(board, calibrator, effort)
    else:
        # The number of sweeps that it makes by itself is not a limit, because it still has to detect convergence.
        fit, cost = calibrate_once(board, calibrator, points, iterations=0 if effort == scale.largest else effort)
    return Effort(calibrator, scale.kind, effort, points, cycles_of(cost), fit)


def _stream_efforts(board: Board, calibrator: str, sizes: Sequence[int], points: int) -> list[Effort]:
    """Feed a streaming calibrator, and read its state whenever one of `sizes` is reached; they increase.

    A refused point ends the curve.
    """
    board.session.request(StreamReset(calibrator))
    efforts, spent, at = [], 0, 0
    for size in sizes:
        fed = feed(board, calibrator, at, size - at)
        spent += sum(_step_cycles(fed))
        at += fed.taken
        if fed.taken:
            asked = stage(board, calibrator, at)
            cycles = spent + cycles_of(asked.state.cost)
            efforts.append(Effort(calibrator, EffortKind.POINTS_SO_FAR, at, points, cycles, asked.fit))
        if fed.refused is not StreamStatus.OK:
            break
    return efforts


def _most_taken_within(board: Board, calibrator: str, cycles: int, points: int) -> int:
    """Return how many points a stream calibrator processes in `cycles`, without its answer; at least 1."""
    board.session.request(StreamReset(calibrator))
    fed = feed(board, calibrator, 0, points)
    spent = accumulate(_step_cycles(fed))
    return min(max(sum(total <= cycles for total in spent), 1), fed.taken)


def _step_cycles(fed: Fed) -> list[int]:
    if fed.costs is None:
        raise no_cycle_counter()
    return [cost.cycles for cost in fed.costs]
