"""Part of the sphere that calibrated samples cover."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from hiltest.calibration.fit import Array
from hiltest.calibration.quality import sphere_directions

# Directions that represent the sphere, some 4 degrees apart: a part of it is known to about 1 %.
SPHERE = sphere_directions(2000)
# Radius of an empty cap that affects a fit; tracks of a tumble are closer.
_HOLE_DEG = 20.0
# A few points leave larger caps empty: a cap with this expected number of points that has none is significant (e^-5).
_EXPECTED = 5.0


# Number of points above which one per cell of a hundredth by a hundredth by a hundredth represents all: 1 deg apart.
_MANY, _CELLS = 50_000, 100
# Maximum number of points for computing all distances, in 16 MB, and of directions for distances to more, in 20 MB.
_FEW, _BATCH = 1000, 50
# Smallest component of a direction, relative to the largest, that is named.
_NAMED_FROM = 0.5


@dataclass(frozen=True, slots=True)
class Hole:
    """A cap of the sphere without a point."""

    direction: tuple[float, float, float]
    """Direction of its middle, a unit vector in the sensor's axes."""
    radius_deg: float
    """Angle from its middle to the nearest point."""

    @property
    def axes(self) -> str:
        """The direction in words: ``-z``, or ``+x -z`` halfway between both."""
        largest = max(map(abs, self.direction))
        return " ".join(
            f"{'-' if value < 0.0 else '+'}{axis}"
            for axis, value in zip("xyz", self.direction, strict=True)
            if abs(value) >= _NAMED_FROM * largest
        )


def largest_hole(corrected: ArrayLike) -> Hole:
    """Return the largest cap without a calibrated point, shape (n, 3); a whole sphere if there are none."""
    directions = _normalised(corrected)
    if not len(directions):
        return Hole((0.0, 0.0, 1.0), 180.0)
    chords = _nearest_distances(directions)
    middle = int(chords.argmax())
    x, y, z = SPHERE[middle].tolist()
    return Hole((x, y, z), math.degrees(2.0 * math.asin(min(1.0, float(chords[middle]) / 2.0))))


def covered_directions(corrected: ArrayLike) -> NDArray[np.bool_]:
    """Return a mask of the directions of `SPHERE` that calibrated points cover.

    Parameters
    ----------
    corrected : shape (n, 3)
        Calibrated points, seen from the origin; length does not matter.

    Notes
    -----
    A direction is not covered if an empty cap of 20 degrees contains it; the cap is larger for fewer than 332 points:
    as large as would contain five of n points spread over the whole sphere.
    """
    directions = _normalised(corrected)
    if not len(directions):
        return np.zeros(len(SPHERE), dtype=np.bool_)
    cosine = max(-1.0, min(float(np.cos(np.radians(_HOLE_DEG))), 1.0 - 2.0 * _EXPECTED / len(directions)))
    empty = SPHERE[1.0 - _nearest_distances(directions) ** 2 / 2.0 < cosine]
    if not len(empty):
        return np.ones(len(SPHERE), dtype=np.bool_)
    covered: NDArray[np.bool_] = (SPHERE @ empty.T).max(axis=1) <= cosine
    return covered


def solid_angle_covered(corrected: ArrayLike) -> float:
    """Return the part of the sphere's area that calibrated points cover, 0 to 1; see `covered_directions`."""
    return float(covered_directions(corrected).mean())


def _nearest_distances(directions: Array) -> Array:
    """Return the chord from each direction of `SPHERE` to the nearest of unit vectors, exact if it is large.

    It is exact for the largest and for all above the radius of an empty cap; others may be too large, but not as large.
    """
    if len(directions) > _MANY:
        edge = 2 * _CELLS + 1
        backwards = np.ascontiguousarray(directions[::-1])
        cells = ((backwards + 1.0) * _CELLS).astype(np.int64) @ (1, edge, edge * edge)
        # Keep the first point of each cell, which is written last in reverse order. This takes 33 MB, and a third of
        # the time of a sort.
        cell_index = np.full(edge**3, -1, dtype=np.int32)
        cell_index[cells] = np.arange(len(cells), dtype=np.int32)
        from scipy.spatial import KDTree  # takes 0.3 s, more than the distances to fewer points

        # Unbalanced, because a balanced tree takes several times as long to build.
        tree = KDTree(backwards[cell_index[cell_index >= 0]], balanced_tree=False, compact_nodes=False)
        return np.asarray(tree.query(SPHERE)[0], dtype=np.float64)
    chords = _chords(SPHERE, directions[:: -(-len(directions) // _FEW)])
    if len(directions) > _FEW:
        largest, cap = 0.0, 2.0 * math.sin(math.radians(_HOLE_DEG) / 2.0)
        for batch in np.array_split(np.argsort(-chords), len(SPHERE) // _BATCH):
            if chords[batch[0]] < min(largest, cap):
                break
            chords[batch] = _chords(SPHERE[batch], directions)
            largest = max(largest, float(chords[batch].max()))
    return chords


def _chords(sphere: Array, directions: Array) -> Array:
    """Return the chord from each unit vector to the nearest of others."""
    chords: Array = np.sqrt(np.maximum(0.0, 2.0 - 2.0 * (sphere @ directions.T).max(axis=1)))
    return chords


def _normalised(vectors: ArrayLike) -> Array:
    points = np.asarray(vectors, dtype=np.float64).reshape(-1, 3)
    lengths = np.linalg.norm(points, axis=1)
    unit: Array = points[lengths > 0.0] / lengths[lengths > 0.0, None]
    return unit
