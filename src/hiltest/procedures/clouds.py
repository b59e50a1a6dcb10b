"""Golden magnetometer clouds: the same counts on every host and every board."""

from __future__ import annotations

import math
import random

import numpy as np
from numpy.typing import NDArray

from hiltest.angles import sin_cos_deg

_FIELD_COUNTS = 485.0  # 48.5 uT, the field of the default rig
_GOLDEN_ANGLE_DEG = 180.0 * (3.0 - math.sqrt(5.0))
_SOFT_IRON = 0.05  # entries of a symmetric matrix vary by this much about the identity
_HARD_IRON_COUNTS = 600.0
# Twelve uniform draws have variance 1: sigma is 4 counts, the 0.4 uT of a MAG3110.
_SIGMA_COUNTS = 4.0


def golden_cloud(n: int, *, index: int = 0) -> NDArray[np.int16]:
    """Return n points on a distorted, noisy sphere.

    Parameters
    ----------
    n : int
        Number of points; the n directions cover the whole sphere evenly.
    index : int
        Which cloud: each has its own soft iron, hard iron and noise.

    Returns
    -------
    ndarray of int16, shape (n, 3)
        Magnetometer counts.

    Notes
    -----
    Directions are a Fibonacci lattice. Only operations that IEEE 754 rounds correctly are used,
    (`math.fsum`, not `sum`, which sums differently from Python 3.12 on), and the doubles of
    Python's Mersenne Twister, which its documentation keeps fixed.
    """
    draw = random.Random(index)
    soft_iron = [[1.0 if row == column else 0.0 for column in range(3)] for row in range(3)]
    for row in range(3):
        for column in range(row, 3):
            soft_iron[row][column] += _SOFT_IRON * (2.0 * draw.random() - 1.0)
            soft_iron[column][row] = soft_iron[row][column]
    hard_iron = [_HARD_IRON_COUNTS * (2.0 * draw.random() - 1.0) for _ in range(3)]
    points = np.empty((n, 3), dtype=np.int16)
    for k in range(n):
        x, y, z = _lattice_direction(k, n)
        for axis, (a, b, c) in enumerate(soft_iron):
            noise = _SIGMA_COUNTS * (math.fsum(draw.random() for _ in range(12)) - 6.0)
            points[k, axis] = round(_FIELD_COUNTS * (a * x + b * y + c * z) + hard_iron[axis] + noise)
    return points


def _lattice_direction(k: int, n: int) -> tuple[float, float, float]:
    height = 1.0 - (2.0 * k + 1.0) / n
    radius = math.sqrt(1.0 - height * height)
    sine, cosine = sin_cos_deg(math.fmod(k * _GOLDEN_ANGLE_DEG, 360.0))
    return radius * cosine, radius * sine, height
