"""Sets of magnetometer points, as inputs of the firmware's calibrators."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from hiltest.calibration.fit import ELLIPSOID_UNKNOWNS, FitStatus
from hiltest.calibration.quality import COUNTS_PER_UT
from hiltest.studies.board_calibrators import BoardCalibrators
from hiltest.studies.worst_case.search import Call

Points = NDArray[np.int16]

MOST_POINTS = 512
"""Capacity of the firmware's buffer."""
_COUNTS = np.iinfo(np.int16)
# Bounds of the parameters of a world and its points, which follow the number of points.
_WORLD = (
    (25.0, 65.0),  # strength of the earth's field, from the South Atlantic to the poles [uT]
    (0.0, 2.0),  # noise of a point on each axis, up to five times that of the default rig's sensor [uT]
    (0.1, 1.0),  # share of the sphere that the points cover: a cap about an axis
    (-1.0, 1.0),  # third coordinate of that axis
    (0.0, 2.0 * np.pi),  # azimuth of that axis [rad]
    *((0.6, 1.4),) * 3,  # diagonal of the symmetric soft iron
    *((-0.25, 0.25),) * 3,  # its other elements; the matrix is never singular
    *((-100.0, 100.0),) * 3,  # hard iron, as in the studies [uT]
    (0.0, 1e6),  # index of the set of random numbers
)


class PointSets:
    """The inputs of a calibrator.

    Parameters
    ----------
    name
        Name of the calibrator.
    most_points
        Size of the largest set; the smallest has `hiltest.calibration.fit.ELLIPSOID_UNKNOWNS` points.
    """

    def __init__(self, calibrators: BoardCalibrators, name: str, most_points: int) -> None:
        self._calibrators, self._name, self._most = calibrators, name, most_points
        self.bounds = np.array([(ELLIPSOID_UNKNOWNS, most_points), *_WORLD])

    def make_input(self, numbers: NDArray[np.float64]) -> Points:
        """Draw the points of a world."""
        count, strength_ut, noise_ut, share, height, azimuth = numbers[:6]
        iron = np.diag(numbers[6:9])
        iron[(0, 0, 1), (1, 2, 2)] = iron[(1, 2, 2), (0, 0, 1)] = numbers[9:12]
        random = np.random.default_rng(int(numbers[15]))
        directions = _cap(round(count), share, random) @ _turn_to(height, azimuth)
        noise = random.standard_normal(directions.shape)
        return _round_counts(COUNTS_PER_UT * (strength_ut * directions @ iron + numbers[12:15] + noise_ut * noise))

    def vary(self, base: Points, random: np.random.Generator) -> Points:
        """Distort all points slightly, or change some of them, their number or their order."""
        points = base.astype(np.float64)
        choice = random.random()
        if choice < 0.2:
            mean = points.mean(axis=0)
            distortion = np.eye(3) + 10.0 ** random.uniform(-4.0, -0.5) * random.standard_normal((3, 3))
            return _round_counts(mean + (points - mean) @ distortion)
        if choice < 0.3 and len(points) < self._most:
            more = random.integers(1, self._most - len(points), endpoint=True)
            copies = points[random.integers(len(points), size=more)]
            return _round_counts(np.concatenate([points, copies + 3.0 * random.standard_normal(copies.shape)]))
        if choice < 0.35 and len(points) > ELLIPSOID_UNKNOWNS:
            return np.delete(base, random.integers(len(points)), axis=0)
        if choice < 0.4:
            return random.permutation(base)
        # Usually a few points, rarely most of them.
        some = random.integers(len(points), size=round(len(points) ** random.random()))
        if choice < 0.9:
            points[some] += 10.0 ** random.uniform(0.0, 3.0, (len(some), 1)) * random.standard_normal((len(some), 3))
        else:
            points[some] = points[random.integers(len(points), size=len(some))]
        return _round_counts(points)

    def call(self, points: Points) -> Call:
        """Run the calibrator on the points; only an ellipsoid counts as success."""
        fit, cycles = self._calibrators.calibrate(self._name, points.astype(np.float64))
        return Call(cycles, int(fit.status), fit.status is FitStatus.ELLIPSOID)

    def saved_fields(self, points: Points) -> dict[str, tuple[tuple[int, ...], ...]]:
        """Return the points as fields of a `WorstCase`."""
        return {"points": tuple(map(tuple, points.tolist()))}


def _cap(count: int, share: float, random: np.random.Generator) -> NDArray[np.float64]:
    """Return uniformly random directions in a cap about the third axis, shape (n, 3)."""
    z = 1.0 - 2.0 * share * random.random(count)
    radius, turn = np.sqrt(np.maximum(1.0 - z * z, 0.0)), 2.0 * np.pi * random.random(count)
    return np.column_stack([radius * np.cos(turn), radius * np.sin(turn), z])


def _turn_to(height: float, azimuth: float) -> NDArray[np.float64]:
    """Return Householder's reflection that maps the third axis to an axis."""
    radius = np.sqrt(max(1.0 - height * height, 0.0))
    normal = np.array([-radius * np.cos(azimuth), -radius * np.sin(azimuth), 1.0 - height])
    squared = normal @ normal
    return np.eye(3) - (2.0 / squared * np.outer(normal, normal) if squared > 0.0 else 0.0)


def _round_counts(points: NDArray[np.float64]) -> Points:
    return np.clip(np.rint(points), _COUNTS.min, _COUNTS.max).astype(np.int16)
