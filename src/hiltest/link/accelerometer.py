"""The accelerometer calibration of a slot: what the host asks, and what it is answered."""

from __future__ import annotations

import struct
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from hiltest.calibration.accelerometer import AccelerometerFit
from hiltest.link.fields import FieldReader
from hiltest.link.request import Plain, Request

__all__ = ["GetAccelerometer", "SetAccelerometer"]


@dataclass(frozen=True)
class SetAccelerometer(Plain):
    """Give a slot an accelerometer calibration; its magnetometer calibration stays."""

    code = 0x16
    command = "SET_ACCELEROMETER"
    slot: int
    gain: ArrayLike
    offset: ArrayLike

    def payload(self) -> bytes:
        gain = np.asarray(self.gain, dtype="<f4").reshape(9)
        offset = np.asarray(self.offset, dtype="<f4").reshape(3)
        return struct.pack("<B", self.slot) + gain.tobytes() + offset.tobytes()


@dataclass(frozen=True)
class GetAccelerometer(Request[AccelerometerFit]):
    """Read a slot's accelerometer calibration; there always is one."""

    code = 0x17
    command = "GET_ACCELEROMETER"
    slot: int

    def payload(self) -> bytes:
        return struct.pack("<B", self.slot)

    def parse(self, fields: FieldReader) -> AccelerometerFit:
        return read_accelerometer(fields)


def read_accelerometer(fields: FieldReader) -> AccelerometerFit:
    """Read gain and offset, as every message has them."""
    return AccelerometerFit(fields.reals(9, "gain").reshape(3, 3), fields.reals(3, "offset"))
