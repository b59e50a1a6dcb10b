"""Logs whose rows are of one sensor each, as ``hiltest log`` writes those of several."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

Reals = NDArray[np.float64]


def filled_of(cells: Sequence[str], sensors: Sequence[Sequence[int]]) -> list[bool]:
    """Say of each sensor, given as the places of its columns, whether a row has something of it."""
    return [any(cells[place] for place in places) for places in sensors]


def at_the_gyroscope_s(time_s: Reals, readings: Reals) -> tuple[NDArray[np.bool_], Reals]:
    """Join both sensors at the times of the gyroscope, whose every sample counts in a turn.

    Parameters
    ----------
    time_s : ndarray, shape (n,)
        Not decreasing.
    readings : ndarray, shape (n, 6)
        Of accelerometer and gyroscope; NaN for the one that the row is not of.

    Returns
    -------
    rows : ndarray of bool, shape (n,)
        Those of the gyroscope that are between two of the accelerometer.
    joined : ndarray, shape (sum(rows), 6)
        These, with the acceleration from the line between its neighbours.
    """
    of_gyroscope = np.isfinite(readings[:, 3])
    others_s, others = time_s[~of_gyroscope], readings[~of_gyroscope, :3]
    if not len(others_s):
        return np.zeros(len(time_s), dtype=np.bool_), np.empty((0, 6))
    rows = of_gyroscope & (time_s >= others_s[0]) & (time_s <= others_s[-1])
    joined = readings[rows]
    for axis in range(3):
        joined[:, axis] = np.interp(time_s[rows], others_s, others[:, axis])
    return rows, joined
