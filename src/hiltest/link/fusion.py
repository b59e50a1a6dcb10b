"""Requests and replies of the attitude filter that follows a motion on the board."""

from __future__ import annotations

import struct
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from hiltest.link.fields import FieldReader
from hiltest.link.replies import RunCost, Status
from hiltest.link.request import Request, Timed, check_range

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
    def parse(cls, fields: FieldReader) -> UpdateCosts:
        """Read the costs; an overhead of 0 cycles means that there is no counter."""
        updates, largest, total, overhead = (
            fields.number("I", name) for name in ("updates", "largest", "total", "overhead")
        )
        if not overhead:
            return cls(updates, None, None)
        return cls(updates, RunCost(largest, overhead), total / updates if updates else None)


@dataclass(frozen=True, slots=True)
class FusionSummary:
    """Summary of a run of the filter."""

    began_us: int
    """Duration by the board's clock."""
    records: int
    """Number of records on the board."""
    no_attitude: int
    """Updates that only turned the attitude: gravity is unusable."""
    field_left_out: int
    """Updates that left the heading alone: the field is disturbed, vertical or has no norm."""
    bad_steps: int
    """Omitted steps: more than half a turn."""
    overruns: int
    """Samples lost unread."""
    costs: UpdateCosts

    @property
    def left_out(self) -> int:
        """Number of samples that did not act on the filter as they should."""
        return self.no_attitude + self.field_left_out + self.bad_steps + self.overruns

    @classmethod
    def parse(cls, fields: FieldReader) -> FusionSummary:
        began_us = fields.number("Q", "began")
        names = ("records", "no attitude", "field left out", "bad steps", "overruns")
        records, no_attitude, field_left_out, bad_steps, overruns = (fields.number("H", name) for name in names)
        costs = UpdateCosts.parse(fields)
        return cls(began_us, records, no_attitude, field_left_out, bad_steps, overruns, costs)


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
    def parse(cls, fields: FieldReader) -> FusionRecords:
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
    slot: int
    """Slot of the calibrations."""
    every: int
    """Number of updates per record."""
    readings: int
    """Number of readings that are averaged for the first attitude."""

    def payload(self) -> bytes:
        every = check_range(self.every, 1, 255, "updates")
        readings = check_range(self.readings, 1, _MAX_READINGS, "readings")
        return struct.pack("<BBHI", self.slot, every, readings, self.timeout_us)

    def parse(self, fields: FieldReader) -> Quaternions:
        return fields.reals(4, "attitude")


@dataclass(frozen=True)
class FusionRun(Request[FusionSummary]):
    """Run the filter on the board's sensors for a time, or until the records are full."""

    code = 0x23
    command = "FUSION_RUN"
    answered_with = frozenset({Status.OK, Status.NO_CYCLE_COUNTER})
    duration_us: int

    def payload(self) -> bytes:
        return struct.pack("<I", check_range(self.duration_us, 1, _LONGEST_US, "us"))

    @property
    def board_time_s(self) -> float:
        """Duration of the run [s]."""
        return self.duration_us * 1e-6


@dataclass(frozen=True)
class FusionRead(Request[FusionRecords]):
    """Read the records of a run; the reply has fewer if there are no more."""

    code = 0x24
    command = "FUSION_READ"
    first: int
    count: int = MAX_FUSION_READ

    def payload(self) -> bytes:
        count = check_range(self.count, 0, MAX_FUSION_READ, "records")
        return struct.pack("<HB", check_range(self.first, 0, MAX_FUSION_RECORDS, "records"), count)
