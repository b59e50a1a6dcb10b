"""Samples for the firmware: int16 counts, at most the capacity of its buffer."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Self

import numpy as np
from numpy.typing import ArrayLike, NDArray

from hiltest.calibration.fit import MagnetometerFit
from hiltest.log_fitting.samples import Samples

Array = NDArray[np.float64]

_COUNTS_PER_UT = 10.0
_INT16 = 32_767.0
# Limits of half the widest range [count]. Below, rounding is more than 0.3 % of it; above, noise may exceed int16.
_COARSEST, _WIDEST = 100.0, 32_000.0
# Half range to which others are scaled: rounding is then 0.01 % of it.
_CHOSEN = 3_200.0
# Number of readings from which points for a firmware are chosen: 40 per point give as even a choice as more.
_CANDIDATES = 20_000


@dataclass(frozen=True, slots=True, eq=False)
class CountScale:
    """Scale from readings to counts: ``counts = (reading - origin) * per_unit``."""

    per_unit: float
    """Counts per unit of the samples."""
    origin: Array
    """Shape (3,). Origin in the unit of the samples; zero unless the readings exceed int16."""

    @classmethod
    def choose(cls, samples: Samples) -> Self:
        """Choose the scale: the firmware's own 0.1 uT, or unchanged raw counts, if that fits."""
        low, high = samples.points.min(axis=0), samples.points.max(axis=0)
        half = float((high - low).max()) / 2.0
        microtesla = samples.microtesla
        per_unit = 1.0 if microtesla is None else microtesla * _COUNTS_PER_UT
        if half > 0.0 and not _COARSEST <= half * per_unit <= _WIDEST:
            per_unit = _CHOSEN / half
        fits = float(np.abs(samples.points).max()) * per_unit <= _INT16
        return cls(per_unit, np.zeros(3) if fits else (low + high) / 2.0)

    @property
    def step(self) -> float:
        """Size of one count in the unit of the samples."""
        return 1.0 / self.per_unit

    def unrounded(self, points: ArrayLike) -> Array:
        """Return readings as fractional counts, shape (n, 3)."""
        counts: Array = (np.asarray(points, dtype=np.float64) - self.origin) * self.per_unit
        return counts

    def counts(self, points: ArrayLike) -> NDArray[np.int16]:
        """Return readings as int16 counts, shape (n, 3)."""
        return np.rint(self.unrounded(points)).astype(np.int16)

    def convert_fit(self, fit: MagnetometerFit) -> MagnetometerFit:
        """Return a calibration of counts as one of readings in the unit of the samples."""
        if not fit.has_fit:
            return fit
        return MagnetometerFit(
            fit.status,
            fit.is_sphere,
            fit.iterations,
            fit.soft_iron * self.per_unit,
            fit.hard_iron / self.per_unit + self.origin,
            fit.coverage,
        )


def evenly_on_sphere(points: Array, most: int, centre: Array) -> NDArray[np.intp]:
    """Return the indexes of at most `most` points whose directions are as far apart as possible.

    Parameters
    ----------
    points : shape (n, 3)
    centre : shape (3,)
        Origin of the directions.

    Returns
    -------
    ndarray of int, rising
        Indexes; all of them if there are no more.

    Notes
    -----
    Farthest-point sampling (Gonzalez, Clustering to minimize the maximum intercluster distance, 1985) of a long log's
    readings at a uniform stride: each next point is the one whose nearest chosen direction is farthest.
    """
    if len(points) <= most:
        return np.arange(len(points))
    candidates = np.arange(0, len(points), -(-len(points) // _CANDIDATES))
    if len(candidates) < most:
        candidates = np.arange(len(points))
    away = points[candidates] - centre
    directions = away / np.maximum(np.linalg.norm(away, axis=1), np.finfo(float).tiny)[:, None]
    nearest, chosen = np.full(len(candidates), -2.0), [0]
    while len(chosen) < most:
        np.maximum(nearest, directions @ directions[chosen[-1]], out=nearest)
        nearest[chosen[-1]] = np.inf
        chosen.append(int(nearest.argmin()))
    return np.sort(candidates[chosen])
