"""Calibrators of the package ctef, as `hiltest judge` calls them; docs/leaderboard.md has the rules.

The first line of a docstring is the entry's name in the table.
"""

from __future__ import annotations

import numpy as np
from ctef.ctef import ctef
from numpy.typing import NDArray

Reals = NDArray[np.float64]
Calibration = tuple[Reals, Reals]


def cayley_ellipsoid(samples: Reals) -> Calibration:
    """ctef ctef"""
    fit = ctef(samples)
    return fit["center"], _symmetric(fit["Lambda_inv"])


def _symmetric(to_sphere: Reals) -> Reals:
    """Return the symmetric matrix that maps the same ellipsoid onto a sphere."""
    _, lengths, rows = np.linalg.svd(to_sphere)
    return (rows.T * lengths) @ rows
