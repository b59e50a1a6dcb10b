"""Attitude that gravity and the magnetic field show by themselves, in float64."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike

from hiltest.orientation.quaternions import Quaternion, from_ned_axes
from hiltest.orientation.tilt_heading import DegenerateFieldError, earth_axes

#: Norms between which a vector counts as one: float32 has room for their squares.
SMALLEST_NORM, LARGEST_NORM = 1e-6, 1e6


def triad(gravity: ArrayLike, field: ArrayLike) -> Quaternion:
    """Return the attitude from gravity and field (TRIAD).

    Raises
    ------
    DegenerateFieldError
        When the norm of one is not between 1e-6 and 1e6, or they are within 0.06 degrees of parallel.
    """
    for name, vector in (("gravity", gravity), ("field", field)):
        norm = float(np.linalg.norm(np.asarray(vector, dtype=np.float64)))
        if not SMALLEST_NORM < norm < LARGEST_NORM:
            raise DegenerateFieldError(f"{name} has a norm of {norm:g}: no attitude")
    return from_ned_axes(earth_axes(gravity, field))
