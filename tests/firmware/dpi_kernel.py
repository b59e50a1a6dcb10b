"""The firmware's `dpi`, compiled for this machine, and on a virtual board that did not boot."""

from __future__ import annotations

import ctypes
import math
import struct
from typing import Protocol

import numpy as np
from numpy.typing import ArrayLike, NDArray

from hiltest.calibration import FitStatus, MagnetometerFit
from hiltest.virtual.board.k64f import VirtualK64F
from hiltest.virtual.calls.calling import CallResult

# dpi_known_t, still_pose_t and dpi_fit_t, the same on both.
KNOWN = struct.Struct("<9f3ffB3x")
POSE = struct.Struct("<12fHBx")
RESULT = struct.Struct("<BBH13fH2xff")
NOMINAL_GAIN = np.eye(3) / 8192.0


# By the parameter `joint`.
FROM_PAIRS = {False: "dpi_from_pairs", True: "joint_from_pairs"}


class DpiAnswer:
    """What the kernel answered."""

    def __init__(self, packed: bytes) -> None:
        status, is_sphere, iterations, *rest = RESULT.unpack(packed)
        self.fit = MagnetometerFit(
            FitStatus(status),
            bool(is_sphere),
            iterations,
            np.array(rest[:9]).reshape(3, 3),
            np.array(rest[9:12]),
            rest[12],
        )
        self.used: int = rest[13]
        self.sine: float = rest[14]
        self.standard_error: float = rest[15]

    @property
    def dip_deg(self) -> float:
        return math.degrees(math.asin(max(-1.0, min(1.0, self.sine))))


class DpiKernel(Protocol):
    """Something that runs the firmware's C."""

    def pairs(
        self,
        magnetometer: ArrayLike,
        accelerometer: ArrayLike,
        *,
        gain: ArrayLike = ...,
        offset: ArrayLike = ...,
        dip_deg: float | None = None,
        joint: bool = False,
    ) -> DpiAnswer: ...

    def poses(
        self,
        magnetometer: ArrayLike,
        accelerometer: ArrayLike,
        *,
        gain: ArrayLike = ...,
        offset: ArrayLike = ...,
        dip_deg: float | None = None,
        readings: int = ...,
    ) -> DpiAnswer: ...


def _poses(magnetometer: ArrayLike, accelerometer: ArrayLike, readings: int) -> bytes:
    """still_pose_t of each; of spreads and faces nothing is used."""
    rows = np.column_stack([magnetometer, accelerometer]).tolist()
    nothing = (math.nan,) * 3
    return b"".join(POSE.pack(*row[:3], *nothing, *row[3:], *nothing, readings, 255) for row in rows)


def _known(gain: ArrayLike, offset: ArrayLike, dip_deg: float | None) -> bytes:
    sine = 0.0 if dip_deg is None else math.sin(math.radians(dip_deg))
    return KNOWN.pack(*np.ravel(gain), *np.ravel(offset), sine, dip_deg is not None)


def _range(counts: NDArray[np.int16]) -> bytes:
    return struct.pack("<H6h", len(counts), *counts.min(axis=0).tolist(), *counts.max(axis=0).tolist())


class HostDpi:
    """The kernel in a library of this machine."""

    def __init__(self, library: ctypes.CDLL) -> None:
        self._library = library

    def pairs(self, magnetometer, accelerometer, *, gain=NOMINAL_GAIN, offset=(0, 0, 0), dip_deg=None, joint=False):  # type: ignore[no-untyped-def]
        rows = [np.ascontiguousarray(item, dtype="<i2") for item in (magnetometer, accelerometer)]
        task = struct.pack("PP", *(row.ctypes.data for row in rows)) + _range(rows[0])
        return self._run(FROM_PAIRS[joint], task, _known(gain, offset, dip_deg))

    def poses(self, magnetometer, accelerometer, *, gain=NOMINAL_GAIN, offset=(0, 0, 0), dip_deg=None, readings=16):  # type: ignore[no-untyped-def]
        poses = ctypes.create_string_buffer(_poses(magnetometer, accelerometer, readings))
        task = struct.pack("PH", ctypes.addressof(poses), len(magnetometer))
        return self._run("dpi_from_poses", task, _known(gain, offset, dip_deg))

    def _run(self, function: str, task: bytes, reference: bytes) -> DpiAnswer:
        result = ctypes.create_string_buffer(RESULT.size)
        getattr(self._library, function)(task, reference, result)
        return DpiAnswer(result.raw)


class BoardDpi:
    """The shipped firmware's kernel."""

    # In SRAM_U behind everything the image uses, below the stack.
    MAGNETOMETER, ACCELEROMETER, TASK, KNOWN, RESULT = 0x20020000, 0x20024000, 0x20028000, 0x20028040, 0x20028080

    def __init__(self, board: VirtualK64F) -> None:
        self._board = board
        end = max(segment.run_address + segment.run_size for segment in self._board.image.segments)
        assert end <= self.MAGNETOMETER
        self.last: CallResult | None = None

    def pairs(self, magnetometer, accelerometer, *, gain=NOMINAL_GAIN, offset=(0, 0, 0), dip_deg=None, joint=False):  # type: ignore[no-untyped-def]
        rows = [np.ascontiguousarray(item, dtype="<i2") for item in (magnetometer, accelerometer)]
        memory = self._board.processor.memory
        memory.write(self.MAGNETOMETER, rows[0].tobytes())
        memory.write(self.ACCELEROMETER, rows[1].tobytes())
        task = struct.pack("<II", self.MAGNETOMETER, self.ACCELEROMETER) + _range(rows[0])
        return self._run(FROM_PAIRS[joint], task, _known(gain, offset, dip_deg))

    def poses(self, magnetometer, accelerometer, *, gain=NOMINAL_GAIN, offset=(0, 0, 0), dip_deg=None, readings=16):  # type: ignore[no-untyped-def]
        self._board.processor.memory.write(self.MAGNETOMETER, _poses(magnetometer, accelerometer, readings))
        task = struct.pack("<IH", self.MAGNETOMETER, len(magnetometer))
        return self._run("dpi_from_poses", task, _known(gain, offset, dip_deg))

    def _run(self, function: str, task: bytes, reference: bytes) -> DpiAnswer:
        memory = self._board.processor.memory
        memory.write(self.TASK, task)
        memory.write(self.KNOWN, reference)
        self.last = self._board.call(function, self.TASK, self.KNOWN, self.RESULT)
        return DpiAnswer(memory.read(self.RESULT, RESULT.size))
