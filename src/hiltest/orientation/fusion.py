"""The fusion filter in float64: its noise settings, and its attitudes from given rates and measured attitudes."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from hiltest.orientation.quaternions import (
    Quaternion,
    from_ned_axes,
    from_rotation_vector,
    left_columns,
    normalised,
    right_matrix,
)
from hiltest.orientation.tilt_heading import DegenerateFieldError, earth_axes

# Norms between which a vector counts as one: float32 has room for their squares.
_SMALLEST_NORM, _LARGEST_NORM = 1e-6, 1e6


@dataclass(frozen=True, slots=True)
class FusionNoise:
    """Assumed noise of the sensors in the filter."""

    rate_dps_rthz: float
    """Density of the rate's noise [deg/s per root hertz], including an allowance for the gyroscope's other errors."""
    tilt_deg: float
    heading_deg: float
    """Standard deviation of one TRIAD attitude about a level axis, and about the vertical."""
    gate_g: float = 0.1
    """Largest deviation of gravity's norm from 1 g at which it is used."""


def heading_sigma_deg(*, field_sigma: float, tilt_deg: float, dip_deg: float) -> float:
    """Return the standard deviation of one TRIAD heading [deg].

    Parameters
    ----------
    field_sigma
        rms noise of one axis of the field, relative to the field's strength.
    tilt_deg
        rms error of the accelerometer's tilt about one axis.
    dip_deg
        Dip of the field.

    Notes
    -----
    Noise of the field acts relative to its horizontal part; an error of tilt moves the vertical part into the
    horizontal plane: ``(field_sigma / cos(dip))^2 + (tilt tan(dip))^2``.
    """
    dip = math.radians(dip_deg)
    return math.hypot(math.degrees(field_sigma) / math.cos(dip), tilt_deg * math.tan(dip))


def triad(gravity: ArrayLike, field: ArrayLike) -> Quaternion:
    """Return the attitude from gravity and field (TRIAD).

    Raises
    ------
    DegenerateFieldError
        When the norm of one is not between 1e-6 and 1e6, or they are within 0.06 degrees of parallel.
    """
    for name, vector in (("gravity", gravity), ("field", field)):
        norm = float(np.linalg.norm(np.asarray(vector, dtype=np.float64)))
        if not _SMALLEST_NORM < norm < _LARGEST_NORM:
            raise DegenerateFieldError(f"{name} has a norm of {norm:g}: no attitude")
    return from_ned_axes(earth_axes(gravity, field))


def fuse(
    first: Quaternion,
    turns_rad: NDArray[np.float64],
    steps_s: NDArray[np.float64],
    measured: NDArray[np.float64],
    noise: FusionNoise,
) -> NDArray[np.float64]:
    """Return the attitudes of the filter, and of the gyroscope alone, after each of n steps.

    Parameters
    ----------
    first
        Attitude before the first step, as good as a measured one.
    turns_rad : shape (n, 3)
        Rotation vectors of the predictions, in the body frame.
    steps_s : shape (n,)
        Their durations.
    measured : shape (n, 4)
        Measured attitudes of either sign that correct the predictions; NaN for none.

    Returns
    -------
    ndarray, shape (n, 2, 4)

    Notes
    -----
    Mucciaccia's equations (28), (33) and (34). The covariance is diagonal in the directions of `left_columns`, as
    firmware_stub/orientation/fusion.h derives.
    """
    rate_variance, *own = np.radians([noise.rate_dps_rthz, noise.tilt_deg, noise.tilt_deg, noise.heading_deg]) ** 2
    own_variances = variances = np.array(own)
    attitudes, results = np.array([first, first]), np.empty((len(steps_s), 2, 4))
    for index, turn in enumerate(right_matrix(from_rotation_vector(turns_rad))):
        attitudes = attitudes @ turn.T
        variances = variances + rate_variance * steps_s[index]
        if not math.isnan(measured[index, 0]):
            fused, axes = attitudes[0], left_columns(attitudes[0])
            gains = variances / (variances + own_variances)
            nearer = math.copysign(1.0, measured[index] @ fused)
            attitudes[0] = normalised(fused + nearer * axes @ (gains * (axes.T @ measured[index])))
            variances = variances - gains * variances
        results[index] = attitudes
    return results
