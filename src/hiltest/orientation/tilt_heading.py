"""Tilt-compensated compass: attitude from gravity and the magnetic field, in float64."""

from __future__ import annotations

import math
from typing import TypeAlias

import numpy as np
from numpy.typing import ArrayLike

from hiltest.errors import CalibrationError
from hiltest.orientation.angles import Matrix, Pose, wrap_360

# Sine of the angle between gravity and field below which a heading would be noise; the firmware has the same limit.
SMALLEST_SINE = 1e-3
Vector: TypeAlias = np.ndarray[tuple[int], np.dtype[np.float64]]


class DegenerateFieldError(CalibrationError):
    """Gravity or field is zero, or they are parallel: there is no heading."""


def tilt_heading(gravity: ArrayLike, field: ArrayLike) -> Pose:
    """Return heading, pitch and roll from gravity and the magnetic field.

    Parameters
    ----------
    gravity : shape (3,)
        Gravity-positive accelerometer in the body frame, any scale: a level body has (0, 0, +).
    field : shape (3,)
        Corrected magnetic field in the body frame, any scale.

    Returns
    -------
    Pose
        Heading from magnetic north, 0 <= heading < 360; pitch -90..90; roll -180..180 [deg].
        At +-90 degrees of pitch roll is 0.

    Raises
    ------
    DegenerateFieldError
        When gravity or field is zero or not finite, or they are within 0.06 degrees of parallel.

    Notes
    -----
    The body axes' coordinates along north and east: down is gravity, east is down cross
    field, north is east cross down (the firmware turns the field back by roll and pitch
    instead).
    """
    north, east, down = earth_axes(gravity, field)
    across = math.hypot(down[1], down[2])
    pitch_deg = math.degrees(math.atan2(-down[0], across))
    if across == 0.0:
        # Nose straight up or down: the y axis alone gives the heading, roll being 0.
        return Pose(wrap_360(math.degrees(math.atan2(-north[1], east[1]))), pitch_deg, 0.0)
    heading_deg = wrap_360(math.degrees(math.atan2(east[0], north[0])))
    return Pose(heading_deg, pitch_deg, math.degrees(math.atan2(down[1], down[2])))


def earth_axes(gravity: ArrayLike, field: ArrayLike) -> Matrix:
    """Return north, east and down in the body frame, from gravity and the magnetic field (TRIAD).

    Parameters
    ----------
    gravity, field : shape (3,)
        See `tilt_heading`.

    Returns
    -------
    ndarray, shape (3, 3)
        Orthonormal rows: the matrix from body components to the earth frame.

    Raises
    ------
    DegenerateFieldError
        See `tilt_heading`.
    """
    down = _unit(gravity, "gravity")
    toward = _unit(field, "field")
    east = _cross(down, toward)
    sine = float(np.linalg.norm(east))
    if not sine > SMALLEST_SINE:
        raise DegenerateFieldError("gravity and magnetic field are parallel: no heading")
    east /= sine
    return np.array([_cross(east, down), east, down])


def _cross(a: Vector, b: Vector) -> Vector:
    """Return the cross product of two vectors; numpy's general one would take 20 us of each heading."""
    (ax, ay, az), (bx, by, bz) = a.tolist(), b.tolist()
    return np.array([ay * bz - az * by, az * bx - ax * bz, ax * by - ay * bx])


def _unit(vector: ArrayLike, name: str) -> Vector:
    values = np.asarray(vector, dtype=np.float64).reshape(3)
    largest = float(np.abs(values).max())
    if not (0.0 < largest < math.inf):
        raise DegenerateFieldError(f"{name} is {values}: no heading")
    values = values / largest
    unit: Vector = values / np.linalg.norm(values)
    return unit
