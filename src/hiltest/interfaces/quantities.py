"""Quantities that firmware reports, with their units, and observations of them."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from enum import Enum, StrEnum
from typing import Protocol, runtime_checkable

import numpy as np
from numpy.typing import NDArray


class Quantity(Enum):
    """A quantity by its name in a rig, with its unit and count of numbers.

    Vectors are in the firmware's axes; the rig's ``frame`` defines them.
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
    # Values that the firmware estimates about its sensors.
    #: calibrated = inverse_soft_iron @ (raw - hard_iron)
    HARD_IRON = ("hard_iron", "uT", 3)
    INVERSE_SOFT_IRON = ("inverse_soft_iron", "", 9)
    FIELD_STRENGTH = ("field_strength", "uT", 1)
    DIP = ("dip", "deg", 1)
    FIT_ERROR = ("fit_error", "%", 1)
    GYROSCOPE_BIAS = ("gyroscope_bias", "dps", 3)
    #: Not 0 when the magnetometer is calibrated; for NXP, the number of elements of the fit.
    CALIBRATED = ("calibrated", "", 1)

    def __init__(self, key: str, unit: str, size: int) -> None:
        self.key = key
        self.unit = unit
        self.size = size

    @classmethod
    def named(cls, key: str) -> Quantity:
        """Return the quantity with a name.

        Raises
        ------
        KeyError
            If there is none of this name.
        """
        return _BY_KEY[key]


_BY_KEY = {quantity.key: quantity for quantity in Quantity}


class Moment(StrEnum):
    """A moment of the procedure at which commands may be sent."""

    START = "start"
    BEFORE_TUMBLE = "before_tumble"
    AFTER_TUMBLE = "after_tumble"
    POSE = "pose"
    ASK = "ask"


@dataclass(frozen=True, slots=True)
class Observation:
    """Values that the firmware reported at the same time."""

    time_s: float
    """Time of the board's clock at which the observation was complete."""
    values: Mapping[Quantity, NDArray[np.float64]] = field(default_factory=dict)
    """Shape (size,). Values in the quantity's unit."""
    error: str = ""
    """Error that the firmware reports; empty without one."""
    checked: bool = False
    """True if it had a check value, which is correct."""


def values_of(observations: Sequence[Observation], quantity: Quantity) -> list[NDArray[np.float64]]:
    """Return the values of a quantity, of the observations that have one, each of shape (size,)."""
    return [observation.values[quantity] for observation in observations if quantity in observation.values]


@runtime_checkable
class StreamInterface(Protocol):
    """Decoder of firmware's output on its line.

    Attributes
    ----------
    offers : frozenset of Quantity
        All quantities that it can report.
    not_understood : int
        Bytes or lines that could not be interpreted.
    """

    offers: frozenset[Quantity]
    not_understood: int

    def commands(self, moment: Moment) -> bytes:
        """Return the bytes to send at a moment; may be empty."""

    def feed(self, data: bytes, time_s: float) -> Sequence[Observation]:
        """Decode bytes that have arrived by a time, in any segmentation; return the observations that they complete."""


@runtime_checkable
class PolledInterface(Protocol):
    """Reader of firmware's values, without its help.

    Attributes
    ----------
    offers : frozenset of Quantity
        All quantities that it reads.
    """

    offers: frozenset[Quantity]

    def read(self, time_s: float) -> Observation:
        """Read all quantities now."""
