"""Rotation of a magnetometer against an accelerometer: the one under which the field's dip is the same everywhere."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from hiltest.calibration.axes import ALL_AXES
from hiltest.calibration.fit import Array, points_array

# Rotations about the axes, 90 degrees apart: every rotation is within 63 degrees of one of them.
_STARTS = np.array([axes.matrix for axes in ALL_AXES if not axes.are_left_handed])
# `_GENERATORS[k] @ v` is the cross product of axis k and v.
_GENERATORS = np.cross(np.eye(3)[:, None, :], np.eye(3)[None, :, :]).transpose(0, 2, 1)
_STEPS, _LONGEST_STEP = 30, 0.5


@dataclass(frozen=True, slots=True, eq=False)
class ConstantDip:
    """Rotation that takes directions of the field to the accelerometer's axes."""

    rotation: Array
    """Shape (3, 3)."""
    spread: float
    """Standard deviation of the dot product of turned field and gravity, both of length 1."""
    spread_unturned: float
    """The same without a rotation."""

    @property
    def angle_deg(self) -> float:
        """Angle of the rotation [deg]."""
        # From the chord, which is accurate for small angles, unlike the arc cosine of the trace.
        half_sine = float(np.linalg.norm(self.rotation - np.eye(3))) / math.sqrt(8.0)
        return 2.0 * math.degrees(math.asin(min(1.0, half_sine)))


def fit_constant_dip(field: ArrayLike, gravity: ArrayLike) -> ConstantDip:
    """Return the rotation under which the dot product of field and gravity varies least.

    Parameters
    ----------
    field, gravity : shape (n, 3)
        Corrected readings of length 1 at the same instants, each in the axes of its own sensor; attitudes in all
        directions.

    Notes
    -----
    For ``g . R m`` only the covariance of the nine products ``g_i m_j`` is needed: with r the elements of R its
    variance is ``r' C r``. Gauss-Newton steps on the rotations from each of the 24 turns about the axes, and the least
    of them: the variance has minima besides. Where the dip is near 90 degrees nothing shows a turn about the field, and
    no compass works.
    """
    points, down = points_array(field), points_array(gravity)
    products = (down[:, :, None] * points[:, None, :]).reshape(-1, 9)
    covariance = np.cov(products, rowvar=False, bias=True)
    rotations = _STARTS.copy()
    for _ in range(_STEPS):
        slopes = (_GENERATORS @ rotations[:, None]).reshape(-1, 3, 9)
        pulled = slopes @ covariance
        normal = pulled @ slopes.transpose(0, 2, 1)
        # Smallest regularisation that avoids a division by zero for an undetermined rotation.
        normal += 1e-12 * np.eye(3)
        step = np.linalg.solve(normal, -(pulled @ rotations.reshape(-1, 9, 1)))[..., 0]
        length = np.linalg.norm(step, axis=1, keepdims=True)
        half = np.tensordot(step * np.minimum(1.0, _LONGEST_STEP / np.maximum(length, 1e-12)), _GENERATORS, 1) / 2.0
        # Cayley's map: a rotation to the last bit, and to second order the one of the step.
        rotations = np.linalg.solve(np.eye(3) - half, (np.eye(3) + half) @ rotations)
    rows = rotations.reshape(-1, 9)
    best = int(((rows @ covariance) * rows).sum(axis=1).argmin())
    return ConstantDip(rotations[best], _spread(rotations[best], covariance), _spread(np.eye(3), covariance))


def _spread(rotation: Array, covariance: Array) -> float:
    row = rotation.ravel()
    return math.sqrt(max(0.0, float(row @ covariance @ row)))
