"""Requests and replies of the gyroscope: at rest, in a turn, in a log, and its calibration."""

from __future__ import annotations

import struct
from collections.abc import Sequence
from dataclasses import dataclass
from enum import IntEnum
from typing import ClassVar

import numpy as np
from numpy.typing import ArrayLike, NDArray

from hiltest.calibration.gyroscope import MAX_TURNS, GyroscopeFit, GyroscopeTurn, TurnsFit, TurnsStatus
from hiltest.link.fields import FieldReader
from hiltest.link.replies import Counts, Reals, RunCost, Statistic, Status
from hiltest.link.request import Plain, Request, Timed, check_range

MAX_REST = 4096
MAX_TURN = 12_000
MAX_LOG = 128
#: Number of samples at either end of a turn with a separate sum.
EDGE_SAMPLES = 20


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
class Stillness:
    """Result of the test of a rest."""

    kind: StillnessKind
    axis: Axis
    """Axis of the largest deviation in the first window that is not still."""
    first: int
    """First sample of that window, from 0."""
    amount: float
    """Change of its mean from the samples before, or its spread [counts]."""

    @classmethod
    def parse(cls, fields: FieldReader) -> Stillness:
        """Read the verdict."""
        kind, axis = fields.choice(StillnessKind, "stillness"), fields.choice(Axis, "axis")
        return cls(kind, axis, fields.number("H", "first sample"), fields.real("amount"))


@dataclass(frozen=True, slots=True)
class Span:
    """Times of the first and last sample, by the board's clock [s]; `lost` if the part's FIFO overflowed."""

    first_s: float
    last_s: float
    lost: bool

    @property
    def middle_s(self) -> float:
        """Midpoint of first and last sample [s]."""
        return 0.5 * (self.first_s + self.last_s)

    @property
    def duration_s(self) -> float:
        """Time from the first sample to the last [s]."""
        return self.last_s - self.first_s

    @classmethod
    def parse(cls, fields: FieldReader) -> Span:
        """Read the times."""
        first_us, last_us = fields.number("Q", "first time"), fields.number("Q", "last time")
        return cls(1e-6 * first_us, 1e-6 * last_us, fields.flag("lost"))


@dataclass(frozen=True, slots=True)
class GyroscopeRestReply:
    """Rate at rest [counts]; `corrected_mean` is without the bias stored before."""

    n: int
    rate: Statistic
    corrected_mean: Reals
    die_temperature_degc: int
    span: Span
    stillness: Stillness

    @classmethod
    def parse(cls, fields: FieldReader) -> GyroscopeRestReply:
        return cls(
            fields.number("H", "count"),
            Statistic.parse(fields, "gyroscope"),
            fields.reals(3, "corrected mean"),
            fields.number("b", "die temperature"),
            Span.parse(fields),
            Stillness.parse(fields),
        )


@dataclass(frozen=True, slots=True)
class IntegrateGyroscopeReply:
    """Exact sums over a turn [counts]."""

    n: int
    total: NDArray[np.int64]
    begin: NDArray[np.int64]
    end: NDArray[np.int64]
    """Shape (3,). Sums of all samples, of the first and of the last `EDGE_SAMPLES`."""
    lowest: Counts
    highest: Counts
    """Shape (3,). Extremes of the samples, by axis."""
    die_temperature_degc: int
    span: Span

    @classmethod
    def parse(cls, fields: FieldReader) -> IntegrateGyroscopeReply:
        return cls(
            fields.number("H", "count"),
            _sums(fields, "sum"),
            _sums(fields, "sum at the begin"),
            _sums(fields, "sum at the end"),
            fields.counts(1, "lowest")[0],
            fields.counts(1, "highest")[0],
            fields.number("b", "die temperature"),
            Span.parse(fields),
        )


@dataclass(frozen=True, slots=True)
class LogGyroscopeReply:
    """Samples without a gap; `span` covers all since the start of the log, but its `lost` only these."""

    samples: Counts
    die_temperature_degc: int
    span: Span

    @classmethod
    def parse(cls, fields: FieldReader) -> LogGyroscopeReply:
        samples = fields.counts(fields.number("B", "count"), "samples")
        return cls(samples, fields.number("b", "die temperature"), Span.parse(fields))


@dataclass(frozen=True, slots=True)
class FitGyroscopeReply:
    """Calibration from turns and its cost, which is None when the core counts no cycles."""

    fit: TurnsFit
    cost: RunCost | None

    @classmethod
    def parse(cls, fields: FieldReader) -> FitGyroscopeReply:
        status, at_fault = fields.choice(TurnsStatus, "fit status"), fields.number("B", "turn at fault")
        matrix, residual_deg = fields.reals(9, "matrix").reshape(3, 3), fields.real("residual")
        fit = TurnsFit(status, at_fault if at_fault < MAX_TURNS else None, matrix, residual_deg)
        return cls(fit, RunCost.parse(fields))


@dataclass(frozen=True)
class GyroscopeRest(Timed, Request[GyroscopeRestReply]):
    """Average the gyroscope at rest; `store` keeps the mean as bias afterwards, unless the board was moved."""

    code = 0x0F
    command = "GYROSCOPE_REST"
    n: int
    store: bool = False
    noise: float = 0.0
    """rms of one sample, if all were independent, for the test of stillness [counts]; 0 leaves the test out."""

    def payload(self) -> bytes:
        n = check_range(self.n, 1, MAX_REST, "samples")
        return struct.pack("<HIBf", n, self.timeout_us, self.store, self.noise)


@dataclass(frozen=True)
class IntegrateGyroscope(Timed, Request[IntegrateGyroscopeReply]):
    """Sum n samples of the gyroscope without a gap."""

    code = 0x1E
    command = "INTEGRATE_GYROSCOPE"
    n: int

    def payload(self) -> bytes:
        return struct.pack("<HI", check_range(self.n, 2 * EDGE_SAMPLES, MAX_TURN, "samples"), self.timeout_us)


@dataclass(frozen=True)
class LogGyroscope(Timed, Request[LogGyroscopeReply]):
    """Read the next n samples, with 0 the waiting ones; with `go_on` those after the last request's."""

    code = 0x25
    command = "LOG_GYROSCOPE"
    n: int
    go_on: bool = False

    def payload(self) -> bytes:
        return struct.pack("<BBI", check_range(self.n, 0, MAX_LOG, "samples"), self.go_on, self.timeout_us)


@dataclass(frozen=True)
class FitGyroscope(Request[FitGyroscopeReply]):
    """Fit the matrix to turns, and count cycles."""

    code = 0x1F
    command = "FIT_GYROSCOPE"
    answered_with: ClassVar[frozenset[Status]] = frozenset({Status.OK, Status.NO_CYCLE_COUNTER})
    turns: Sequence[GyroscopeTurn]

    def payload(self) -> bytes:
        count = check_range(len(self.turns), 1, MAX_TURNS, "turns")
        return bytes([count]) + b"".join(map(_turn_field, self.turns))


@dataclass(frozen=True)
class SetGyroscope(Plain):
    """Store the gyroscope's calibration: ``rate_dps = matrix @ (counts - bias)``."""

    code = 0x20
    command = "SET_GYROSCOPE"
    matrix: ArrayLike
    bias: ArrayLike

    def payload(self) -> bytes:
        matrix, bias = np.asarray(self.matrix, dtype="<f4"), np.asarray(self.bias, dtype="<f4")
        return matrix.reshape(9).tobytes() + bias.reshape(3).tobytes()


@dataclass(frozen=True)
class GetGyroscope(Request[GyroscopeFit]):
    """Ask for the gyroscope's calibration."""

    code = 0x21
    command = "GET_GYROSCOPE"

    def parse(self, fields: FieldReader) -> GyroscopeFit:
        return GyroscopeFit(fields.reals(9, "matrix").reshape(3, 3), fields.reals(3, "bias"))


def _turn_field(turn: GyroscopeTurn) -> bytes:
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


def _sums(fields: FieldReader, field: str) -> NDArray[np.int64]:
    return np.array([fields.number("i", field) for _ in range(3)], dtype=np.int64)
