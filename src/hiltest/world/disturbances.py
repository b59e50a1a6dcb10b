"""Fields that vary in time: of a current on the board, of a passing magnet, of a moving cable.

All are functions of virtual time with sums, products, quotients and square roots only, so that they are equal on every
host.
"""

from __future__ import annotations

import math
from bisect import bisect_right
from collections.abc import Sequence
from dataclasses import dataclass

from hiltest.orientation.angles import Pose, rotation_rows
from hiltest.world.distortion import MagneticDistortion
from hiltest.world.earth_field import Vector, apply_rows

# mu0 / 4 pi is 1e-7 T m/A to five parts in 1e10.
DIPOLE_UT_M3_PER_AM2 = 0.1
WIRE_UT_M_PER_A = 0.2

_NOTHING: Vector = (0.0, 0.0, 0.0)


@dataclass(frozen=True, slots=True)
class Current:
    """A current on the body, whose field at the parts is proportional to it and has one direction."""

    field_ut_per_a: Vector
    """Field per current at the parts, body frame, as measured there, including magnetised iron."""
    waveform: tuple[tuple[float, ...], ...]
    """Waveform with linear interpolation between rows, constant before the first and after the last; two rows at one
    time are a step."""
    repeat_s: float | None = None
    """Period with which the waveform repeats from its first row on."""

    def current_a(self, time_s: float) -> float:
        """Return the current at a virtual time [A]."""
        first_s = self.waveform[0][0]
        if self.repeat_s is not None and time_s > first_s:
            time_s = first_s + math.fmod(time_s - first_s, self.repeat_s)
        return _course(self.waveform, time_s)[0]

    def field_ut(self, time_s: float) -> Vector:
        """Return its field at the parts, body frame [uT]."""
        x, y, z = self.field_ut_per_a
        current_a = self.current_a(time_s)
        return (current_a * x, current_a * y, current_a * z)


@dataclass(frozen=True, slots=True)
class Cable:
    """A long straight cable near the body with varying place and constant current."""

    current_a: float
    """Current along `direction`."""
    direction: Vector
    """Direction in the body frame, of any length."""
    places: tuple[tuple[float, ...], ...]
    """Vector from the parts to any point of the cable, body frame, over time, as a waveform's rows."""

    def field_ut(self, time_s: float) -> Vector:
        """Return the change of its field since its first place, body frame [uT].

        The constant part is included in the world's hard iron.
        """
        now, first = self._field_ut(_course(self.places, time_s)), self._field_ut(self.places[0][1:])
        return (now[0] - first[0], now[1] - first[1], now[2] - first[2])

    def _field_ut(self, place_m: Sequence[float]) -> Vector:
        """Return the field of a straight wire without ends, mu0 I / (2 pi d), right-handed about its current [uT]."""
        length = math.sqrt(_dot(self.direction, self.direction))
        along = (self.direction[0] / length, self.direction[1] / length, self.direction[2] / length)
        behind = _dot(place_m, along)
        x, y, z = (behind * unit - component for unit, component in zip(along, place_m, strict=True))
        factor = WIRE_UT_M_PER_A * self.current_a / (x * x + y * y + z * z)
        return (
            factor * (along[1] * z - along[2] * y),
            factor * (along[2] * x - along[0] * z),
            factor * (along[0] * y - along[1] * x),
        )


@dataclass(frozen=True, slots=True)
class Passing:
    """A magnetic dipole on a straight path past the bench, such as a car, without rotation. Earth frame NED."""

    moment_am2: Vector
    place_m: Vector
    """Position at `at_s` relative to the parts."""
    velocity_mps: Vector
    at_s: float

    def field_ned_ut(self, time_s: float) -> Vector:
        """Return its field at the parts, (mu0 / 4 pi) (3 (m.r) r / r^2 - m) / r^3, earth frame [uT]."""
        gone_s = time_s - self.at_s
        # Vector from the parts to the dipole; both signs of r give the same field.
        r = [place + gone_s * speed for place, speed in zip(self.place_m, self.velocity_mps, strict=True)]
        square = _dot(r, r)
        factor = DIPOLE_UT_M3_PER_AM2 / (square * math.sqrt(square))
        towards = 3.0 * _dot(self.moment_am2, r) / square
        x, y, z = (factor * (towards * place - moment) for place, moment in zip(r, self.moment_am2, strict=True))
        return (x, y, z)


@dataclass(frozen=True, slots=True)
class Disturbances:
    """Disturbances of a world's field, by cause; None for a missing one."""

    current: Current | None = None
    passing: Passing | None = None
    cable: Cable | None = None

    def apply(self, distortion: MagneticDistortion, field_body_ut: Vector, time_s: float, pose: Pose) -> Vector:
        """Return the disturbed field at a part, body frame [uT].

        A passing magnet changes the field around the body, so soft iron distorts it like the earth's. Current and cable
        belong to the body: their fields are defined at the part, like hard iron.
        """
        by_cause = self.fields_by_cause_ut(time_s, pose)
        outside = _sum(field_body_ut, by_cause.pop("passing", _NOTHING))
        field_ut = distortion.apply(outside)
        for own in by_cause.values():
            field_ut = _sum(field_ut, own)
        return field_ut

    def fields_by_cause_ut(self, time_s: float, pose: Pose) -> dict[str, Vector]:
        """Return the field of each present cause, body frame, before any soft iron [uT]."""
        by_cause: dict[str, Vector] = {}
        if self.current is not None:
            by_cause["current"] = self.current.field_ut(time_s)
        if self.passing is not None:
            by_cause["passing"] = apply_rows(rotation_rows(pose), self.passing.field_ned_ut(time_s))
        if self.cable is not None:
            by_cause["cable"] = self.cable.field_ut(time_s)
        return by_cause


def _course(rows: Sequence[Sequence[float]], time_s: float) -> tuple[float, ...]:
    """Interpolate rows that begin with their time: linear between them, constant beyond the ends."""
    after = bisect_right(rows, time_s, key=lambda row: row[0])
    if after in (0, len(rows)):
        return tuple(rows[0 if after == 0 else -1][1:])
    (begin_s, *begin), (end_s, *end) = rows[after - 1], rows[after]
    share = (time_s - begin_s) / (end_s - begin_s)
    return tuple(a + share * (b - a) for a, b in zip(begin, end, strict=True))


def _dot(a: Sequence[float], b: Sequence[float]) -> float:
    return a[0] * b[0] + a[1] * b[1] + a[2] * b[2]


def _sum(a: Vector, b: Vector) -> Vector:
    return (a[0] + b[0], a[1] + b[1], a[2] + b[2])
