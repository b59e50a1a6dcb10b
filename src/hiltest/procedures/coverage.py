"""How much of the sphere a cloud of points has seen."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike

# 10 bands of equal height, each cut into 10: equal areas, by Archimedes.
_BANDS = 10
_SLICES = 10
CELLS = _BANDS * _SLICES


def sphere_coverage(points: ArrayLike) -> float:
    """Return the share of equal-area cells that hold a point, 0 to 1.

    Parameters
    ----------
    points : array_like, shape (n, 3)
        Magnetometer counts. Directions are taken from the middle of each axis' range, which
        comes to lie at the hard iron as the points go round.

    Notes
    -----
    For an operator who turns a board, not for a verdict: the calibrators judge coverage by
    their own pivots.
    """
    cloud = np.asarray(points, dtype=np.float64).reshape(-1, 3)
    if not len(cloud):
        return 0.0
    centred = cloud - (cloud.min(axis=0) + cloud.max(axis=0)) / 2.0
    norms = np.linalg.norm(centred, axis=1)
    directions = centred[norms > 0.0] / norms[norms > 0.0, np.newaxis]
    band = np.clip((directions[:, 2] + 1.0) / 2.0 * _BANDS, 0, _BANDS - 1).astype(int)
    turn = np.arctan2(directions[:, 1], directions[:, 0]) / (2.0 * np.pi) + 0.5
    piece = np.clip(turn * _SLICES, 0, _SLICES - 1).astype(int)
    return len(set(zip(band.tolist(), piece.tolist(), strict=True))) / CELLS
