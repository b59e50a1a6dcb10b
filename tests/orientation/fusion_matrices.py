"""The thesis' Kalman filter for attitude, in float64: gyroscope predicts, accelerometer and magnetometer correct.

Mucciaccia 2020, sections 2.4 and 3.4, gives the equations of a Kalman filter, (28), (33) and
(34), and says that a quaternion is filtered with them. What it leaves open is decided here; the
reasons are in docs/fusion.md:

- The state is the attitude alone, (x, y, z, w), body to north-east-down. The gyroscope's bias is not a state: it
  is measured at rest and subtracted before.
- The prediction is ``q F``: the quaternion of the rate, exact for a constant one, on the right.
- Q is what white noise of the rate does to the attitude, the same about every axis:
  ``Q = (density^2 dt / 4) (I - q q')``. There is none along q: its norm is 1 by definition.
- The measurement is a quaternion as well (H = I): TRIAD, which gets down from gravity alone and north from the
  field. Of its two signs the one nearer to the prediction is taken.
- Its covariance ``Sigma_2`` is that of two tilts and a heading: rotations about north and east, and about down.
- Neither covariance has anything along q, so ``Sigma_1 + Sigma_2`` has no inverse there; the pseudo-inverse is
  meant. A large difference then turns the attitude by ``2 atan(gain sin(difference / 2))``.
- The result is brought back to norm 1, and its covariance with it.
- Acceleration: a gravity whose norm is not 1 g within a gate is not used. Where there is no TRIAD,
  nothing is corrected either; the attitude is then predicted on, and its variance grows.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from enum import IntEnum

import numpy as np
from numpy.typing import ArrayLike, NDArray

from hiltest.orientation import DegenerateFieldError
from hiltest.orientation.fusion import FusionNoise, triad
from hiltest.orientation.quaternions import (
    Quaternion,
    from_rotation_vector,
    left_columns,
    normalised,
    right_matrix,
)

IDENTITY: Quaternion = np.array([0.0, 0.0, 0.0, 1.0])
IDENTITY.flags.writeable = False
#: A step that turns by more is refused: it looks like a turn the other way round [rad].
LONGEST_STEP_RAD = math.pi


class FusionStatus(IntEnum):
    """Status of a step; all but OK leave the state unchanged. The firmware has the same numbers."""

    OK = 0
    NO_ATTITUDE = 1
    """Gravity or field is zero or not finite, or they are parallel."""
    ACCELERATED = 2
    """The accelerometer's norm is not 1 g within the gate."""
    BAD_STEP = 3
    """The rate or the time is not finite, the time is negative, or the step is above half a turn."""


@dataclass(frozen=True, slots=True, eq=False)
class Fusion:
    """State of the filter.

    Attributes
    ----------
    attitude : ndarray, shape (4,)
        Unit quaternion (x, y, z, w), body to north-east-down.
    covariance : ndarray, shape (4, 4)
        Covariance of the quaternion: 0 along it.
    """

    attitude: Quaternion
    covariance: NDArray[np.float64]

    def standard_deviations_deg(self) -> NDArray[np.float64]:
        """Return those of the rotations about north, east and down [deg]."""
        axes = left_columns(self.attitude)
        return np.degrees(np.sqrt(4.0 * np.diag(axes.T @ self.covariance @ axes)))


def start(attitude: ArrayLike, noise: FusionNoise) -> Fusion:
    """Begin with an attitude that is as good as one of TRIAD's."""
    unit = normalised(attitude)
    return Fusion(unit, _measured_covariance(unit, noise))


def predict(state: Fusion, rate_dps: ArrayLike, dt_s: float, noise: FusionNoise) -> tuple[Fusion, FusionStatus]:
    """Turn the attitude by a rate: the thesis' equation (28).

    Parameters
    ----------
    rate_dps : array_like, shape (3,)
        About the body's axes, bias removed [deg/s]; over the step it counts as constant.
    dt_s : float
        The step.
    """
    with np.errstate(invalid="ignore", over="ignore"):  # infinite times nothing: refused below
        turn_rad = np.radians(np.asarray(rate_dps, dtype=np.float64)) * dt_s
    angle_rad = float(np.linalg.norm(turn_rad))
    if not (0.0 <= dt_s < math.inf and angle_rad <= LONGEST_STEP_RAD):
        return state, FusionStatus.BAD_STEP
    forward = right_matrix(from_rotation_vector(turn_rad))
    attitude = normalised(forward @ state.attitude)
    spread = 0.25 * math.radians(noise.rate_dps_rthz) ** 2 * dt_s * (np.eye(4) - np.outer(attitude, attitude))
    return Fusion(attitude, forward @ state.covariance @ forward.T + spread), FusionStatus.OK


def update(state: Fusion, gravity_g: ArrayLike, field: ArrayLike, noise: FusionNoise) -> tuple[Fusion, FusionStatus]:
    """Correct the attitude by one of TRIAD: the thesis' equations (33) and (34).

    Parameters
    ----------
    gravity_g : array_like, shape (3,)
        Gravity-positive accelerometer, calibrated [g].
    field : array_like, shape (3,)
        Corrected magnetic field, any scale.
    """
    try:
        measured = triad(gravity_g, field)
    except DegenerateFieldError:
        return state, FusionStatus.NO_ATTITUDE
    if not abs(float(np.linalg.norm(np.asarray(gravity_g, dtype=np.float64))) - 1.0) <= noise.gate_g:
        return state, FusionStatus.ACCELERATED
    before, predicted = state.attitude, state.covariance
    if measured @ before < 0.0:
        measured = -measured
    # Both are 0 along q and nowhere else: what is added there makes the inverse the pseudo-inverse.
    total = predicted + _measured_covariance(before, noise) + np.outer(before, before)
    gain = predicted @ np.linalg.inv(total)
    attitude = normalised(before + gain @ (measured - before))
    # The covariance belongs to the directions across the old attitude: it is carried to those across the new one.
    carry = right_matrix(product(conjugate(before), attitude))
    return Fusion(attitude, carry @ (predicted - gain @ predicted) @ carry.T), FusionStatus.OK


def _measured_covariance(attitude: Quaternion, noise: FusionNoise) -> NDArray[np.float64]:
    axes = left_columns(attitude)
    variances = np.radians([noise.tilt_deg, noise.tilt_deg, noise.heading_deg]) ** 2
    spread: NDArray[np.float64] = 0.25 * axes @ np.diag(variances) @ axes.T
    return spread


def product(first: ArrayLike, second: ArrayLike) -> Quaternion:
    """Return Hamilton's product: what `second` does in the frame that `first` has made."""
    x, y, z, w = np.asarray(second, dtype=np.float64)
    return right_matrix((x, y, z, w)) @ np.asarray(first, dtype=np.float64)


def conjugate(quaternion: ArrayLike) -> Quaternion:
    """Return the opposite turn of a unit quaternion."""
    return np.asarray(quaternion, dtype=np.float64) * (-1.0, -1.0, -1.0, 1.0)


def angle_between_deg(first: ArrayLike, second: ArrayLike) -> float:
    """Return the smallest rotation that takes one attitude to another [deg]; signs do not matter."""
    between = product(conjugate(first), second)
    return math.degrees(2.0 * math.atan2(float(np.linalg.norm(between[:3])), abs(float(between[3]))))
