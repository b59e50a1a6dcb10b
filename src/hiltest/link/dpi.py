"""Request and reply of FIT_DPI, the magnetometer calibration against gravity."""

from __future__ import annotations

import struct
from dataclasses import dataclass, field
from enum import IntEnum

from hiltest.calibration.fit import FitStatus
from hiltest.link.fields import FieldReader
from hiltest.link.replies import CalibrationReply, RunCost, Status
from hiltest.link.request import Request, check_range


class DpiSource(IntEnum):
    """Data to fit; the values are those of the protocol."""

    PAIRS = 0
    POSES = 1


@dataclass(frozen=True, slots=True)
class DpiReply:
    """A calibration against gravity, and its data."""

    fit: FitStatus
    calibration: CalibrationReply
    coverage: float
    """Largest ratio of the pivot for attitudes in all directions to the actual one."""
    n_used: int
    """Rows of the least squares."""
    dip_deg: float | None
    strength_counts: float | None
    standard_error: float | None
    """Dip and strength from the data; None if undetermined."""
    cost: RunCost | None
    """Cost; None without a cycle counter."""
    iterations: int = 0
    """Steps of `joint`."""

    @classmethod
    def parse(cls, fields: FieldReader) -> DpiReply:
        fit = fields.choice(FitStatus, "fit status")
        fields.number("B", "flags")
        iterations = fields.number("H", "iterations")
        return cls(
            fit,
            CalibrationReply.parse(fields),
            fields.real("coverage"),
            fields.number("H", "used"),
            _real_if_any(fields, "dip"),
            _real_if_any(fields, "strength"),
            _real_if_any(fields, "standard error"),
            RunCost.parse(fields),
            iterations,
        )


@dataclass(frozen=True)
class FitDpi(Request[DpiReply]):
    """Calibrate by the dot product with gravity, from the accelerometer with a slot's calibration."""

    code = 0x1D
    command = "FIT_DPI"
    answered_with = frozenset({Status.OK, Status.NO_CYCLE_COUNTER})
    n: int
    """Number of points or poses, from the first on."""
    slot: int
    """Slot of the accelerometer calibration."""
    source: DpiSource = field(default=DpiSource.PAIRS, kw_only=True)
    dip_deg: float | None = field(default=None, kw_only=True)
    """Inclination of the field, positive down; None to estimate it."""
    is_joint: bool = field(default=False, kw_only=True)
    """True for `joint`, the fit of norms and dot products together, which needs pairs."""

    def payload(self) -> bytes:
        has_dip = self.dip_deg is not None
        return struct.pack(
            "<BHBBf",
            self.source,
            check_range(self.n, 1, 0xFFFF, "rows"),
            self.slot,
            has_dip | self.is_joint << 1,
            self.dip_deg if has_dip else 0.0,
        )

    @property
    def board_time_s(self) -> float:
        """Time for 120 million cycles [s]."""
        return 1.0


def _real_if_any(fields: FieldReader, name: str) -> float | None:
    values = fields.reals_if_any(1, name)
    return None if values is None else float(values[0])
