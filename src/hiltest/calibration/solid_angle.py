"""Part of the sphere that calibrated samples cover."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike, NDArray

from hiltest.calibration.fit import Array
from hiltest.calibration.quality import sphere_directions

# Stand for the sphere, some 4 degrees apart: a part of it is known to about 1 %.
SPHERE = sphere_directions(2000)
# Radius of an empty cap that matters to a fit; tracks of a tumble lie closer.
_HOLE_DEG = 20.0
# Few points leave larger caps empty: one that should hold so many of them, and holds none, is no accident (e^-5).
_EXPECTED = 5.0


def covered_directions(corrected: ArrayLike) -> NDArray[np.bool_]:
    """Return which directions of `SPHERE` calibrated points cover.

    Parameters
    ----------
    corrected : array_like, shape (n, 3)
        Calibrated points, seen from the origin; length does not matter.

    Notes
    -----
    Not covered is what an empty cap of 20 degrees can be laid over; the cap is larger for fewer
    than 332 points: as large as would hold five of n spread over the whole sphere.
    """
    directions = _normalised(corrected)
    if not len(directions):
        return np.zeros(len(SPHERE), dtype=np.bool_)
    cosine = max(-1.0, min(float(np.cos(np.radians(_HOLE_DEG))), 1.0 - 2.0 * _EXPECTED / len(directions)))
    from scipy.spatial import KDTree  # 0.3 s, which a run that measures no coverage need not wait for

    # Not balanced: a tree of a million points takes half a second, a balanced one several.
    chords, _ = KDTree(directions, balanced_tree=False, compact_nodes=False).query(SPHERE)
    empty = SPHERE[1.0 - chords**2 / 2.0 < cosine]
    if not len(empty):
        return np.ones(len(SPHERE), dtype=np.bool_)
    covered: NDArray[np.bool_] = (SPHERE @ empty.T).max(axis=1) <= cosine
    return covered


def solid_angle_covered(corrected: ArrayLike) -> float:
    """Return the part of the sphere's area that calibrated points cover, 0 to 1; see `covered_directions`."""
    return float(covered_directions(corrected).mean())


def _normalised(vectors: ArrayLike) -> Array:
    points = np.asarray(vectors, dtype=np.float64).reshape(-1, 3)
    lengths = np.linalg.norm(points, axis=1)
    kept: Array = points[lengths > 0.0] / lengths[lengths > 0.0, None]
    return kept
