"""Requests and replies of the gyroscope: at rest, in a turn, in a log, and its calibration."""

from __future__ import annotations

import struct
from collections.abc import Sequence
from dataclasses import dataclass
from enum import IntEnum
from typing import Annotated, ClassVar

import numpy as np
from numpy.typing import ArrayLike, NDArray

from hiltest.calibration.gyroscope import MAX_TURNS, GyroscopeFit, GyroscopeTurn, TurnsFit, TurnsStatus
from hiltest.link.fields import I8, U16, Axes, FieldReader, Form, Message, Vector, number, reals
from hiltest.link.replies import Counts, RunCost, Statistic, Status
from hiltest.link.request import Plain, Request, Timed

MAX_REST = 4096
MAX_TURN = 12_000
MAX_LOG = 128
#: Number of samples at either end of a turn with a separate sum.
EDGE_SAMPLES = 20


_SECONDS = Form(lambda fields, name: 1e-6 * fields.number("Q", name))


def _read_sums(fields: FieldReader, name: str) -> NDArray[np.int64]:
    return np.array([fields.number("i", name) for _ in range(3)], dtype=np.int64)


_SUMS = Form(_read_sums)


def _read_turns(fields: FieldReader, _name: str) -> list[GyroscopeTurn]:
    return [
        GyroscopeTurn(
            fields.reals(3, "turned"),
            _read_sums(fields, "sum"),
            fields.number("H", "n"),
            1e-6 * fields.number("I", "duration"),
            fields.reals(3, "bias before"),
            fields.reals(3, "bias after"),
            fields.real("share"),
        )
        for _ in range(fields.number("B", "turns"))
    ]


def _pack_turns(turns: Sequence[GyroscopeTurn]) -> bytes:
    return number("B", 1, MAX_TURNS, "turns").pack(len(turns)) + b"".join(map(_pack_turn, turns))


def _pack_turn(turn: GyroscopeTurn) -> bytes:
    return struct.pack(
        "<3f3iHI3f3ff",
        *turn.turned_deg,
        *(int(total) for total in turn.total),
        turn.n,
        round(1e6 * turn.duration_s),
        *turn.bias_before,
        *turn.bias_after,
        turn.share,
    )


class Axis(IntEnum):
    """Axis of the body frame."""

    X = 0
    Y = 1
    Z = 2


class StillnessKind(IntEnum):
    """Result of the firmware's test of a rest."""

    STILL = 0
    TURNED = 1
    SHAKEN = 2
    NOT_TESTED = 3


@dataclass(frozen=True, slots=True)
class Stillness(Message):
    """Result of the test of a rest."""

    kind: StillnessKind
    axis: Axis
    """Axis of the largest deviation in the first window that is not still."""
    first: U16
    """First sample of that window, from 0."""
    amount: float
    """Change of its mean from the samples before, or its spread [counts]."""


@dataclass(frozen=True, slots=True)
class Span(Message):
    """Times of the first and last sample, by the board's clock [s]; `lost` if the part's FIFO overflowed."""

    first_s: Annotated[float, _SECONDS]
    last_s: Annotated[float, _SECONDS]
    lost: bool

    @property
    def middle_s(self) -> float:
        """Midpoint of first and last sample [s]."""
        return 0.5 * (self.first_s + self.last_s)

    @property
    def duration_s(self) -> float:
        """Time from the first sample to the last [s]."""
        return self.last_s - self.first_s


@dataclass(frozen=True, slots=True)
class GyroscopeRestReply(Message):
    """Rate at rest [counts]; `corrected_mean` is without the bias stored before."""

    n: U16
    rate: Annotated[Statistic, Form(Statistic.read)]
    corrected_mean: Vector
    die_temperature_degc: I8
    span: Span
    stillness: Stillness


@dataclass(frozen=True, slots=True)
class IntegrateGyroscopeReply(Message):
    """Exact sums over a turn [counts]."""

    n: U16
    total: Annotated[NDArray[np.int64], _SUMS]
    begin: Annotated[NDArray[np.int64], _SUMS]
    end: Annotated[NDArray[np.int64], _SUMS]
    """Shape (3,). Sums of all samples, of the first and of the last `EDGE_SAMPLES`."""
    lowest: Axes
    highest: Axes
    """Shape (3,). Extremes of the samples, by axis."""
    die_temperature_degc: I8
    span: Span


@dataclass(frozen=True, slots=True)
class LogGyroscopeReply(Message):
    """Samples without a gap; `span` covers all since the start of the log, but its `lost` only these."""

    samples: Annotated[Counts, Form(lambda fields, name: fields.counts(fields.number("B", "count"), name))]
    die_temperature_degc: I8
    span: Span


@dataclass(frozen=True, slots=True)
class FitGyroscopeReply:
    """Calibration from turns and its cost, which is None when the core counts no cycles."""

    fit: TurnsFit
    cost: RunCost | None

    @classmethod
    def read(cls, fields: FieldReader) -> FitGyroscopeReply:
        status, at_fault = fields.choice(TurnsStatus, "fit status"), fields.number("B", "turn at fault")
        matrix, residual_deg = fields.reals(9, "matrix").reshape(3, 3), fields.real("residual")
        fit = TurnsFit(status, at_fault if at_fault < MAX_TURNS else None, matrix, residual_deg)
        return cls(fit, RunCost.read(fields))


@dataclass(frozen=True)
class GyroscopeRest(Timed, Request[GyroscopeRestReply]):
    """Average the gyroscope at rest; `store` keeps the mean as bias afterwards, unless the board was moved."""

    code = 0x0F
    command = "GYROSCOPE_REST"
    order = ("n", "timeout_us", "store", "noise")
    n: Annotated[int, number("H", 1, MAX_REST, "samples")]
    store: bool = False
    noise: float = 0.0
    """rms of one sample, if all were independent, for the test of stillness [counts]; 0 leaves the test out."""


@dataclass(frozen=True)
class IntegrateGyroscope(Timed, Request[IntegrateGyroscopeReply]):
    """Sum n samples of the gyroscope without a gap."""

    code = 0x1E
    command = "INTEGRATE_GYROSCOPE"
    order = ("n", "timeout_us")
    n: Annotated[int, number("H", 2 * EDGE_SAMPLES, MAX_TURN, "samples")]


@dataclass(frozen=True)
class LogGyroscope(Timed, Request[LogGyroscopeReply]):
    """Read the next n samples, with 0 the waiting ones; with `go_on` those after the last request's."""

    code = 0x25
    command = "LOG_GYROSCOPE"
    order = ("n", "go_on", "timeout_us")
    n: Annotated[int, number("B", 0, MAX_LOG, "samples")]
    go_on: bool = False


@dataclass(frozen=True)
class FitGyroscope(Request[FitGyroscopeReply]):
    """Fit the matrix to turns, and count cycles."""

    code = 0x1F
    command = "FIT_GYROSCOPE"
    answered_with: ClassVar[frozenset[Status]] = frozenset({Status.OK, Status.NO_CYCLE_COUNTER})
    turns: Annotated[Sequence[GyroscopeTurn], Form(_read_turns, _pack_turns)]


@dataclass(frozen=True)
class SetGyroscope(Plain):
    """Store the gyroscope's calibration: ``rate_dps = matrix @ (counts - bias)``."""

    code = 0x20
    command = "SET_GYROSCOPE"
    matrix: Annotated[ArrayLike, reals(3, 3)]
    bias: Annotated[ArrayLike, reals(3)]


@dataclass(frozen=True)
class GetGyroscope(Request[GyroscopeFit]):
    """Ask for the gyroscope's calibration."""

    code = 0x21
    command = "GET_GYROSCOPE"

    def parse(self, fields: FieldReader) -> GyroscopeFit:
        return GyroscopeFit(fields.reals(9, "matrix").reshape(3, 3), fields.reals(3, "bias"))
