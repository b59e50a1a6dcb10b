"""Feed the points of a tumble to the streaming calibrators, one after the other."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from hiltest.boards.board import Board, StepRecorder
from hiltest.calibration.fit import MagnetometerFit
from hiltest.errors import DeviceError
from hiltest.link.messages import SetCalibration
from hiltest.link.replies import RunCost, Status
from hiltest.link.streams import (
    MAX_FEED,
    StreamFeed,
    StreamRemove,
    StreamReset,
    StreamState,
    StreamStateReply,
    StreamStatus,
)
from hiltest.measurement import CycleRange
from hiltest.procedures.calibrate import fit_of
from hiltest.procedures.progress import Progress, silent

_TAKEN_BACK = 20  # enough to show whether the cost depends on the data
#: Numbers of points at which a stream calibrator is asked for its result, besides the end.
STAGES = (100, 150, 250)


@dataclass(frozen=True, slots=True, eq=False)
class StreamStage:
    """Result of a stream calibrator after a number of points."""

    points: int
    """Number of points so far."""
    state: StreamStateReply
    fit: MagnetometerFit
    """Its calibration, as the board computed it in float32 [counts]."""


class Fed(NamedTuple):
    """Points that a stream calibrator took, and their costs."""

    taken: int
    """Points taken."""
    costs: list[RunCost] | None
    """One cost per point; None without a cycle counter."""
    refused: StreamStatus
    """OK if all points were taken, otherwise the reason why the next one was not."""


@dataclass(frozen=True, slots=True, eq=False)
class StreamRun:
    """A stream calibrator over all points of a tumble."""

    name: str
    """Name of the calibrator; with ``-sliced`` if its solvers did one slice of work per point."""
    cycles: NDArray[np.int64] | None
    """Shape (n,), or None. Cycles of each new point, in order; None without a cycle counter."""
    stages: tuple[StreamStage, ...]
    """Results at `STAGES`, and at the end."""
    refused: StreamStatus
    """OK if all points were taken, otherwise the reason why the next one was not."""
    fit_range: CycleRange | None
    """Uncertainty range of the cycles of the last stage's answer; None if unknown."""
    total_range: CycleRange | None = None
    """Uncertainty range of all of `cycles` and the last stage's answer together."""
    remove_cycles: NDArray[np.int64] | None = None
    """Cycles of the removal of each of the first points at the end; None if it removes none, or without a cycle
    counter. A sliced run removes none, because that would be the same work."""

    @property
    def last(self) -> StreamStage:
        """Result after all points."""
        return self.stages[-1]

    @property
    def total(self) -> int | None:
        """Cycles of all points and of the final answer; None without a cycle counter."""
        if self.cycles is None or self.last.state.cost is None:
            return None
        return int(self.cycles.sum()) + self.last.state.cost.cycles


def run_streams(
    board: Board, points: int, *, stages: Sequence[int] = STAGES, progress: Progress | None = None
) -> dict[str, StreamRun]:
    """Run every stream calibrator of the firmware over the first points of the board's buffer.

    Parameters
    ----------
    board
        Board with the points. Its slots do not change.
    points
        Number of points for each calibrator.
    stages
        Numbers of points at which to read the result, besides the end.

    Returns
    -------
    dict of str to StreamRun
        Runs by name: first with the solvers' work done at once, then, as ``<name>-sliced``, with one slice per point,
        if that differs. A calibrator without slices does identical work both times, and appears once.
    """
    tell = progress or silent
    runs: dict[str, StreamRun] = {}
    names = board.identity.stream_calibrators
    for done, name in enumerate(names):
        tell(f"stream {name}", done, len(names))
        whole, sliced = (_run(board, name, points, stages, sliced=sliced) for sliced in (False, True))
        runs[name] = whole
        if _differs(whole, sliced):
            runs[sliced.name] = sliced
    tell("streams", len(names), len(names))
    return runs


def store_streams(board: Board, runs: dict[str, StreamRun], *, first_slot: int) -> dict[str, int]:
    """Store the last calibration of each run in a slot, as far as there are slots; return the slots by name."""
    usable = [(name, run) for name, run in runs.items() if run.last.fit.has_fit]
    slots = {}
    for slot, (name, run) in zip(range(first_slot, board.identity.slots), usable, strict=False):
        board.session.request(SetCalibration(slot, run.last.fit.soft_iron, run.last.fit.hard_iron))
        slots[name] = slot
    return slots


def feed(board: Board, name: str, first: int, count: int, steps: StepRecorder | None = None) -> Fed:
    """Feed points of the board's buffer to a streaming calibrator until one is refused; `steps` records executions."""
    count_taken = 0
    costs: list[RunCost] | None = []
    for at in range(first, first + count, MAX_FEED):
        reply = board.timed_each(StreamFeed(name, at, min(MAX_FEED, first + count - at)), f"{name}.add")
        count_taken += reply.taken
        costs = None if costs is None or reply.costs is None else costs + list(reply.costs)
        if steps and reply.costs:
            steps.add([cost.cycles for cost in reply.costs], reply.costs[0].overhead_cycles)
        if reply.status is not StreamStatus.OK:
            return Fed(count_taken, costs, reply.status)
    return Fed(count_taken, costs, StreamStatus.OK)


def stage(board: Board, name: str, points: int) -> StreamStage:
    """Read the state of a streaming calibrator after `points` points."""
    state = board.timed(StreamState(name), f"{name}.report")
    return StreamStage(points, state, fit_of(state))


def _run(board: Board, name: str, points: int, stages: Sequence[int], *, sliced: bool) -> StreamRun:
    board.session.request(StreamReset(name, sliced=sliced))
    cycles: list[int] | None = []
    results: list[StreamStage] = []
    at, refused = 0, StreamStatus.OK
    steps = board.timed_steps()
    for end in sorted({size for size in stages if size < points} | {points}):
        count_taken, costs, refused = feed(board, name, at, end - at, steps)
        cycles = None if cycles is None or costs is None else cycles + [cost.cycles for cost in costs]
        at += count_taken
        results.append(stage(board, name, at))
        if refused is not StreamStatus.OK:
            break
    cost = results[-1].state.cost
    fit_range = board.cycle_range(cost)
    if steps and cost:
        steps.add([cost.cycles], cost.overhead_cycles)
    return StreamRun(
        f"{name}-sliced" if sliced else name,
        None if cycles is None else np.array(cycles),
        tuple(results),
        refused,
        fit_range,
        steps.band() if steps else None,
        None if sliced else _take_back(board, name, min(at, _TAKEN_BACK)),
    )


def _take_back(board: Board, name: str, count: int) -> NDArray[np.int64] | None:
    """Remove the first points, as a sliding window does; return the cycles of each."""
    if not count:
        return None
    try:
        reply = board.timed_each(StreamRemove(name, 0, count), f"{name}.remove")
    except DeviceError as error:
        if error.status != Status.NOT_SUPPORTED.name:
            raise
        return None
    return np.array([cost.cycles for cost in reply.costs]) if reply.costs else None


def _differs(whole: StreamRun, sliced: StreamRun) -> bool:
    if whole.cycles is None or sliced.cycles is None:
        return True  # unknown, so both are shown
    return not np.array_equal(whole.cycles, sliced.cycles)
