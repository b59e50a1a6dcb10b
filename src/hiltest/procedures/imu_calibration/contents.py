"""Contents of a calibration file. It states frame, formulas and units, which are always the same.

Plain data: the constructors refuse invalid numbers, contradictions and other conventions.
"""

from __future__ import annotations

import math
import re
from dataclasses import dataclass
from typing import Literal

import numpy as np

from hiltest.rig.toml_tables import StrictTable

Triple = tuple[float, float, float]
Matrix = tuple[Triple, Triple, Triple]

SCHEMA: Literal["hiltest.imu-calibration/1"] = "hiltest.imu-calibration/1"
FRAME: Literal["body: x forward, y right, z down; accelerometer counts are gravity-positive"] = (
    "body: x forward, y right, z down; accelerometer counts are gravity-positive"
)
MICROTESLA_PER_COUNT = 0.1

# Smallest determinant of a matrix with normalised rows: below it the axes lie in one plane in float32.
_SMALLEST_VOLUME = 1e-6
# Tolerance between counts and microtesla, which are written with a double's digits.
_SAME = 1e-9
_UTC = re.compile(r"\d{4}-\d\d-\d\dT\d\d:\d\d:\d\dZ")
_HEX = re.compile(r"[0-9a-f]+")


@dataclass(frozen=True, slots=True)
class FigureOfMerit(StrictTable):
    """Figure of merit of one part of the calibration."""

    name: str
    value: float
    unit: str


@dataclass(frozen=True, slots=True)
class MadeOn(StrictTable):
    """The board of a calibration."""

    kind: Literal["virtual", "real"]
    """``virtual`` or ``real``."""
    firmware: str
    version: str
    build_id: str
    """Firmware that defines the counts: its name must match, its build may differ."""
    unique_id: str
    """Id of the chip, hexadecimal. All virtual boards share one."""
    rig: str
    """Name of the rig."""
    world_sha256: str | None
    """Digest of the simulated world without its noise, which distinguishes virtual boards; None for a board on a
    port."""

    def __post_init__(self) -> None:
        if not _HEX.fullmatch(self.unique_id):
            raise ValueError(f"unique_id {self.unique_id!r} is not hexadecimal")


@dataclass(frozen=True, slots=True)
class MagnetometerUnits(StrictTable):
    """Units of a magnetometer's numbers."""

    soft_iron: Literal["1/count"]
    hard_iron: Literal["count"]
    hard_iron_ut: Literal["uT"]


@dataclass(frozen=True, slots=True)
class MagnetometerPart(StrictTable):
    """Conversion of counts to a field of norm 1."""

    sensor: str
    method: str
    n: int
    """Number of points that the method used."""
    formula: Literal["unit_field = soft_iron * (counts - hard_iron)"]
    soft_iron: Matrix
    """Soft iron [1/count]."""
    hard_iron: Triple
    """Hard iron [counts]."""
    hard_iron_ut: Triple
    """Hard iron [uT]."""
    units: MagnetometerUnits
    figures: tuple[FigureOfMerit, ...]

    def __post_init__(self) -> None:
        _check("soft_iron", self.soft_iron, self.hard_iron)
        for counts, ut in zip(self.hard_iron, self.hard_iron_ut, strict=True):
            if not math.isclose(MICROTESLA_PER_COUNT * counts, ut, rel_tol=_SAME, abs_tol=_SAME):
                raise ValueError(
                    f"hard_iron and hard_iron_ut contradict each other: {counts:g} counts of "
                    f"{MICROTESLA_PER_COUNT:g} uT are {MICROTESLA_PER_COUNT * counts:g} uT, not {ut:g}"
                )


@dataclass(frozen=True, slots=True)
class AccelerometerUnits(StrictTable):
    """Units of an accelerometer's numbers."""

    gain: Literal["g/count"]
    offset: Literal["count"]


@dataclass(frozen=True, slots=True)
class AccelerometerPart(StrictTable):
    """Conversion of counts to gravity: `gain`, 3 rows of 3 [g/count]; `offset` (3,) [counts]; `n` poses."""

    sensor: str
    method: str
    n: int
    formula: Literal["gravity_g = gain * (counts - offset)"]
    gain: Matrix
    offset: Triple
    units: AccelerometerUnits
    figures: tuple[FigureOfMerit, ...]

    def __post_init__(self) -> None:
        _check("gain", self.gain, self.offset)


@dataclass(frozen=True, slots=True)
class GyroscopeUnits(StrictTable):
    """Units of a gyroscope's numbers."""

    matrix: Literal["dps/count"]
    bias: Literal["count"]


@dataclass(frozen=True, slots=True)
class GyroscopePart(StrictTable):
    """Conversion of counts to rates: `matrix`, 3 rows of 3 [dps/count]; `bias` (3,) [counts]; `n` samples at rest."""

    sensor: str
    method: str
    n: int
    formula: Literal["rate_dps = matrix * (counts - bias)"]
    matrix: Matrix
    bias: Triple
    units: GyroscopeUnits
    figures: tuple[FigureOfMerit, ...]

    def __post_init__(self) -> None:
        _check("matrix", self.matrix, self.bias)


MAGNETOMETER_UNITS = MagnetometerUnits("1/count", "count", "uT")
ACCELEROMETER_UNITS = AccelerometerUnits("g/count", "count")
GYROSCOPE_UNITS = GyroscopeUnits("dps/count", "count")


@dataclass(frozen=True, slots=True)
class ImuCalibration(StrictTable):
    """The calibration of one board."""

    schema: Literal["hiltest.imu-calibration/1"]
    hiltest: str
    """Version of hiltest that wrote it."""
    made_utc: str
    """Time of the calibration, ISO 8601, to the second."""
    frame: Literal["body: x forward, y right, z down; accelerometer counts are gravity-positive"]
    temperature_degc: float | None
    """Temperature of the gyroscope's die, with untrimmed offset; None without a gyroscope."""
    made_on: MadeOn
    accelerometer: AccelerometerPart | None
    gyroscope: GyroscopePart | None
    """Calibrations of the sensors; None if a sensor was not calibrated."""
    magnetometer: MagnetometerPart

    def __post_init__(self) -> None:
        if not _UTC.fullmatch(self.made_utc):
            raise ValueError(f"made_utc {self.made_utc!r} is no time in UTC; write it as 2026-01-31T12:00:00Z")


def triple(values: object) -> Triple:
    """Return three numbers of an array for a file."""
    x, y, z = (float(value) for value in np.asarray(values, dtype=np.float64).reshape(3))
    return (x, y, z)


def matrix(values: object) -> Matrix:
    """Return nine numbers of an array, row by row."""
    rows = np.asarray(values, dtype=np.float64).reshape(3, 3)
    return (triple(rows[0]), triple(rows[1]), triple(rows[2]))


def _check(name: str, rows: Matrix, offset: Triple) -> None:
    """Refuse numbers beyond float32, and a matrix with dependent axes."""
    linear = np.array(rows, dtype=np.float64)
    if np.abs([*linear.ravel(), *offset]).max() > np.finfo(np.float32).max:
        raise ValueError("a number is larger than a float32 can be")
    norms = np.linalg.norm(linear, axis=1)
    if norms.min() == 0.0 or abs(np.linalg.det(linear / norms[:, np.newaxis])) < _SMALLEST_VOLUME:
        raise ValueError(f"{name} is singular: it maps all readings into a plane")
