"""Requests and replies of the board's buffer of still poses."""

from __future__ import annotations

import math
import struct
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from hiltest.calibration.still_pose import Face, StillPose
from hiltest.link.fields import FieldReader
from hiltest.link.replies import AverageReply
from hiltest.link.request import Plain, Request, Timed, check_range

MAX_TRANSFER = 20
_MAX_READINGS = 512


@dataclass(frozen=True, slots=True)
class AddPoseReply:
    """The added pose: its index in the buffer, and its averages."""

    index: int
    average: AverageReply
    die_temperature_degc: int

    @classmethod
    def parse(cls, fields: FieldReader) -> AddPoseReply:
        index = fields.number("B", "index")
        return cls(index, AverageReply.parse(fields, 0), fields.number("b", "die temperature"))


@dataclass(frozen=True)
class AddPose(Timed, Request[AddPoseReply]):
    """Average n new samples of magnetometer and accelerometer, and store the means as another still pose."""

    code = 0x18
    command = "ADD_POSE"
    n: int
    face: Face = Face.NONE

    def payload(self) -> bytes:
        return struct.pack("<HIB", check_range(self.n, 1, _MAX_READINGS, "samples"), self.timeout_us, self.face)


@dataclass(frozen=True)
class Poses(Request[tuple[StillPose, ...]]):
    """Read stored poses back."""

    code = 0x19
    command = "POSES"
    first: int
    count: int

    def payload(self) -> bytes:
        return struct.pack("<BB", self.first, check_range(self.count, 1, MAX_TRANSFER, "poses"))

    def parse(self, fields: FieldReader) -> tuple[StillPose, ...]:
        return tuple(read_pose(fields) for _ in range(fields.number("B", "poses")))


@dataclass(frozen=True)
class ClearPoses(Plain):
    """Empty the pose buffer."""

    code = 0x1A
    command = "CLEAR_POSES"


@dataclass(frozen=True, eq=False)
class UploadPoses(Request[int]):
    """Add poses from the host; `first` is the number stored so far. The reply is the new number."""

    code = 0x1B
    command = "UPLOAD_POSES"
    first: int
    poses: Sequence[StillPose]

    def payload(self) -> bytes:
        count = check_range(len(self.poses), 1, MAX_TRANSFER, "poses")
        return struct.pack("<BB", self.first, count) + b"".join(map(_pose_bytes, self.poses))

    def parse(self, fields: FieldReader) -> int:
        return fields.number("B", "stored")


def read_pose(fields: FieldReader) -> StillPose:
    """Read one pose."""
    face, readings = fields.choice(Face, "face"), fields.number("H", "readings")
    magnetometer = fields.reals(3, "magnetometer mean")
    magnetometer_spread = fields.reals_if_any(3, "magnetometer spread")
    accelerometer = fields.reals(3, "accelerometer mean")
    accelerometer_spread = fields.reals_if_any(3, "accelerometer spread")
    return StillPose(magnetometer, magnetometer_spread, accelerometer, accelerometer_spread, readings, face)


def _pose_bytes(pose: StillPose) -> bytes:
    unknown = np.full(3, math.nan)
    vectors = [
        pose.magnetometer,
        unknown if pose.magnetometer_spread is None else pose.magnetometer_spread,
        pose.accelerometer,
        unknown if pose.accelerometer_spread is None else pose.accelerometer_spread,
    ]
    return struct.pack("<BH", pose.face, pose.readings) + np.concatenate(vectors).astype("<f4").tobytes()
