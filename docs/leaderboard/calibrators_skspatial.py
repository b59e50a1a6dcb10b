"""Calibrators of the package scikit-spatial, as `hiltest judge` calls them; docs/leaderboard.md has the rules.

The first line of a docstring is the entry's name in the table.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from skspatial.objects import Sphere

Reals = NDArray[np.float64]
Calibration = tuple[Reals, Reals]


def skspatial_sphere(samples: Reals) -> Calibration:
    """scikit-spatial Sphere.best_fit"""
    return np.array(Sphere.best_fit(samples).point), np.eye(3)
