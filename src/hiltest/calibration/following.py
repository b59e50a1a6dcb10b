"""Hard iron that follows other quantities, such as a motor's current, from points of an ellipsoid."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from hiltest.calibration.fit import ELLIPSOID_UNKNOWNS, Array, points_array
from hiltest.calibration.plain_quadric import PlainQuadric
from hiltest.errors import CalibrationError

# The equations are linear except for the product of the vectors with the shape: each pass corrects that.
_PASSES = 6
# Parts of the log in time, each of which is left out once.
_BLOCKS = 20
# Largest condition of the equations with columns of equal size: the quantities must change, and by themselves.
_LARGEST_CONDITION = 1e8


@dataclass(frozen=True, slots=True, eq=False)
class FollowingIron:
    """Result: the hard iron moves by ``vectors.T @ (values - reference)``."""

    vectors: Array
    """Shape (quantities, 3). In the unit of the points per unit of the quantity."""
    errors: Array
    """Shape (quantities,). Standard deviation of each vector: the root of the sum over its components."""
    before_percent: float
    after_percent: float
    """rms distance from the ellipsoid relative to the radius, without and with the vectors."""

    @property
    def explained(self) -> float:
        """Part of the squared distances without the vectors that these explain, 0 to 1."""
        return max(0.0, 1.0 - (self.after_percent / self.before_percent) ** 2)


def fit_following(points: ArrayLike, values: ArrayLike) -> FollowingIron:
    """Fit an ellipsoid together with vectors of hard iron that quantities are multiplied with.

    Parameters
    ----------
    points : shape (n, 3)
        Readings in the order of time.
    values : shape (n, quantities)
        Quantities, relative to the ones at which the hard iron is stated.

    Raises
    ------
    CalibrationError
        When there are too few points, or these do not determine the vectors.

    Notes
    -----
    With the rows d of `CentredPoints.rows` and the slope ``g = 2 A (p - c)``, a vector v that moves the centre by
    ``v x`` leaves ``|p|^2 + d . t - x g . v``, linear in t and v. The points minus ``v x`` are fitted again until v is
    constant. The deviation is a jackknife over 20 blocks in time, because disturbances last.
    """
    readings, quantities = points_array(points), np.asarray(values, dtype=np.float64)
    count = quantities.shape[1]
    if len(readings) < 2 * (ELLIPSOID_UNKNOWNS + 3 * count) + _BLOCKS:
        raise CalibrationError(f"{len(readings)} readings are too few for iron that follows a column; take more")
    scale = np.maximum(np.abs(quantities).max(axis=0), np.finfo(float).tiny)
    relative, vectors, before, size = quantities / scale, np.zeros((count, 3)), 0.0, 1.0
    for index in range(_PASSES + 1):
        quadric = PlainQuadric.fit(readings - relative @ vectors)
        ellipsoid = None if quadric is None else quadric.ellipsoid()
        if quadric is None or ellipsoid is None:
            raise CalibrationError("the readings are on no ellipsoid, also with the column; turn in all directions")
        size, (square, slopes) = quadric.centred.scale, ellipsoid
        residual_percent = 50.0 * float(np.sqrt(np.mean(quadric.residuals**2))) / square
        before = before if index else residual_percent
        moved = (-relative[:, :, None] * slopes[:, None, :]).reshape(len(readings), -1)
        every = np.column_stack([quadric.rows, moved, quadric.target])
        sums = np.array([part.T @ part for part in np.array_split(every, _BLOCKS)])
        whole = sums.sum(axis=0)
        sizes = np.sqrt(np.maximum(np.diag(whole)[:-1], np.finfo(float).tiny))
        if np.linalg.cond(whole[:-1, :-1] / np.outer(sizes, sizes)) > _LARGEST_CONDITION:
            raise CalibrationError("the column does not change, or not independently: log it over its range")
        if index < _PASSES:
            step = np.linalg.solve(whole[:-1, :-1], whole[:-1, -1])[ELLIPSOID_UNKNOWNS:]
            vectors = vectors + size * step.reshape(count, 3)
    without = np.array([np.linalg.lstsq(rest[:-1, :-1], rest[:-1, -1], rcond=None)[0] for rest in whole - sums])
    off = size * (without - without.mean(axis=0))[:, ELLIPSOID_UNKNOWNS:].reshape(_BLOCKS, count, 3)
    errors = math.sqrt((_BLOCKS - 1) / _BLOCKS) * np.sqrt((off * off).sum(axis=(0, 2)))
    return FollowingIron(vectors / scale[:, None], errors / scale, before, residual_percent)
