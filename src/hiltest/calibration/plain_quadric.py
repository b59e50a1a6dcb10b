"""The quadric with the least squares of the algebraic distance, for models that add terms to it."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Self

import numpy as np

from hiltest.calibration.conditioning import TRACELESS, CentredPoints
from hiltest.calibration.fit import ELLIPSOID_UNKNOWNS, Array, squared_lengths


@dataclass(frozen=True, slots=True, eq=False)
class PlainQuadric:
    """``|p|^2 + row . parameters = 0``, of shape matrix ``A`` with the trace 3."""

    centred: CentredPoints
    rows: Array
    """Shape (n, 9). `CentredPoints.rows`."""
    target: Array
    """Shape (n,). ``-|p|^2``."""
    parameters: Array

    @classmethod
    def fit(cls, points: Array) -> Self | None:
        """Fit the quadric to points, shape (n, 3); return None if nine or fewer determine none, or all are equal."""
        centred = CentredPoints.centre(points)
        if centred is None or len(points) <= ELLIPSOID_UNKNOWNS:
            return None
        rows, target = centred.rows(), -squared_lengths(centred.points)
        parameters = np.linalg.lstsq(rows.T @ rows, rows.T @ target, rcond=1e-12)[0]
        return cls(centred, rows, target.astype(np.float64), parameters.astype(np.float64))

    @property
    def residuals(self) -> Array:
        """Shape (n,). Algebraic distances."""
        residuals: Array = self.target - self.rows @ self.parameters
        return residuals

    def ellipsoid(self) -> tuple[float, Array] | None:
        """Return the square of the radius, and the slopes ``2 A (p - c)``, shape (n, 3); None without an ellipsoid."""
        shape = np.eye(3) + np.tensordot(self.parameters[:5], TRACELESS, axes=1)
        if not float(np.linalg.eigvalsh(shape)[0]) > 0.0:
            return None
        centre = np.linalg.solve(shape, -0.5 * self.parameters[5:8])
        slopes: Array = 2.0 * (self.centred.points - centre) @ shape
        return float(centre @ shape @ centre - self.parameters[8]), slopes
