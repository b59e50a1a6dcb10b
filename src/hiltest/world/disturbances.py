"""Fields that come and go: of a current on the board, of a magnet that passes, of a cable that moves.

All are functions of virtual time alone, of sums, products, quotients and square roots: the same on every host.
"""

from __future__ import annotations

import math
from bisect import bisect_right
from collections.abc import Sequence
from dataclasses import dataclass

from hiltest.angles import Pose, rotation_rows
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
    """At the parts, body frame, as one measures it there: iron that it magnetises included."""
    waveform: tuple[tuple[float, ...], ...]
    """Straight from row to row, the first and last value before and after; two rows at one time are a step."""
    repeat_s: float | None = None
    """The waveform begins again every so many seconds from its first row on."""

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
    """A long straight cable beside the body, whose place changes and whose current does not."""

    current_a: float
    """Along `direction`."""
    direction: Vector
    """Body frame, of any length."""
    places: tuple[tuple[float, ...], ...]
    """From the parts to any point of the cable, body frame, over time: as a waveform's rows."""

    def field_ut(self, time_s: float) -> Vector:
        """Return what its field is more than it was in its first place, body frame [uT].

        What is constant is hard iron, and in that of the world.
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
    """A magnetic dipole on a straight way past the bench, such as a car; it does not turn. Earth frame NED."""

    moment_am2: Vector
    place_m: Vector
    """Where it is at `at_s`, seen from the parts."""
    velocity_mps: Vector
    at_s: float

    def field_ned_ut(self, time_s: float) -> Vector:
        """Return its field at the parts, (mu0 / 4 pi) (3 (m.r) r / r^2 - m) / r^3, earth frame [uT]."""
        gone_s = time_s - self.at_s
        # From the parts to it: both signs of r are one field.
        r = [place + gone_s * speed for place, speed in zip(self.place_m, self.velocity_mps, strict=True)]
        square = _dot(r, r)
        factor = DIPOLE_UT_M3_PER_AM2 / (square * math.sqrt(square))
        towards = 3.0 * _dot(self.moment_am2, r) / square
        x, y, z = (factor * (towards * place - moment) for place, moment in zip(r, self.moment_am2, strict=True))
        return (x, y, z)


@dataclass(frozen=True, slots=True)
class Disturbances:
    """What disturbs the field of a world, by cause; None is nothing of the kind."""

    current: Current | None = None
    passing: Passing | None = None
    cable: Cable | None = None

    def apply(self, distortion: MagneticDistortion, field_body_ut: Vector, time_s: float, pose: Pose) -> Vector:
        """Return the disturbed field at a part, body frame [uT].

        What passes changes the field around the body, and goes through its soft iron as the earth's does. Current and
        cable are the body's own: their fields are what they are at the part, like hard iron.
        """
        found = self.by_cause_ut(time_s, pose)
        outside = _sum(field_body_ut, found.pop("passing", _NOTHING))
        field_ut = distortion.apply(outside)
        for own in found.values():
            field_ut = _sum(field_ut, own)
        return field_ut

    def by_cause_ut(self, time_s: float, pose: Pose) -> dict[str, Vector]:
        """Return the field of each cause that there is, body frame, before any soft iron [uT]."""
        found: dict[str, Vector] = {}
        if self.current is not None:
            found["current"] = self.current.field_ut(time_s)
        if self.passing is not None:
            found["passing"] = apply_rows(rotation_rows(pose), self.passing.field_ned_ut(time_s))
        if self.cable is not None:
            found["cable"] = self.cable.field_ut(time_s)
        return found


def _course(rows: Sequence[Sequence[float]], time_s: float) -> tuple[float, ...]:
    """Return the values at a time of rows that begin with theirs: straight between them, the ends beyond."""
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
