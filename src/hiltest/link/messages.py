"""Typed requests to the firmware, each with its reply."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Annotated

import numpy as np
from numpy.typing import ArrayLike

from hiltest.link.fields import U8, U16, U32, FieldReader, Form, check_range, number, reals
from hiltest.link.replies import (
    AverageReply,
    CalibrateReply,
    CalibrationReply,
    CollectReply,
    Identity,
    LinkCounters,
    PointsReply,
    ReadReply,
    RunCost,
    SensorInfo,
    Status,
    SyncReply,
)
from hiltest.link.request import Plain, Request, Timed

PROTOCOL_VERSION = 9
MAX_UPLOAD = 160
MAX_UPLOAD_PAIRS = 80
MAX_POINTS_READ = 80
MAX_READ = 64
MAX_COLLECT = 512
MAX_AVERAGE = 512


def _read_rows(fields: FieldReader, name: str) -> list[list[int]]:
    count = fields.number("B", "count")
    columns = 6 if count and fields.left == 12 * count else 3
    rows: list[list[int]] = fields.counts(count, name, columns=columns).tolist()
    return rows


def _pack_rows(points: Sequence[Sequence[int]]) -> bytes:
    rows = np.asarray(points)
    check_range(len(rows), 1, MAX_UPLOAD if rows.shape[1:] == (3,) else MAX_UPLOAD_PAIRS, "points")
    check_range(int(rows.min()), -0x8000, 0x7FFF, "counts")
    check_range(int(rows.max()), -0x8000, 0x7FFF, "counts")
    return bytes([len(rows)]) + rows.astype("<i2").tobytes()


@dataclass(frozen=True)
class Sync(Request[SyncReply]):
    """Request the return of a nonce: frames before it answer older requests."""

    code = 0x01
    command = "SYNC"
    nonce: U32


@dataclass(frozen=True)
class Identify(Request[Identity]):
    """Query the identity of the firmware."""

    code = 0x02
    command = "IDENTITY"


@dataclass(frozen=True)
class Sensors(Request[tuple[SensorInfo, ...]]):
    """Query the sensors and whether they answer."""

    code = 0x03
    command = "SENSORS"

    def parse(self, fields: FieldReader) -> tuple[SensorInfo, ...]:
        return tuple(SensorInfo.read(fields) for _ in range(fields.number("B", "sensors")))


@dataclass(frozen=True)
class Select(Plain):
    """Select a sensor for its kind, and configure it."""

    code = 0x04
    command = "SELECT"
    sensor_id: U8


@dataclass(frozen=True)
class Read(Timed, Request[ReadReply]):
    """Read new raw samples of one sensor."""

    code = 0x05
    command = "READ"
    order = ("sensor_id", "count", "timeout_us")
    sensor_id: U8
    count: Annotated[int, number("B", 1, MAX_READ, "samples")]


@dataclass(frozen=True)
class Collect(Timed, Request[CollectReply]):
    """Add magnetometer points to the board's buffer, each with its accelerometer sample."""

    code = 0x06
    command = "COLLECT"
    order = ("count", "timeout_us")
    count: Annotated[int, number("H", 1, MAX_COLLECT, "points")]


@dataclass(frozen=True)
class Upload(Request[int]):
    """Add points from the host; `first` is the number stored so far. The reply is the new number.

    A row is x, y, z of the magnetometer, optionally followed by x, y, z of the accelerometer.
    """

    code = 0x07
    command = "UPLOAD"
    first: U16
    points: Annotated[Sequence[Sequence[int]], Form(_read_rows, _pack_rows)]

    def parse(self, fields: FieldReader) -> int:
        return fields.number("H", "stored")


@dataclass(frozen=True)
class Points(Request[PointsReply]):
    """Read stored points back."""

    code = 0x08
    command = "POINTS"
    first: U16
    count: Annotated[int, number("B", 1, MAX_POINTS_READ, "points")]


@dataclass(frozen=True)
class ClearPoints(Plain):
    """Empty the point buffer."""

    code = 0x09
    command = "CLEAR_POINTS"


@dataclass(frozen=True)
class TimeRange(Request[RunCost | None]):
    """Recompute the range of the first n points, and count cycles; None without a counter."""

    code = 0x27
    command = "TIME_RANGE"
    answered_with = frozenset({Status.OK, Status.NO_CYCLE_COUNTER})
    n: Annotated[int, number("H", 1, 0xFFFF, "points")]

    def parse(self, fields: FieldReader) -> RunCost | None:
        return RunCost.read(fields)


@dataclass(frozen=True)
class Calibrate(Request[CalibrateReply]):
    """Run a calibrator over the first n points, and count cycles; `iterations` is a limit, 0 for its own."""

    code = 0x0A
    command = "CALIBRATE"
    # Without a counter the fit is still valid, and its cost is None.
    answered_with = frozenset({Status.OK, Status.NO_CYCLE_COUNTER})
    order = ("n", "iterations", "calibrator")
    n: U16
    calibrator: str
    iterations: Annotated[int, number("H", 0, 0xFFFF, "iterations")] = field(default=0, kw_only=True)

    @property
    def board_time_s(self) -> float:
        """Time for a calibrator of 500 million cycles on a 120 MHz core [s]."""
        return 4.2


@dataclass(frozen=True)
class SetCalibration(Plain):
    """Store a calibration in a slot; slot 0 is the active one."""

    code = 0x0B
    command = "SET_CALIBRATION"
    slot: U8
    soft_iron: Annotated[ArrayLike, reals(3, 3)]
    hard_iron: Annotated[ArrayLike, reals(3)]


@dataclass(frozen=True)
class GetCalibration(Request[CalibrationReply]):
    """Read a slot."""

    code = 0x0C
    command = "GET_CALIBRATION"
    slot: U8


@dataclass(frozen=True)
class ClearCalibration(Plain):
    """Empty a slot."""

    code = 0x0D
    command = "CLEAR_CALIBRATION"
    slot: U8


@dataclass(frozen=True)
class Average(Timed, Request[AverageReply]):
    """Average new samples of magnetometer and accelerometer, and compute the attitude for each slot in a mask."""

    code = 0x0E
    command = "AVERAGE"
    order = ("n", "timeout_us", "slot_bitmask")
    n: Annotated[int, number("H", 1, MAX_AVERAGE, "samples")]
    slot_bitmask: U16 = 0

    def parse(self, fields: FieldReader) -> AverageReply:
        return AverageReply.read(fields, self.slot_bitmask)


@dataclass(frozen=True)
class LinkStatistics(Request[LinkCounters]):
    """Query the counters of the firmware's line."""

    code = 0x10
    command = "LINK_STATISTICS"


@dataclass(frozen=True)
class Reset(Plain):
    """Request a reset; the answer precedes it."""

    code = 0x11
    command = "RESET"
