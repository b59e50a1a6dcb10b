"""Points spread over directions: the buffer of the public sensor-fusion libraries, release 5.00, in whole numbers."""

from __future__ import annotations

import math
from collections.abc import Sequence

ROWS = 14
ROW_CELLS = 2 * ROWS
FULL = 340
MESH_COUNTS = 50

# 100 tan of what separates one row from the next, fractions cut off.
LIMITS = tuple(int(100.0 * math.tan(math.pi * (-0.5 + (i + 1) / ROWS))) for i in range(ROWS - 1))

Point = tuple[int, int, int]


def cell_of(x: int, y: int, z: int) -> int | None:
    """Return the cell of a direction; None for one in the plane z = 0."""
    if z == 0:
        return None
    return _strip(x, z) * ROW_CELLS + _strip(y, z) + (ROWS if x < 0 else 0)


def _strip(numerator: int, denominator: int) -> int:
    magnitude = abs(100 * numerator) // abs(denominator)
    ratio = magnitude if (numerator < 0) == (denominator < 0) else -magnitude
    wrapped = (ratio + 0x8000) % 0x10000 - 0x8000
    return sum(limit <= wrapped for limit in LIMITS)


class MagneticBuffer:
    """Raw points [counts] by the direction of the calibrated field.

    Attributes
    ----------
    cells : dict of int to (point, time)
        Those that are not empty.
    """

    def __init__(self) -> None:
        self.cells: dict[int, tuple[Point, int]] = {}

    @property
    def points(self) -> list[Point]:
        """Points held, in the order of their cells."""
        return [point for _, (point, _) in sorted(self.cells.items())]

    def store(self, cell: int, point: Sequence[int], time: int) -> None:
        """Store a point, or drop it when its cell is taken and another point is near."""
        x, y, z = map(int, point)
        entry = ((x, y, z), time)
        is_full = len(self.cells) == FULL
        if cell not in self.cells:
            self.cells[cell] = entry
            if is_full:
                del self.cells[min(self.cells, key=lambda cell: self.cells[cell][1])]
        elif is_full or _distance(self.cells[cell][0], entry[0]) < MESH_COUNTS:
            self.cells[cell] = entry
        elif all(_distance(other, entry[0]) >= MESH_COUNTS for other, _ in self.cells.values()):
            self.cells[max(set(range(ROWS * ROW_CELLS)) - set(self.cells))] = entry


def _distance(first: Point, second: Point) -> int:
    return sum(abs(a - b) for a, b in zip(first, second, strict=True))
