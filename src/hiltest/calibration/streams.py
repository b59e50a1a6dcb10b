"""What the references of the stream calibrators have in common with the firmware's."""

from __future__ import annotations

from collections.abc import Sequence
from enum import IntEnum
from typing import Protocol

from hiltest.calibration.fit import MagnetometerFit


class StreamStatus(IntEnum):
    """Whether a stream calibrator took a point, or why not; the values are those of the link protocol."""

    OK = 0
    OUT_OF_RANGE = 1
    FULL = 2
    EMPTY = 3


class StreamCalibrator(Protocol):
    """A calibrator that is given one point after the other [counts], and asked for its fit at any time."""

    @property
    def held(self) -> int:
        """Points that the fit is, or would be, made of."""
        ...

    def add(self, point: Sequence[int]) -> StreamStatus:
        """Take the next point."""
        ...

    def fit(self) -> MagnetometerFit:
        """Return the calibration after the points so far."""
        ...
