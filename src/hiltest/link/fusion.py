"""Requests and replies of the attitude filter that follows a motion on the board."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Annotated

import numpy as np
from numpy.typing import NDArray

from hiltest.link.fields import U8, U16, U64, FieldReader, Message, number
from hiltest.link.replies import RunCost, Status
from hiltest.link.request import Request, Timed

#: Capacity of the board's record buffer, and records per reply.
MAX_FUSION_RECORDS = 1024
MAX_FUSION_READ = 36
_MAX_READINGS = 512
_LONGEST_US = 300_000_000
_QUATERNION_SCALE = 32767.0

Quaternions = NDArray[np.float64]


@dataclass(frozen=True, slots=True)
class UpdateCosts:
    """Cost of the filter's updates."""

    updates: int
    """Number of updates."""
    largest: RunCost | None
    """Cost of the most expensive update; None without a cycle counter."""
    mean_cycles: float | None
    """Mean cost over all updates."""

    @classmethod
    def read(cls, fields: FieldReader) -> UpdateCosts:
        """Read the costs; an overhead of 0 cycles means that there is no counter."""
        updates, largest, total, overhead = (
            fields.number("I", name) for name in ("updates", "largest", "total", "overhead")
        )
        if not overhead:
            return cls(updates, None, None)
        return cls(updates, RunCost(largest, overhead), total / updates if updates else None)


@dataclass(frozen=True, slots=True)
class FusionSummary(Message):
    """Summary of a run of the filter."""

    began_us: U64
    """Duration by the board's clock."""
    records: U16
    """Number of records on the board."""
    no_attitude: U16
    """Updates that only turned the attitude: gravity is unusable."""
    field_left_out: U16
    """Updates that left the heading alone: the field is disturbed, vertical or has no norm."""
    bad_steps: U16
    """Omitted steps: more than half a turn."""
    overruns: U16
    """Samples lost unread."""
    costs: UpdateCosts

    @property
    def left_out(self) -> int:
        """Number of samples that did not act on the filter as they should."""
        return self.no_attitude + self.field_left_out + self.bad_steps + self.overruns


@dataclass(frozen=True, slots=True, eq=False)
class FusionRecords:
    """Attitudes at updates, as quaternions (x, y, z, w), body to north-east-down."""

    time_us: NDArray[np.int64]
    """Shape (n,). Time since the start of the run."""
    fused: Quaternions
    measured: Quaternions
    turned: Quaternions
    """Shape (n, 4). Attitudes of the filter; of accelerometer and magnetometer alone, NaN without one; of the gyroscope
    alone. Their resolution is 1/32767, 0.0035 degrees."""

    @classmethod
    def read(cls, fields: FieldReader) -> FusionRecords:
        count = fields.number("B", "records")
        times, rows = [], []
        for _ in range(count):
            times.append(fields.number("I", "time"))
            rows.append(fields.counts(3, "quaternion", columns=4))
        steps = np.array(rows, dtype=np.float64).reshape(count, 3, 4)
        steps[~steps.any(axis=2)] = np.nan
        fused, measured, turned = (steps / _QUATERNION_SCALE).swapaxes(0, 1)
        return cls(np.array(times, dtype=np.int64), fused, measured, turned)

    @classmethod
    def joined(cls, parts: list[FusionRecords]) -> FusionRecords:
        """Concatenate the records of several replies."""
        fused, measured, turned = (
            np.concatenate([getattr(part, name) for part in parts]) for name in ("fused", "measured", "turned")
        )
        return cls(np.concatenate([part.time_us for part in parts]), fused, measured, turned)


@dataclass(frozen=True)
class FusionStart(Timed, Request[Quaternions]):
    """Take the first attitude from the resting board; the reply is a quaternion (x, y, z, w)."""

    code = 0x22
    command = "FUSION_START"
    order = ("slot", "every", "readings", "timeout_us")
    slot: U8
    """Slot of the calibrations."""
    every: Annotated[int, number("B", 1, 255, "updates")]
    """Number of updates per record."""
    readings: Annotated[int, number("H", 1, _MAX_READINGS, "readings")]
    """Number of readings that are averaged for the first attitude."""

    def parse(self, fields: FieldReader) -> Quaternions:
        return fields.reals(4, "attitude")


@dataclass(frozen=True)
class FusionRun(Request[FusionSummary]):
    """Run the filter on the board's sensors for a time, or until the records are full."""

    code = 0x23
    command = "FUSION_RUN"
    answered_with = frozenset({Status.OK, Status.NO_CYCLE_COUNTER})
    duration_us: Annotated[int, number("I", 1, _LONGEST_US, "us")]

    @property
    def board_time_s(self) -> float:
        """Duration of the run [s]."""
        return self.duration_us * 1e-6


@dataclass(frozen=True)
class FusionRead(Request[FusionRecords]):
    """Read the records of a run; the reply has fewer if there are no more."""

    code = 0x24
    command = "FUSION_READ"
    first: Annotated[int, number("H", 0, MAX_FUSION_RECORDS, "records")]
    count: Annotated[int, number("B", 0, MAX_FUSION_READ, "records")] = MAX_FUSION_READ
