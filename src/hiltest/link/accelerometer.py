"""Requests and replies of accelerometer calibrations, in slots and fitted to poses."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Annotated, ClassVar

from numpy.typing import ArrayLike

from hiltest.calibration.accelerometer import AccelerometerFit, AccelerometerSolution, AccelerometerStatus
from hiltest.calibration.still_pose import FACES
from hiltest.link.fields import U8, FieldReader, number, reals
from hiltest.link.replies import RunCost, Status
from hiltest.link.request import Plain, Request

_NO_POSE = 255


@dataclass(frozen=True)
class SetAccelerometer(Plain):
    """Store an accelerometer calibration in a slot; its magnetometer calibration stays."""

    code = 0x16
    command = "SET_ACCELEROMETER"
    slot: U8
    gain: Annotated[ArrayLike, reals(3, 3)]
    offset: Annotated[ArrayLike, reals(3)]


@dataclass(frozen=True)
class GetAccelerometer(Request[AccelerometerFit]):
    """Read a slot's accelerometer calibration, which always exists."""

    code = 0x17
    command = "GET_ACCELEROMETER"
    slot: U8

    def parse(self, fields: FieldReader) -> AccelerometerFit:
        return read_accelerometer(fields)


@dataclass(frozen=True, slots=True, eq=False)
class FitAccelerometerReply:
    """Result and cost of a fit; no cost without a cycle counter."""

    solution: AccelerometerSolution
    cost: RunCost | None

    @classmethod
    def read(cls, fields: FieldReader) -> FitAccelerometerReply:
        status = fields.choice(AccelerometerStatus, "fit status")
        mask, pose = fields.number("B", "faces"), fields.number("B", "pose")
        faces = tuple(face for face in FACES if mask >> face & 1)
        fit = read_accelerometer(fields)
        solution = AccelerometerSolution(
            status, faces, None if pose == _NO_POSE else pose, fit, fields.real("residual")
        )
        return cls(solution, RunCost.read(fields))


@dataclass(frozen=True)
class FitAccelerometer(Request[FitAccelerometerReply]):
    """Fit an accelerometer calibration to the first n poses, and count cycles; no slot changes."""

    code = 0x1C
    command = "FIT_ACCELEROMETER"
    # Without a counter the fit is still valid, and its cost is None.
    answered_with: ClassVar[frozenset[Status]] = frozenset({Status.OK, Status.NO_CYCLE_COUNTER})
    n: Annotated[int, number("B", 0, 0xFF, "poses")]
    method: str


def read_accelerometer(fields: FieldReader) -> AccelerometerFit:
    """Read gain and offset in the form of all messages."""
    return AccelerometerFit(fields.reals(9, "gain").reshape(3, 3), fields.reals(3, "offset"))
