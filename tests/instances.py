"""The thesis' generator of random calibration problems, with its parameters stated."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

_COUNTS_PER_UT = 10.0


@dataclass(frozen=True, slots=True, eq=False)
class Instance:
    """Points of one distorted sensor, and the truth behind them.

    Attributes
    ----------
    seed : int
        What `instance` was called with.
    points_counts : ndarray of int16, shape (n, 3)
        Readings [counts of 0.1 uT], body frame.
    soft_iron : ndarray, shape (3, 3)
        Symmetric distortion: takes the field to the field at the part [1].
    hard_iron_ut : ndarray, shape (3,)
        [uT], body frame.
    covered : float
        Part of the sphere that the points come from [1].
    """

    seed: int
    points_counts: NDArray[np.int16]
    soft_iron: NDArray[np.float64]
    hard_iron_ut: NDArray[np.float64]
    covered: float


def instance(
    seed: int,
    count: int = 100,
    *,
    field_ut: float = 50.0,
    noise_ut: float = 0.3,
    stretch: float = 0.5,
    largest_hard_iron_ut: float = 500.0,
    covered: tuple[float, float] = (0.5, 1.0),
) -> Instance:
    """Draw one calibration problem.

    Parameters
    ----------
    seed : int
        The same seed and parameters give the same instance.
    count : int
        Number of points.
    field_ut : float
        Field strength [uT].
    noise_ut : float
        Standard deviation on each axis, added after the distortion [uT].
    stretch : float
        The soft iron's eigenvalues are uniform in 1 -+ stretch.
    largest_hard_iron_ut : float
        Length of the hard iron is uniform up to this, its direction uniform [uT].
    covered : (low, high)
        The covered part of the sphere is uniform between these [1]; the rest, a cap
        about a random axis, is left out. (0.05, 0.2) gives caps that no ellipsoid fit
        survives.

    Notes
    -----
    ``m = Q diag Q' b + e + n`` (Mucciaccia, eq. 1), Q uniform over rotations.
    """
    random = np.random.Generator(np.random.Philox(seed))
    soft_axes = _random_rotation(random)
    soft_iron = (soft_axes * random.uniform(1.0 - stretch, 1.0 + stretch, 3)) @ soft_axes.T
    hard_iron_ut = _random_rotation(random)[0] * random.uniform(0.0, largest_hard_iron_ut)
    part = float(random.uniform(*covered))
    along = random.uniform(1.0 - 2.0 * part, 1.0, count)
    turn = random.uniform(0.0, 2.0 * np.pi, count)
    across = np.sqrt(1.0 - along**2)
    directions = np.column_stack([across * np.cos(turn), across * np.sin(turn), along]) @ _random_rotation(random)
    field = field_ut * directions @ soft_iron + hard_iron_ut + noise_ut * random.standard_normal((count, 3))
    counts = np.clip(np.rint(field * _COUNTS_PER_UT), -32767, 32767).astype(np.int16)
    return Instance(seed, counts, soft_iron, hard_iron_ut, part)


def _random_rotation(random: np.random.Generator) -> NDArray[np.float64]:
    """Return a rotation uniform over all rotations, shape (3, 3)."""
    w, x, y, z = (quaternion := random.standard_normal(4)) / np.linalg.norm(quaternion)
    return np.array(
        [
            [1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)],
            [2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)],
            [2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)],
        ]
    )
