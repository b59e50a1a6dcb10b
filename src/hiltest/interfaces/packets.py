"""Packets of NXP's sensor fusion, as its Sensor Fusion Toolbox reads them: releases 4.22, 5.00 and 7.

A packet is ``7E body 7E`` with the byte stuffing of `hiltest.link.framing`; the body is ``u8 type, u8 number`` and the
fields, little-endian. It has no length and no check value: type and length of the body together identify the kind, in
every release.

Table columns have distinct names, by which readers of logs find one magnetometer and one gyroscope, the uncalibrated
ones.
"""

from __future__ import annotations

from dataclasses import dataclass
from enum import Enum, IntEnum

from hiltest.errors import FrameError
from hiltest.interfaces.packet_fields import (
    Int8,
    Int16,
    Int32,
    Packet,
    Quadruple,
    ScaledNumber,
    ScaledVector,
    Sextuple,
    TimedPacket,
    UInt8,
    UInt16,
    Vector,
    axes,
    layout,
    pack,
    unpack,
)
from hiltest.link.framing import stuff, unstuff

_FIRST_CELL = 10


class Algorithm(IntEnum):
    """Sensors whose fusion the packets report."""

    ACCELEROMETER = 1
    ACCELEROMETER_MAGNETOMETER = 2
    GYROSCOPE = 3
    ACCELEROMETER_GYROSCOPE = 4
    MAGNETOMETER = 6
    NINE_AXES = 8


class AxisConvention(IntEnum):
    """Convention of axes and angles."""

    NED = 0
    ANDROID = 1
    WINDOWS_8 = 2


class Shield(IntEnum):
    """Sensor shield of a 5.00 or 7 build; 4.22 always sends 0."""

    MULTI_B = 0
    NONE = 1
    AGM01 = 2
    AGM02 = 3
    AGMP03 = 4
    AGM04 = 5


@dataclass(frozen=True, slots=True)
class MainPacket(TimedPacket):
    """Sensors, orientation and set-up: type 1."""

    type = 1
    title = "sensors and orientation"
    acceleration: Vector
    field: Vector
    rate: Vector
    """Accelerometer, calibrated magnetometer, uncalibrated gyroscope; zeros where the algorithm uses none. 4.22 sends
    gyroscope counts, which are 20 per deg/s for an FXAS21000 only."""
    quaternion: Quadruple
    """Orientation, the scalar first."""
    flags: UInt8
    board: UInt8
    """`algorithm` and `frame`; `board_number` and `shield`."""

    acceleration_g = ScaledVector("acceleration", 8192, *axes("accelerometer", "g"))
    field_ut = ScaledVector("field", 10, *axes("field", "uT"))
    rate_dps = ScaledVector("rate", 20, *axes("gyroscope", "dps"))
    rotation = ScaledVector("quaternion", 30_000, "q0", "q1", "q2", "q3")

    @property
    def algorithm(self) -> Algorithm | None:
        """Selected algorithm; None for an unknown number."""
        return Algorithm(self.flags & 15) if self.flags & 15 in list(Algorithm) else None

    @property
    def frame(self) -> AxisConvention | None:
        """Convention of axes; None for an unknown number."""
        return AxisConvention(self.flags >> 4 & 3) if self.flags >> 4 & 3 in list(AxisConvention) else None

    @property
    def board_number(self) -> int:
        """NXP's number of the board; 5 is the FRDM-K64F."""
        return self.board & 31

    @property
    def shield(self) -> Shield | None:
        """Sensor shield; None for an unknown number."""
        return Shield(self.board >> 5) if self.board >> 5 in list(Shield) else None


@dataclass(frozen=True, slots=True)
class DebugPacket(Packet):
    """Release of the firmware and duration of the selected algorithm: type 2."""

    type = 2
    title = "firmware and duration"
    firmware: Int16
    ticks: UInt16

    firmware_release = ScaledNumber("firmware", 100, "firmware_release")
    #: Ticks of the core's clock.
    algorithm_ticks = ScaledNumber("ticks", 1 / 20, "algorithm_ticks")


@dataclass(frozen=True, slots=True)
class RatePacket(TimedPacket):
    """Angular rate, calibrated: type 3."""

    type = 3
    title = "angular rate"
    rate: Vector

    rate_dps = ScaledVector("rate", 20, *axes("turn", "dps"))


@dataclass(frozen=True, slots=True)
class AnglesPacket(TimedPacket):
    """Roll, pitch and compass heading: type 4."""

    type = 4
    title = "roll, pitch, heading"
    roll: Int16
    pitch: Int16
    compass: Int16

    roll_deg = ScaledNumber("roll", 10, "roll_deg")
    pitch_deg = ScaledNumber("pitch", 10, "pitch_deg")
    compass_deg = ScaledNumber("compass", 10, "heading_deg")


@dataclass(frozen=True, slots=True)
class AltitudePacket(TimedPacket):
    """Altitude and temperature of a pressure sensor: type 5."""

    type = 5
    title = "altitude and temperature"
    altitude_mm: Int32
    temperature: Int16

    altitude_m = ScaledNumber("altitude_mm", 1000, "altitude_m")
    temperature_degc = ScaledNumber("temperature", 100, "temperature_degc")


class Shown(Enum):
    """Content of the three numbers of a magnetic packet; consecutive packets rotate through these."""

    STRENGTH = 0
    HARD_IRON = 1
    INVERSE_SOFT_IRON_DIAGONAL = 2
    INVERSE_SOFT_IRON_OFF_DIAGONAL = 3
    BUFFER_CELL = 4
    EMPTY_CELL = 5
    NOTHING = 6


# Columns of the three numbers, and the integer of one unit; the first of STRENGTH is always 0.
_SHOWN_COLUMNS: dict[Shown, tuple[tuple[str, ...], int]] = {
    Shown.STRENGTH: (("", "field_strength_uT", "inclination_deg"), 10),
    Shown.HARD_IRON: (tuple(axes("hard_iron", "uT")), 10),
    Shown.INVERSE_SOFT_IRON_DIAGONAL: (tuple(axes("inverse_soft_iron", names=("xx", "yy", "zz"))), 1000),
    Shown.INVERSE_SOFT_IRON_OFF_DIAGONAL: (tuple(axes("inverse_soft_iron", names=("xy", "xz", "yz"))), 1000),
    Shown.BUFFER_CELL: (tuple(axes("magnetometer", "uT")), 10),
}


class _Magnetic(Packet):
    """Base of the magnetic packets of all releases."""

    __slots__ = ()
    variable_id: int
    variable: tuple[int, int, int]

    @property
    def shown(self) -> Shown:
        """Content of the three numbers."""
        if abs(self.variable_id) >= _FIRST_CELL:
            return Shown.BUFFER_CELL if self.variable_id > 0 else Shown.EMPTY_CELL
        return Shown(self.variable_id) if 0 <= self.variable_id <= 3 else Shown.NOTHING

    @property
    def buffer_cell(self) -> int | None:
        """Cell of the buffer of uncalibrated samples, from 0; None for other contents."""
        return abs(self.variable_id) - _FIRST_CELL if self.shown in (Shown.BUFFER_CELL, Shown.EMPTY_CELL) else None

    @property
    def shown_values(self) -> dict[str, float]:
        """The three numbers with their units in the names; empty for no content or an empty cell."""
        names, per_unit = _SHOWN_COLUMNS.get(self.shown, ((), 1))
        elsewhere = super().columns()  # release 7 sends the strength as a field, and a zero in this place
        return {
            name: value / per_unit
            for name, value in zip(names, self.variable, strict=False)
            if name and name not in elsewhere
        }

    @classmethod
    def columns(cls) -> tuple[str, ...]:
        """Return the names of `values`."""
        shown = [name for names, _ in _SHOWN_COLUMNS.values() for name in names if name]
        return tuple(dict.fromkeys([*super().columns(), *shown]))

    def values(self) -> dict[str, float]:
        """Return the packet's values with units in the names."""
        return super().values() | self.shown_values


@dataclass(frozen=True, slots=True)
class MagneticPacket422(_Magnetic):
    """Magnetic calibration of releases 4.22 and 5.00: type 6."""

    type = 6
    title = "magnetic calibration"
    active_count: Int16
    """Samples in the buffer."""
    fit_error: Int16
    """Fit error, 0.1 % each."""
    variable_id: Int16
    variable: Vector
    """Kind of content and its three numbers: see `shown` and `shown_values`."""

    fit_error_percent = ScaledNumber("fit_error", 10, "fit_error_percent")


@dataclass(frozen=True, slots=True)
class MagneticPacket7(_Magnetic):
    """Magnetic calibration of release 7: type 6, with a finer fit error and the field's strength."""

    type = 6
    title = "magnetic calibration"
    active_count: Int16
    fit_error: Int16
    strength: Int16
    variable_id: Int16
    variable: Vector

    fit_error_percent = ScaledNumber("fit_error", 100, "fit_error_percent")
    field_strength_ut = ScaledNumber("strength", 10, "field_strength_uT")


@dataclass(frozen=True, slots=True)
class KalmanPacket422(Packet):
    """State of the Kalman filter of release 4.22: type 7."""

    type = 7
    title = "Kalman filter"
    orientation_error: Vector
    gyroscope_offset: Vector
    gyroscope_offset_error: Vector

    orientation_error_deg = ScaledVector("orientation_error", 1000, *axes("orientation_error", "deg"))
    gyroscope_offset_dps = ScaledVector("gyroscope_offset", 1000, *axes("turn_offset", "dps"))
    gyroscope_offset_error_dps = ScaledVector("gyroscope_offset_error", 10_000, *axes("turn_offset_error", "dps"))


@dataclass(frozen=True, slots=True)
class KalmanPacket500(Packet):
    """State of the Kalman filters of releases 5.00 and 7: type 7."""

    type = 7
    title = "Kalman filter"
    gravity_residual: Vector
    gravity_error: Vector
    magnetic_residual: Vector
    magnetic_error: Vector
    """Innovation of each direction and the estimated tilt of it, as vector parts of quaternions."""
    gyroscope_offset: Vector
    inclination: Int16
    linear_acceleration: Vector
    displacement: Vector
    """The last two in the frame of the earth."""

    gravity_residual_parts = ScaledVector("gravity_residual", 30_000, *axes("gravity_residual"))
    gravity_error_parts = ScaledVector("gravity_error", 30_000, *axes("gravity_error"))
    magnetic_residual_parts = ScaledVector("magnetic_residual", 30_000, *axes("field_residual"))
    magnetic_error_parts = ScaledVector("magnetic_error", 30_000, *axes("field_error"))
    gyroscope_offset_dps = ScaledVector("gyroscope_offset", 1000, *axes("turn_offset", "dps"))
    inclination_deg = ScaledNumber("inclination", 100, "filter_inclination_deg")
    linear_acceleration_g = ScaledVector("linear_acceleration", 8192, *axes("motion", "g"))
    displacement_m = ScaledVector("displacement", 100, *axes("displacement", "m"))


@dataclass(frozen=True, slots=True)
class AccelerometerPacket(Packet):
    """Calibration of the accelerometer of release 7: type 8, once after a stored measurement or a reset."""

    type = 8
    title = "accelerometer calibration"
    location: Int8
    """Index of the measurement, 0 to 11; 12 for none."""
    stored: Vector
    offset: Vector
    gain: Vector
    cross: Vector
    rotation_diagonal: Vector
    rotation_others: Sextuple
    """Stored acceleration, offset, inverse gain less 1, cross-axis terms xy, xz and yz, and the rotation matrix."""

    stored_g = ScaledVector("stored", 8192, *axes("stored_gravity", "g"))
    offset_g = ScaledVector("offset", 32_768, *axes("zero_g_offset", "g"))
    inverse_gain_less_1 = ScaledVector("gain", 10_000, *axes("inverse_gain_less_1", names=("xx", "yy", "zz")))
    inverse_gain_cross = ScaledVector("cross", 10_000, *axes("inverse_gain", names=("xy", "xz", "yz")))
    rotation_diagonal_parts = ScaledVector("rotation_diagonal", 10_000, *axes("rotation", names=("xx", "yy", "zz")))
    rotation_other_parts = ScaledVector(
        "rotation_others", 10_000, *axes("rotation", names=("xy", "xz", "yx", "yz", "zx", "zy"))
    )


_OF_ALL = (MainPacket, DebugPacket, RatePacket, AnglesPacket, AltitudePacket)


class Release(Enum):
    """A release of the firmware; the value is the kinds of packets that it sends."""

    V4_22 = (*_OF_ALL, MagneticPacket422, KalmanPacket422)
    V5_00 = (*_OF_ALL, MagneticPacket422, KalmanPacket500)
    V7 = (*_OF_ALL, MagneticPacket7, KalmanPacket500, AccelerometerPacket)

    def __str__(self) -> str:
        """Return its number."""
        return self.name.removeprefix("V").replace("_", ".")


KINDS: tuple[type[Packet], ...] = tuple(dict.fromkeys(kind for release in Release for kind in release.value))
#: Kind of packet by its type and the length of its body.
KIND_OF: dict[tuple[int, int], type[Packet]] = {(kind.type, layout(kind).size): kind for kind in KINDS}


def encode(packet: Packet) -> bytes:
    """Return the bytes of a packet on the line, with both delimiters.

    Raises
    ------
    ValueError
        When a field exceeds the range of its form.
    """
    return b"\x7e" + stuff(pack(packet)) + b"\x7e"


def decode(data: bytes) -> Packet:
    """Decode the packet in the bytes between two delimiters, which may be included.

    Raises
    ------
    FrameError
        When the bytes are not a packet.
    """
    body = unstuff(data.removeprefix(b"\x7e").removesuffix(b"\x7e"))
    kind = KIND_OF.get((body[0] if body else 0, len(body)))
    if kind is None:
        raise FrameError(f"{len(body)} bytes with type {body[:1].hex() or 'none'} are not a packet of any release")
    return unpack(kind, body)
