"""Quality of a magnetometer calibration: residual, residual rotation, offset, direction."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import ArrayLike

from hiltest.calibration.fit import Array, MagnetometerFit

COUNTS_PER_UT = 10.0


def residual_percent(points_counts: ArrayLike, fit: MagnetometerFit) -> float:
    """Return the rms deviation of the corrected points' norms from 1 [%].

    Parameters
    ----------
    points_counts : shape (n, 3)
        Raw points [counts], body frame, n >= 1.

    Notes
    -----
    ``100 rms(|C (m - o)| - 1)``. It does not see a rotation: a good residual does not
    mean a good heading.
    """
    return residual_of_corrected_percent(fit.corrected(points_counts))


def residual_of_corrected_percent(corrected: ArrayLike) -> float:
    """Return the rms deviation of corrected points' norms from 1, shape (n, 3) [%]."""
    norms = np.linalg.norm(np.asarray(corrected, dtype=np.float64), axis=1)
    return 100.0 * float(np.sqrt(np.mean((norms - 1.0) ** 2)))


def rotation_left_deg(fit: MagnetometerFit, distortion: ArrayLike) -> float:
    """Return the rotation angle between corrected and true directions [deg].

    Parameters
    ----------
    distortion : shape (3, 3)
        True soft iron: matrix from the field to the field at the part [1]; det > 0.

    Notes
    -----
    ``fit.soft_iron @ distortion = R S``, the polar decomposition; the angle is R's. It is
    0 for a symmetric distortion and a perfect fit, whatever the field's strength.
    """
    u, _, right = np.linalg.svd(fit.soft_iron @ np.asarray(distortion, dtype=np.float64))
    rotation = u @ right
    # From the chord |R - I|, which is accurate for small angles, unlike the arc cosine of the trace.
    half_sine = min(1.0, float(np.linalg.norm(rotation - np.eye(3))) / math.sqrt(8.0))
    return math.degrees(2.0 * math.asin(half_sine))


def offset_error_ut(fit: MagnetometerFit, hard_iron_ut: ArrayLike) -> float:
    """Return the distance between fitted and true hard iron [uT].

    Parameters
    ----------
    hard_iron_ut : shape (3,)
        True hard iron in the body frame [uT].
    """
    return float(np.linalg.norm(fit.hard_iron / COUNTS_PER_UT - np.asarray(hard_iron_ut, dtype=np.float64)))


def sphere_directions(count: int = 500) -> Array:
    """Return unit vectors spread evenly over the sphere (Fibonacci), shape (count, 3)."""
    index = np.arange(count) + 0.5
    z = 1.0 - 2.0 * index / count
    turn = index * (math.pi * (3.0 - math.sqrt(5.0)))
    across = np.sqrt(1.0 - z * z)
    return np.column_stack([across * np.cos(turn), across * np.sin(turn), z])


def direction_difference_rms_deg(first: MagnetometerFit, second: MagnetometerFit) -> float:
    """Return the rms angle between the same readings under two calibrations [deg].

    Parameters
    ----------
    first, second
        Calibrations of one sensor; `second` must be invertible.

    Notes
    -----
    The readings are those that `second` maps to evenly spread points on the unit sphere.
    """
    directions = sphere_directions()
    counts = np.linalg.solve(second.soft_iron, directions.T).T + second.hard_iron
    return direction_error_rms_deg(first, counts, directions)


def direction_error_rms_deg(fit: MagnetometerFit, counts: ArrayLike, directions: ArrayLike) -> float:
    """Return the rms angle between corrected readings and known directions [deg].

    Parameters
    ----------
    counts : shape (n, 3)
        Raw readings [counts].
    directions : shape (n, 3)
        True field directions of the readings, unit vectors in the body frame.
    """
    got = fit.corrected(counts)
    true_directions = np.asarray(directions, dtype=np.float64)
    across = np.linalg.norm(np.cross(got, true_directions), axis=1)
    along = (got * true_directions).sum(axis=1)
    return math.degrees(float(np.sqrt(np.mean(np.arctan2(across, along) ** 2))))
