"""A part that no longer acknowledges in the middle of a transaction: the command says so, and the next one works."""

from __future__ import annotations

import struct

import pytest

from hiltest.link.replies import Status
from hiltest.virtual.peripherals.i2c_bus import I2cDevice

from .bench import READ, Bench, sensors

SECOND_US = 1_000_000
MAG3110, MAG3110_ADDRESS = 0, 0x0E
READ_FOUR = struct.pack("<BBI", MAG3110, 4, SECOND_US)


class Faltering:
    """A part that leaves one START after the sample was found ready unanswered.

    Parameters
    ----------
    part : I2cDevice
        What it is else.
    silent_at : int
        Which START of a transaction, counted from 1: the register of the flags, the flags, the registers, the sample.
    """

    def __init__(self, part: I2cDevice, silent_at: int) -> None:
        self._part = part
        self._silent_at = silent_at
        self._starts = 0
        self.falters = False
        self.times_silent = 0

    @property
    def address(self) -> int:
        return self._part.address

    def start(self, reading: bool, time_s: float) -> bool:
        self._starts += 1
        if self.falters and self._starts == self._silent_at:
            self.times_silent += 1
            self._starts = 0  # STOP follows, which a part that is not addressed is not told of
            return False
        return self._part.start(reading, time_s)

    def write(self, value: int, time_s: float) -> bool:
        return self._part.write(value, time_s)

    def read(self, time_s: float) -> int:
        return self._part.read(time_s)

    def stop(self, time_s: float) -> None:
        self._starts = 0
        self._part.stop(time_s)


@pytest.mark.parametrize("silent_at", [1, 2, 3, 4])
def test_a_part_that_stops_answering_is_absent_and_can_be_read_again(silent_at: int) -> None:
    parts = sensors()["i2c1"]
    faltering = [Faltering(part, silent_at) if part.address == MAG3110_ADDRESS else part for part in parts]
    bench = Bench(i2c1=faltering)
    (part,) = (item for item in faltering if isinstance(item, Faltering))
    part.falters = True
    assert bench.status(READ, READ_FOUR) == Status.SENSOR_ABSENT
    assert part.times_silent > 0
    part.falters = False
    assert bench.status(READ, READ_FOUR) == Status.OK
