"""Request and reply of FIT_DPI, the magnetometer calibration against gravity."""

from __future__ import annotations

import struct
from dataclasses import dataclass, field
from enum import IntEnum

from hiltest.calibration.fit import FitStatus
from hiltest.errors import ProtocolError
from hiltest.link.fields import FieldReader, check_range
from hiltest.link.replies import CalibrationReply, RunCost, Status
from hiltest.link.request import Request


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
    def read(cls, fields: FieldReader) -> DpiReply:
        fit = fields.choice(FitStatus, "fit status")
        fields.number("B", "flags")
        iterations = fields.number("H", "iterations")
        return cls(
            fit,
            CalibrationReply.read(fields),
            fields.real("coverage"),
            fields.number("H", "used"),
            fields.real_if_any("dip"),
            fields.real_if_any("strength"),
            fields.real_if_any("standard error"),
            RunCost.read(fields),
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

    @classmethod
    def read(cls, fields: FieldReader) -> FitDpi:
        """Return the request with this payload."""
        source, n = fields.choice(DpiSource, "source"), fields.number("H", "n")
        slot, flags = fields.number("B", "slot"), fields.number("B", "flags")
        if flags > 3:
            raise ProtocolError(f"flags {flags}, not 0 to 3")
        dip_deg = fields.real("dip")
        return cls(n, slot, source=source, dip_deg=dip_deg if flags & 1 else None, is_joint=flags > 1)

    @property
    def board_time_s(self) -> float:
        """Time for 120 million cycles [s]."""
        return 1.0
