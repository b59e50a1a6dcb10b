"""Requests and replies of the board's buffer of still poses."""

from __future__ import annotations

import math
import struct
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Annotated

import numpy as np

from hiltest.calibration.still_pose import Face, StillPose
from hiltest.link.fields import I8, U8, FieldReader, Form, Message, number
from hiltest.link.replies import AverageReply
from hiltest.link.request import Plain, Request, Timed

MAX_TRANSFER = 20
_MAX_READINGS = 512


def _read_pose(fields: FieldReader) -> StillPose:
    face, readings = fields.choice(Face, "face"), fields.number("H", "readings")
    magnetometer = fields.reals(3, "magnetometer mean")
    magnetometer_spread = fields.reals_if_any(3, "magnetometer spread")
    accelerometer = fields.reals(3, "accelerometer mean")
    accelerometer_spread = fields.reals_if_any(3, "accelerometer spread")
    return StillPose(magnetometer, magnetometer_spread, accelerometer, accelerometer_spread, readings, face)


def _pack_pose(pose: StillPose) -> bytes:
    unknown = np.full(3, math.nan)
    vectors = [
        pose.magnetometer,
        unknown if pose.magnetometer_spread is None else pose.magnetometer_spread,
        pose.accelerometer,
        unknown if pose.accelerometer_spread is None else pose.accelerometer_spread,
    ]
    return struct.pack("<BH", pose.face, pose.readings) + np.concatenate(vectors).astype("<f4").tobytes()


def _read_poses(fields: FieldReader, _name: str = "") -> tuple[StillPose, ...]:
    return tuple(_read_pose(fields) for _ in range(fields.number("B", "poses")))


def _pack_poses(poses: Sequence[StillPose]) -> bytes:
    return number("B", 1, MAX_TRANSFER, "poses").pack(len(poses)) + b"".join(map(_pack_pose, poses))


@dataclass(frozen=True, slots=True)
class AddPoseReply(Message):
    """The added pose: its index in the buffer, and its averages."""

    index: U8
    average: AverageReply
    die_temperature_degc: I8


@dataclass(frozen=True)
class AddPose(Timed, Request[AddPoseReply]):
    """Average n new samples of magnetometer and accelerometer, and store the means as another still pose."""

    code = 0x18
    command = "ADD_POSE"
    order = ("n", "timeout_us", "face")
    n: Annotated[int, number("H", 1, _MAX_READINGS, "samples")]
    face: Face = Face.NONE


@dataclass(frozen=True)
class Poses(Request[tuple[StillPose, ...]]):
    """Read stored poses back."""

    code = 0x19
    command = "POSES"
    first: U8
    count: Annotated[int, number("B", 1, MAX_TRANSFER, "poses")]

    def parse(self, fields: FieldReader) -> tuple[StillPose, ...]:
        return _read_poses(fields)


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
    first: U8
    poses: Annotated[Sequence[StillPose], Form(_read_poses, _pack_poses)]

    def parse(self, fields: FieldReader) -> int:
        return fields.number("B", "stored")
