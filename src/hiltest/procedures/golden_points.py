"""Golden points: the same magnetometer counts on every host and every board."""

from __future__ import annotations

import math
import random
from functools import lru_cache

import numpy as np
from numpy.typing import NDArray

from hiltest.orientation.angles import sin_cos_deg

_FIELD_COUNTS = 485.0  # 48.5 uT, the field of the default rig
_GOLDEN_ANGLE_DEG = 180.0 * (3.0 - math.sqrt(5.0))
_SOFT_IRON = 0.05  # entries of a symmetric matrix vary by this much about the identity
_HARD_IRON_COUNTS = 600.0
# Twelve uniform draws have variance 1: sigma is 4 counts, the 0.4 uT of a MAG3110.
_SIGMA_COUNTS = 4.0
_DIP_DEG = 62.0
# Turn about the field from pair to pair: another irrational part than the lattice's, to avoid correlation with it.
_TURN_DEG = 360.0 * (math.sqrt(2.0) - 1.0)


def golden_points(n: int, *, index: int = 0) -> NDArray[np.int16]:
    """Return n points on a distorted, noisy sphere.

    Parameters
    ----------
    n
        Number of points; the n directions cover the whole sphere evenly.
    index
        Number of the point set: each has its own soft iron, hard iron and noise.

    Returns
    -------
    ndarray of int16, shape (n, 3)
        Magnetometer counts.

    Notes
    -----
    Directions are a Fibonacci lattice. The computation uses only operations that IEEE 754 rounds correctly, and the
    doubles of Python's Mersenne Twister, whose sequence the documentation guarantees.
    """
    draw = random.Random(index)
    soft_iron = [[1.0 if row == column else 0.0 for column in range(3)] for row in range(3)]
    for row in range(3):
        for column in range(row, 3):
            soft_iron[row][column] += _SOFT_IRON * (2.0 * draw.random() - 1.0)
            soft_iron[column][row] = soft_iron[row][column]
    hard_iron = [_HARD_IRON_COUNTS * (2.0 * draw.random() - 1.0) for _ in range(3)]
    draws = np.array([draw.random() for _ in range(n * 3 * 12)]).reshape(n, 3, 12)
    # Each draw is a multiple of 2**-53, so integer addition is exact, and the sum is rounded once.
    sums = np.ldexp(np.ldexp(draws, 53).astype(np.int64).sum(axis=2).astype(np.float64), -53)
    points = np.empty((n, 3), dtype=np.int16)
    x, y, z = _lattice(n)
    for axis, (a, b, c) in enumerate(soft_iron):
        noise = _SIGMA_COUNTS * (sums[:, axis] - 6.0)
        points[:, axis] = np.rint(_FIELD_COUNTS * (a * x + b * y + c * z) + hard_iron[axis] + noise)
    return points


def golden_pairs(n: int, *, index: int = 0) -> tuple[NDArray[np.int16], NDArray[np.int16]]:
    """Return golden points, and the accelerometer counts of gravity for each.

    Parameters
    ----------
    n, index
        See `golden_points`.

    Returns
    -------
    magnetometer, accelerometer : ndarray of int16, shape (n, 3)
        Counts. The field's dip is 62 degrees, and from one pair to the next the body turns about the field.
    """
    sine, cosine = sin_cos_deg(_DIP_DEG)
    gravities = np.empty((n, 3), dtype=np.int16)
    for k in range(n):
        field = np.array(_lattice_direction(k, n))
        beside = np.zeros(3)
        beside[int(np.abs(field).argmin())] = 1.0
        across = _cross(field, beside)
        across /= math.sqrt(math.fsum(component * component for component in across.tolist()))
        turn_sine, turn_cosine = sin_cos_deg(math.fmod(k * _TURN_DEG, 360.0))
        gravity = sine * field + cosine * (turn_cosine * across + turn_sine * _cross(field, across))
        gravities[k] = np.rint(8192.0 * gravity)
    return golden_points(n, index=index), gravities


def _cross(a: NDArray[np.float64], b: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return the cross product with a fixed order of roundings, which a linear-algebra library does not guarantee."""
    (ax, ay, az), (bx, by, bz) = a.tolist(), b.tolist()
    return np.array([ay * bz - az * by, az * bx - ax * bz, ax * by - ay * bx])


@lru_cache(maxsize=4)
def _lattice(n: int) -> NDArray[np.float64]:
    """Return the n directions as rows x, y and z."""
    return np.array([_lattice_direction(k, n) for k in range(n)]).T


def _lattice_direction(k: int, n: int) -> tuple[float, float, float]:
    height = 1.0 - (2.0 * k + 1.0) / n
    radius = math.sqrt(1.0 - height * height)
    sine, cosine = sin_cos_deg(math.fmod(k * _GOLDEN_ANGLE_DEG, 360.0))
    return radius * cosine, radius * sine, height
