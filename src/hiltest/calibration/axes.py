"""Axes of a sensor against those of the board, from its readings at known attitudes."""

from __future__ import annotations

import math
from dataclasses import dataclass
from itertools import permutations, product

import numpy as np
from numpy.typing import ArrayLike

from hiltest.calibration.fit import Array

# Largest angle to a signed permutation: neighbours are 90 degrees apart, so within a quarter of that it is unambiguous.
NEAREST_DEG = 22.5
# Smallest ratio of gains: those of soft iron or a part differ by less than a factor of three.
_SMALLEST_GAIN = 1.0 / 3.0
# Largest residual of a map relative to the readings: an attitude known to 3 degrees gives 0.05, an accelerometer offset
# of 0.1 g 0.1, a heading declared wrongly by 90 degrees 0.6, a dip of the wrong sign 0.5.
_LARGEST_RESIDUAL = 0.2
# Smallest relative spread of known vectors along any axis that distinguishes the axis from an offset: tilts of 20
# degrees give 0.1, an operator's half degree 0.009.
_SMALLEST_SPREAD = 0.02
_NAMES = "xyz"


@dataclass(frozen=True, slots=True)
class Axes:
    """Signed permutation of axes: axis i of the sensor reads ``signs[i]`` times axis ``order[i]`` of the board.

    Examples
    --------
    >>> str(Axes((1, 0, 2), (1, 1, -1)))
    'x and y are exchanged, z is negated'
    >>> str(Axes((0, 1, 2), (1, 1, -1)))
    'z is negated (left-handed: no mounting makes it)'
    >>> str(Axes((1, 0, 2), (1, -1, 1)))
    'x and y are exchanged, y is negated (as turned by 90 deg about z)'
    >>> str(Axes((1, 2, 0), (1, 1, 1)))
    'x, y and z are exchanged cyclically: x reads y, y reads z, z reads x'
    """

    order: tuple[int, int, int]
    signs: tuple[int, int, int]

    @property
    def matrix(self) -> Array:
        """Matrix from components along the board's axes to the sensor's readings, shape (3, 3)."""
        rows: Array = np.eye(3)[list(self.order)] * np.array(self.signs, dtype=np.float64)[:, None]
        return rows

    @property
    def are_right(self) -> bool:
        """True if each axis of the sensor equals the board's."""
        return self == RIGHT

    @property
    def are_left_handed(self) -> bool:
        """True if they are mirrored, which no mounting of a part can cause."""
        return float(np.linalg.det(self.matrix)) < 0.0

    @property
    def turn_about_z(self) -> bool:
        """True if the part is turned about its z axis, or not at all."""
        return self.order[2] == 2 and self.signs[2] == 1 and not self.are_left_handed

    def __str__(self) -> str:
        moved = [name for name, axis, other in zip(_NAMES, range(3), self.order, strict=True) if axis != other]
        negated = [name for name, sign in zip(_NAMES, self.signs, strict=True) if sign < 0]
        if len(moved) == len(_NAMES):
            circle = ", ".join(f"{name} reads {_NAMES[axis]}" for name, axis in zip(_NAMES, self.order, strict=True))
            exchange = f"{_list(moved)} exchanged cyclically: {circle}"
        else:
            exchange = f"{_list(moved)} exchanged" if moved else ""
        sign = f"{_list(negated)} negated" if negated else ""
        return ", ".join(filter(None, (exchange, sign))) + self._meaning()

    def _meaning(self) -> str:
        """Return a possible cause: a mounting turned about one axis, or that none exists; empty for other rotations."""
        if self.are_left_handed:
            return " (left-handed: no mounting makes it)"
        turned = self.matrix.T  # the sensor's axes in the board's frame
        unchanged = [axis for axis in range(3) if turned[axis, axis] == 1.0]
        if len(unchanged) != 1:
            return ""
        second, third = (unchanged[0] + 1) % 3, (unchanged[0] + 2) % 3
        sine, cosine = turned[third, second] + 0.0, turned[second, second]  # no negative zero: half a turn is positive
        degrees = round(math.degrees(math.atan2(sine, cosine)))
        return f" (as turned by {degrees} deg about {_NAMES[unchanged[0]]})"


RIGHT = Axes((0, 1, 2), (1, 1, 1))
ALL_AXES = tuple(
    Axes((order[0], order[1], order[2]), (signs[0], signs[1], signs[2]))
    for order in permutations(range(3))
    for signs in product((1, -1), repeat=3)
)
"""All 48 signed permutations of three axes."""


@dataclass(frozen=True, slots=True, eq=False)
class LinearMap:
    """Linear map from a known vector to a sensor's reading: ``reading = matrix @ known + offset``."""

    matrix: Array
    """Shape (3, 3)."""
    offset: Array
    """Shape (3,). In the unit of the readings."""
    residual: float
    """rms residual, relative to the readings' strength."""

    @property
    def is_right(self) -> bool:
        """True if it is near the identity."""
        return self.axes == RIGHT

    @property
    def axes(self) -> Axes | None:
        """Nearest signed permutation; None if it is near none, or does not explain the readings.

        Notes
        -----
        For any symmetric distortion before or after a permutation, the orthogonal factor of the polar decomposition is
        the permutation itself.
        """
        u, gains, right = np.linalg.svd(self.matrix)
        if gains[2] < _SMALLEST_GAIN * gains[0] or not self.residual <= _LARGEST_RESIDUAL:
            return None
        return nearest_axes(u @ right)


def nearest_axes(turn: Array) -> Axes | None:
    """Return the nearest signed permutation of an orthogonal matrix; None if it is near none."""
    nearest = max(ALL_AXES, key=lambda axes: float(np.trace(axes.matrix.T @ turn)))
    left_over = nearest.matrix.T @ turn
    # For a reflection that is near none, the nearest one may be a rotation: the trace is then not that of a rotation.
    if np.linalg.det(left_over) < 0.0 or np.trace(left_over) < 1.0 + 2.0 * math.cos(math.radians(NEAREST_DEG)):
        return None
    return nearest


def linear_map(reference: ArrayLike, readings: ArrayLike, *, offset: ArrayLike | None = None) -> LinearMap | None:
    """Estimate the linear map from known vectors to a sensor's readings, by least squares.

    Parameters
    ----------
    reference : shape (n, 3)
        Field or gravity along the board's axes, in any unit.
    readings : shape (n, 3)
        Readings of the sensor, in any unit.
    offset : shape (3,)
        Its reading in zero field. If omitted it is estimated too, which needs tilted attitudes.

    Returns
    -------
    LinearMap or None
        None if the attitudes do not determine it.
    """
    vectors, rows = np.asarray(reference, dtype=np.float64), np.asarray(readings, dtype=np.float64)
    length = math.sqrt(float((vectors**2).sum(axis=1).mean())) if len(vectors) else 0.0
    about = np.zeros(3) if offset is not None else vectors.mean(axis=0) if len(vectors) else 0.0
    spread = np.linalg.svd(vectors - about, compute_uv=False)
    if len(vectors) <= len(spread) or not spread[-1] > _SMALLEST_SPREAD * length * math.sqrt(len(vectors)):
        return None
    ones = np.ones((len(vectors), 1))
    design = vectors if offset is not None else np.hstack([vectors, length * ones])
    target = rows if offset is None else rows - np.asarray(offset, dtype=np.float64)
    solution: Array = np.linalg.lstsq(design, target, rcond=None)[0].astype(np.float64)
    matrix: Array = solution[:3].T
    zero: Array = length * solution[3] if offset is None else np.asarray(offset, dtype=np.float64)
    strength = math.sqrt(float(((rows - zero) ** 2).sum()))
    residual = math.sqrt(float(((target - design @ solution) ** 2).sum()))
    return LinearMap(matrix, zero, residual / strength if strength else math.inf)


def _list(names: list[str]) -> str:
    *first, last = names
    return f"{', '.join(first)} and {last} are" if first else f"{last} is"
