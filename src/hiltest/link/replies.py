"""Replies of the firmware as typed records.

Field order is that of the protocol page; magnetometer counts are 0.1 uT,
accelerometer counts 1/8192 g and gravity-positive, gyroscope counts 1/16 dps, all
in the body frame (x forward, y right, z down).
"""

from __future__ import annotations

from dataclasses import dataclass
from enum import IntEnum
from typing import Annotated, Protocol

import numpy as np
from numpy.typing import NDArray

from hiltest.calibration.fit import FitStatus
from hiltest.link.fields import U8, U16, U32, Axes, FieldReader, Form, Matrix, Message, Reals, Vector
from hiltest.orientation.angles import Pose

Counts = NDArray[np.int16]

MICROTESLA_PER_COUNT = 0.1
G_PER_COUNT = 1.0 / 8192.0
DPS_PER_COUNT = 1.0 / 16.0
SAMPLE_RATE_HZ = 200.0
"""Output rate that the firmware configures for FXOS8700CQ (each of its two sensors) and FXAS21002C."""


class Status(IntEnum):
    """First byte of every reply."""

    OK = 0
    UNKNOWN_COMMAND = 1
    BAD_LENGTH = 2
    BAD_ARGUMENT = 3
    NO_SUCH_SENSOR = 4
    SENSOR_ABSENT = 5
    SENSOR_TIMEOUT = 6
    BUS_ERROR = 7
    BUFFER_FULL = 8
    TOO_FEW_POINTS = 9
    UNKNOWN_CALIBRATOR = 10
    NO_CALIBRATION = 11
    NO_CYCLE_COUNTER = 12
    DEGENERATE_FIELD = 13
    BUSY = 14
    NOT_SUPPORTED = 15


class SensorKind(IntEnum):
    """Kind of a sensor."""

    MAGNETOMETER = 0
    ACCELEROMETER = 1
    GYROSCOPE = 2


class CycleSource(IntEnum):
    """Source of the firmware's cycle counts."""

    NONE = 0
    DWT = 1


_UNIQUE_ID = Form(lambda fields, name: b"".join(fields.number("I", name).to_bytes(4, "big") for _ in range(4)))
_TEXTS = Form(lambda fields, name: tuple(fields.text(name) for _ in range(fields.number("B", name))))


@dataclass(frozen=True, slots=True)
class SyncReply(Message):
    """Echo of a nonce."""

    nonce: U32
    protocol_version: U16


@dataclass(frozen=True, slots=True)
class Identity(Message):
    """Identity and abilities of the firmware."""

    protocol_version: U16
    core_clock_hz: U32
    cycle_source: CycleSource
    max_points: U16
    slots: U8
    unique_id: Annotated[bytes, _UNIQUE_ID]
    name: str
    version: str
    build_id: str
    compiler: str
    placement: str
    calibrators: Annotated[tuple[str, ...], _TEXTS]
    stream_calibrators: Annotated[tuple[str, ...], _TEXTS]


@dataclass(frozen=True, slots=True)
class SensorInfo(Message):
    """A sensor that the firmware supports, and whether it answered."""

    sensor_id: U8
    kind: SensorKind
    bus: U8
    address: U8
    expected_who_am_i: U8
    seen_who_am_i: U8
    present: bool
    selected: bool
    name: str


@dataclass(frozen=True, slots=True)
class ReadReply:
    """New raw samples of one sensor."""

    time_us: NDArray[np.int64]
    """Shape (n,). Board time of each sample [us]."""
    counts: Counts
    """Shape (n, 3). Body-frame counts."""
    overruns: int
    """Samples that the sensor overwrote before they were read."""
    die_temperature_degc: int
    """Temperature from the part, uncalibrated."""

    @classmethod
    def read(cls, fields: FieldReader) -> ReadReply:
        count = fields.number("B", "count")
        rows = [(fields.number("Q", "time"), fields.counts(1, "sample")) for _ in range(count)]
        times = np.array([time for time, _ in rows], dtype=np.uint64).astype(np.int64)
        counts = np.concatenate([np.zeros((0, 3), np.int16), *(sample for _, sample in rows)])
        return cls(times, counts, fields.number("H", "overruns"), fields.number("b", "die temperature"))


@dataclass(frozen=True, slots=True)
class CollectReply(Message):
    """State of the point buffer after collecting, with its range per axis [counts]."""

    stored: U16
    minimum: Axes
    maximum: Axes
    overruns: U16


@dataclass(frozen=True, slots=True)
class PointsReply:
    """Stored points: magnetometer and accelerometer counts, each (n, 3)."""

    magnetometer: Counts
    accelerometer: Counts

    @classmethod
    def read(cls, fields: FieldReader) -> PointsReply:
        rows = fields.counts(fields.number("B", "count"), "points", columns=6)
        return cls(rows[:, :3], rows[:, 3:])


@dataclass(frozen=True, slots=True)
class CalibrationReply(Message):
    """A magnetometer calibration: ``unit = soft_iron @ (counts - hard_iron)``."""

    soft_iron: Matrix
    """Shape (3, 3) [1/count], row-major on the wire."""
    hard_iron: Vector
    """Shape (3,) [counts]."""


@dataclass(frozen=True, slots=True)
class RunCost:
    """Core cycles of a run without the empty call, and of the empty call."""

    cycles: int
    overhead_cycles: int

    @classmethod
    def read(cls, fields: FieldReader) -> RunCost | None:
        """Read the cost; None for an empty call of 0 cycles, which means that there is no counter."""
        cycles, overhead_cycles = fields.number("I", "cycles"), fields.number("I", "overhead cycles")
        return cls(cycles, overhead_cycles) if overhead_cycles else None


class CostedReply(Protocol):
    """A reply with the cost of its work; None without a cycle counter."""

    @property
    def cost(self) -> RunCost | None:
        """Cycles that the firmware reports."""


class CostedSteps(Protocol):
    """A reply with the cost of each of several calls; None without a cycle counter."""

    @property
    def costs(self) -> tuple[RunCost, ...] | None:
        """Cycles that the firmware reports."""


@dataclass(frozen=True, slots=True)
class CalibrateReply(Message):
    """Result and cost of a calibrator."""

    fit: FitStatus
    is_sphere: Annotated[bool, Form(lambda fields, name: bool(fields.number("B", name) & 1))]
    """True if the calibration is the sphere fit in place of a refused ellipsoid."""
    iterations: U16
    calibration: CalibrationReply
    coverage: float
    """Largest M_ii / d_i over the pivots; 0 for calibrators without it."""
    cost: RunCost | None
    """Cost; None without a cycle counter."""


@dataclass(frozen=True, slots=True)
class Statistic:
    """Mean and sample standard deviation of one sensor's axes [counts]; one sample has no deviation."""

    mean: Reals
    spread: Reals | None

    @classmethod
    def read(cls, fields: FieldReader, name: str) -> Statistic:
        """Read six float32."""
        return cls(fields.reals(3, f"{name} mean"), fields.reals_if_any(3, f"{name} spread"))


@dataclass(frozen=True, slots=True)
class SlotHeading:
    """Attitude that the firmware computed under one calibration slot; None unless the status is OK."""

    status: Status
    attitude: Pose | None

    @classmethod
    def read(cls, fields: FieldReader) -> SlotHeading:
        """Read a status and three angles."""
        status = fields.choice(Status, "heading status")
        if status is not Status.OK:
            fields.reals_if_any(3, "attitude")
            return cls(status, None)
        return cls(status, Pose(fields.real("heading"), fields.real("pitch"), fields.real("roll")))


@dataclass(frozen=True, slots=True)
class AverageReply:
    """Means of n new samples of magnetometer and accelerometer, and the heading for each requested slot."""

    n: int
    magnetometer: Statistic
    accelerometer: Statistic
    overruns: int
    headings: dict[int, SlotHeading]

    @classmethod
    def read(cls, fields: FieldReader, slot_bitmask: int = 0) -> AverageReply:
        """Read the reply to a request for these slots."""
        return cls(
            fields.number("H", "count"),
            Statistic.read(fields, "magnetometer"),
            Statistic.read(fields, "accelerometer"),
            fields.number("H", "overruns"),
            {slot: SlotHeading.read(fields) for slot in range(16) if slot_bitmask >> slot & 1},
        )


@dataclass(frozen=True, slots=True)
class LinkCounters(Message):
    """Counters of the firmware's line since reset."""

    frames: U32
    damaged: U32
    uart_overruns: U32
    repeated: U32
