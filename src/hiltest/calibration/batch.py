"""Result of a calibrator over many instances at once."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from hiltest.calibration.fit import Array, FitStatus


@dataclass(frozen=True, slots=True, eq=False)
class BatchFit:
    """Calibrations of instances along leading axes, see `MagnetometerFit` for a single one."""

    status: NDArray[np.int8]
    """Shape (...). Values of `FitStatus`. Unlike a single fit, no instance falls back to a sphere."""
    soft_iron: Array
    """Shape (..., 3, 3) [1/count]; NaN if the status is not ELLIPSOID."""
    hard_iron: Array
    """Shape (..., 3) [counts]; likewise."""

    @property
    def is_ellipsoid(self) -> NDArray[np.bool_]:
        """Mask of instances with an ellipsoid, shape (...)."""
        return np.asarray(self.status == FitStatus.ELLIPSOID)
