"""Calibrators of the package fitellipsoid, as `hiltest judge` calls them; docs/leaderboard.md has the rules.

The first line of a docstring is the entry's name in the table.
"""

from __future__ import annotations

import numpy as np
from fitellipsoid.math_func import ellipsoid3d_fitting_dr_svd
from numpy.typing import NDArray

Reals = NDArray[np.float64]
Calibration = tuple[Reals, Reals]


def fitellipsoid_dr(samples: Reals) -> Calibration:
    """fitellipsoid ellipsoid3d_fitting_dr_svd"""
    _, _, quadric, linear, constant = ellipsoid3d_fitting_dr_svd(samples.T)
    hard_iron = -0.5 * np.linalg.solve(quadric, linear)
    lengths, axes = np.linalg.eigh(quadric / (hard_iron @ quadric @ hard_iron - constant))
    return hard_iron, (axes * np.sqrt(lengths)) @ axes.T
