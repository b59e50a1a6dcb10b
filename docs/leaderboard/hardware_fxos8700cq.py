"""Automatic hard-iron calibration of the FXOS8700CQ; a test compares it with the model of the part."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

Reals = NDArray[np.float64]
COUNTS_PER_UT = 10.0


def m_acal(samples: Reals) -> tuple[Reals, Reals]:
    """M_OFF: the middle of the extremes of each axis, rounded down; the part has no soft iron."""
    counts = np.rint(COUNTS_PER_UT * samples)
    return (counts.max(axis=0) + counts.min(axis=0)) // 2 / COUNTS_PER_UT, np.eye(3)
