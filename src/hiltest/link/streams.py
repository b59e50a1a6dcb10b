"""Requests and replies of streaming calibrators."""

from __future__ import annotations

from dataclasses import dataclass
from enum import IntEnum
from typing import Annotated, ClassVar

from hiltest.calibration.fit import FitStatus
from hiltest.errors import ProtocolError
from hiltest.link.fields import FieldReader, number
from hiltest.link.replies import CalibrationReply, RunCost, Status
from hiltest.link.request import Plain, Request

MAX_FEED = 80


class StreamStatus(IntEnum):
    """Status of a point for a stream calibrator; the values are those of the protocol."""

    OK = 0
    OUT_OF_RANGE = 1
    FULL = 2
    EMPTY = 3


@dataclass(frozen=True, slots=True)
class StreamStepsReply:
    """Cost of points that a stream calibrator processed or removed."""

    status: StreamStatus
    """OK, or the reason why the next point was refused, without effect."""
    taken: int
    """Number of points."""
    costs: tuple[RunCost, ...] | None
    """One cost per point, in order; None without a cycle counter."""

    @classmethod
    def read(cls, fields: FieldReader) -> StreamStepsReply:
        """Read the reply; an overhead of 0 cycles means that there is no counter."""
        status = fields.choice(StreamStatus, "stream status")
        overhead_cycles = fields.number("I", "overhead cycles")
        count = fields.number("B", "points taken")
        cycles = [fields.number("I", "cycles") for _ in range(count)]
        costs = tuple(RunCost(cycle, overhead_cycles) for cycle in cycles) if overhead_cycles else None
        return cls(status, count, costs)


@dataclass(frozen=True, slots=True)
class StreamStateReply:
    """State of a stream calibrator after the points so far."""

    fit: FitStatus
    is_sphere: bool
    """True if the calibration is a sphere: the ellipsoid was refused, or not tried yet."""
    is_solving: bool
    """True if a solver is in progress, with some of its slices done."""
    iterations: int
    calibration: CalibrationReply
    coverage: float
    """Same number as in CALIBRATE's reply; 0 for calibrators without it."""
    held: int
    """Number of points of the present or a next fit."""
    elements: int
    """Number of unknowns of the solver of this calibration: 4, 7 or 10; 0 with a single solver."""
    accepted: int
    """Number of accepted calibrations since the reset."""
    fit_error_percent: float | None
    """The calibrator's own quality figure; None without one."""
    cost: RunCost | None
    """Cost of this answer, including the fit of a calibrator that fits on request. None without a cycle counter."""

    @classmethod
    def read(cls, fields: FieldReader) -> StreamStateReply:
        fit = fields.choice(FitStatus, "fit status")
        flags = fields.number("B", "flags")
        iterations = fields.number("H", "iterations")
        calibration = CalibrationReply.read(fields)
        coverage = fields.real("coverage")
        held = fields.number("H", "points held")
        elements = fields.number("B", "elements")
        accepted = fields.number("I", "accepted")
        return cls(
            fit,
            bool(flags & 1),
            bool(flags & 2),
            iterations,
            calibration,
            coverage,
            held,
            elements,
            accepted,
            fields.real_if_any("fit error"),
            RunCost.read(fields),
        )


@dataclass(frozen=True)
class StreamReset(Plain):
    """Clear all points of a stream calibrator; with `sliced` its solvers do one slice of their work per point."""

    code = 0x12
    command = "STREAM_RESET"
    order = ("sliced", "stream")
    stream: str
    sliced: bool = False


@dataclass(frozen=True)
class _StreamSteps(Request[StreamStepsReply]):
    """Request for one step per point of the board's buffer."""

    # Without a counter the points are still processed, and their cost is None.
    answered_with: ClassVar[frozenset[Status]] = frozenset({Status.OK, Status.NO_CYCLE_COUNTER})
    order = ("first", "count", "stream")
    stream: str
    first: Annotated[int, number("H", 0, 0xFFFF, "points")]
    count: Annotated[int, number("B", 1, MAX_FEED, "points")]

    def parse(self, fields: FieldReader) -> StreamStepsReply:
        """Read the reply; raise a `ProtocolError` if it has more points than were sent, or fewer without a reason."""
        reply = StreamStepsReply.read(fields)
        if reply.taken > self.count or (reply.taken == self.count) != (reply.status is StreamStatus.OK):
            raise ProtocolError(
                f"reply to {self.command}: {reply.status.name} after {reply.taken} of {self.count} points; "
                "the protocol requires all points or a reason. Check the firmware."
            )
        return reply

    @property
    def board_time_s(self) -> float:
        """Time for a million cycles per point on a 120 MHz core [s]."""
        return self.count / 120.0


class StreamFeed(_StreamSteps):
    """Feed points of the board's buffer to a stream calibrator, and count the cycles of each."""

    code = 0x13
    command = "STREAM_FEED"


class StreamRemove(_StreamSteps):
    """Remove points of the board's buffer from a stream calibrator, and count the cycles of each."""

    code = 0x14
    command = "STREAM_REMOVE"


@dataclass(frozen=True)
class StreamState(Request[StreamStateReply]):
    """Query the state of a streaming calibrator."""

    code = 0x15
    command = "STREAM_STATE"
    answered_with = frozenset({Status.OK, Status.NO_CYCLE_COUNTER})
    stream: str
