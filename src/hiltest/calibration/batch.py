"""Result of a calibrator over many instances at once."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from hiltest.calibration.fit import Array, FitStatus


@dataclass(frozen=True, slots=True, eq=False)
class BatchFit:
    """Calibrations of instances along leading axes, as `MagnetometerFit` is of one."""

    status: NDArray[np.int8]
    """Shape (...). Of `FitStatus`. No instance gets the sphere that a single fit falls back to."""
    soft_iron: Array
    """Shape (..., 3, 3) [1/count]; not a number where the status is not ELLIPSOID."""
    hard_iron: Array
    """Shape (..., 3) [counts]; likewise."""

    @property
    def is_ellipsoid(self) -> NDArray[np.bool_]:
        """Which instances have an ellipsoid, shape (...)."""
        return np.asarray(self.status == FitStatus.ELLIPSOID)
