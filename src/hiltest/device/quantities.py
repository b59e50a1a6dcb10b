"""What firmware says of its board: quantities with their units, and observations of them."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from enum import Enum, StrEnum
from typing import Protocol, runtime_checkable

import numpy as np
from numpy.typing import NDArray


class Quantity(Enum):
    """A quantity by the name that a rig gives it; with its unit and how many numbers it is.

    Vectors are in the axes in which the firmware has them; the rig's ``frame`` says which those are.
    """

    HEADING = ("heading", "deg", 1)
    PITCH = ("pitch", "deg", 1)
    ROLL = ("roll", "deg", 1)
    #: Attitude: w, x, y, z.
    QUATERNION = ("quaternion", "", 4)
    MAGNETOMETER = ("magnetometer", "uT", 3)
    MAGNETOMETER_CALIBRATED = ("magnetometer_calibrated", "uT", 3)
    ACCELEROMETER = ("accelerometer", "g", 3)
    ACCELEROMETER_CALIBRATED = ("accelerometer_calibrated", "g", 3)
    GYROSCOPE = ("gyroscope", "dps", 3)
    GYROSCOPE_CALIBRATED = ("gyroscope_calibrated", "dps", 3)
    TEMPERATURE = ("temperature", "degC", 1)
    # What the firmware believes of itself.
    #: calibrated = inverse_soft_iron @ (raw - hard_iron)
    HARD_IRON = ("hard_iron", "uT", 3)
    INVERSE_SOFT_IRON = ("inverse_soft_iron", "", 9)
    FIELD_STRENGTH = ("field_strength", "uT", 1)
    DIP = ("dip", "deg", 1)
    FIT_ERROR = ("fit_error", "%", 1)
    GYROSCOPE_BIAS = ("gyroscope_bias", "dps", 3)
    #: Not 0 when the magnetometer is calibrated; NXP's number of elements where there is one.
    CALIBRATED = ("calibrated", "", 1)

    def __init__(self, key: str, unit: str, size: int) -> None:
        self.key = key
        self.unit = unit
        self.size = size

    @classmethod
    def named(cls, key: str) -> Quantity:
        """Return the quantity of a name.

        Raises
        ------
        KeyError
            If there is none of this name.
        """
        return _BY_KEY[key]


_BY_KEY = {each.key: each for each in Quantity}


class Moment(StrEnum):
    """A moment of the procedure at which commands may be sent."""

    START = "start"
    BEFORE_TUMBLE = "before_tumble"
    AFTER_TUMBLE = "after_tumble"
    POSE = "pose"


@dataclass(frozen=True, slots=True)
class Observation:
    """What was said at once."""

    time_s: float
    """Time of the board's clock at which it was complete."""
    values: Mapping[Quantity, NDArray[np.float64]] = field(default_factory=dict)
    """Shape (size,). In the quantity's unit."""
    error: str = ""
    """What the firmware reports to be wrong; empty when it reports nothing."""
    checked: bool = False
    """Whether it came with a check value, which is right."""


@runtime_checkable
class StreamInterface(Protocol):
    """Understands what firmware sends on its line.

    Attributes
    ----------
    offers : frozenset of Quantity
        All that it may ever say.
    not_understood : int
        Bytes, or lines, of which nothing was understood.
    """

    offers: frozenset[Quantity]
    not_understood: int

    def commands(self, moment: Moment) -> bytes:
        """Return what is to be sent at a moment; may be empty."""

    def feed(self, data: bytes, time_s: float) -> Sequence[Observation]:
        """Take bytes that have arrived by a time, however they are cut; return what they complete."""


@runtime_checkable
class PolledInterface(Protocol):
    """Reads from the outside what firmware knows.

    Attributes
    ----------
    offers : frozenset of Quantity
        All that it reads.
    """

    offers: frozenset[Quantity]

    def read(self, time_s: float) -> Observation:
        """Read all of it now."""
