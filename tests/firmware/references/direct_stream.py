"""`direct-stream`: sums of points in whole numbers, and the fit of `direct` from them."""

from __future__ import annotations

from collections.abc import Sequence
from itertools import product
from math import prod

import numpy as np

from hiltest.calibration.direct import fit_about
from hiltest.calibration.fit import ELLIPSOID_UNKNOWNS, FitStatus, MagnetometerFit, no_fit
from hiltest.link.streams import StreamStatus

# Sums of degree 2 of so many points with coordinates up to this fit the firmware's 32 bits.
LARGEST_COUNTS = 2047
MOST_POINTS = 512

MONOMIALS = tuple(
    "".join("xyz"[axis] * power for axis, power in enumerate(powers))
    for degree in range(1, 5)
    for powers in sorted(product(range(degree + 1), repeat=3), reverse=True)
    if sum(powers) == degree
)

Point = tuple[int, int, int]


class DirectStream:
    """Exact model of the firmware's sums, and the float64 fit of the points in them.

    Attributes
    ----------
    sums : dict of str to int
        Of each monomial of degree 1 to 4, named ``x`` to ``zzzz`` in the order of the firmware, coordinates
        relative to the anchor [counts^degree].
    anchor : tuple of int
        The first point since there was none [counts].
    """

    def __init__(self) -> None:
        self.sums = dict.fromkeys(MONOMIALS, 0)
        self.anchor: Point = (0, 0, 0)
        self._points: list[Point] = []

    @property
    def held(self) -> int:
        """Points in the sums."""
        return len(self._points)

    def add(self, point: Sequence[int]) -> StreamStatus:
        """Add a point, unless it is too far from the anchor or one too many."""
        x, y, z = map(int, point)
        if self.held == MOST_POINTS:
            return StreamStatus.FULL
        anchor = self.anchor if self._points else (x, y, z)
        if not _fits((x, y, z), anchor):
            return StreamStatus.OUT_OF_RANGE
        self.anchor = anchor
        self._points.append((x, y, z))
        self._accumulate((x, y, z), 1)
        return StreamStatus.OK

    def remove(self, point: Sequence[int]) -> StreamStatus:
        """Take a point away that was added before.

        Raises
        ------
        ValueError
            When it was not: the firmware does not know, and is wrong from then on.
        """
        x, y, z = map(int, point)
        if not self._points:
            return StreamStatus.EMPTY
        if not _fits((x, y, z), self.anchor):
            return StreamStatus.OUT_OF_RANGE
        self._points.remove((x, y, z))
        self._accumulate((x, y, z), -1)
        return StreamStatus.OK

    def mean(self) -> Point:
        """Return the mean of the points relative to the anchor, fractions cut off [counts]."""
        x, y, z = (_divide(self.sums[axis], self.held) for axis in "xyz")
        return x, y, z

    def moments_about_mean(self) -> dict[str, int]:
        """Return the sums with coordinates relative to `mean`."""
        origin = [anchor + mean for anchor, mean in zip(self.anchor, self.mean(), strict=True)]
        moved = [tuple(c - o for c, o in zip(point, origin, strict=True)) for point in self._points]
        return {name: sum(_monomial(name, point) for point in moved) for name in MONOMIALS}

    def fit(self) -> MagnetometerFit:
        """Fit the quadric of unit trace about the mean, as `direct` does about the middle of the range."""
        if self.held < ELLIPSOID_UNKNOWNS:
            return no_fit(FitStatus.TOO_FEW_POINTS)
        origin = np.array(self.anchor) + np.array(self.mean())
        return fit_about(np.array(self._points, dtype=np.float64), origin.astype(np.float64))

    def _accumulate(self, point: Point, sign: int) -> None:
        moved = tuple(c - a for c, a in zip(point, self.anchor, strict=True))
        for name in MONOMIALS:
            self.sums[name] += sign * _monomial(name, moved)


def _fits(point: Point, anchor: Point) -> bool:
    return all(abs(c - a) <= LARGEST_COUNTS for c, a in zip(point, anchor, strict=True))


def _monomial(name: str, point: Sequence[int]) -> int:
    return prod(point["xyz".index(axis)] for axis in name)


def _divide(total: int, count: int) -> int:
    return total // count if total >= 0 else -(-total // count)
