"""Error of calibrated directions, predicted from the points without any truth."""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import ArrayLike

from hiltest.calibration.conditioning import (
    CONDITION_SINGULAR,
    LARGEST_CONDITION,
    TRACELESS,
    WELL_CONDITIONED,
    CentredPoints,
    condition_of,
    ellipsoid_condition,
)
from hiltest.calibration.corrected import calibration_from_sums, power_sums
from hiltest.calibration.fit import ELLIPSOID_UNKNOWNS, Array, FitStatus, MagnetometerFit, squared_lengths
from hiltest.calibration.quadric import Quadric, calibration_from_quadric
from hiltest.calibration.quality import sphere_directions

# Step of the central differences: their error is its square, and float64 rounding is 1e-16 divided by it.
_STEP = 1e-5
#: Number of parts of a log in time for the jackknife. Halves of nine recorded logs differ by 1.30 times the prediction
#: in the median with 20 parts, 1.12 with 12, 0.87 with 8 and 0.76 with 6, because disturbances last for a minute; the
#: errors of 40 simulated logs of independent noise are 1.0 to 1.1 times the predicted ones with each.
BLOCKS = 8
#: Largest predicted error that is stated: linear propagation predicts the tangent of an angle, which is 10 % larger
#: than the angle here, and has no bound above.
LARGEST_PREDICTED_DEG = 30.0
# Five points per block; with fewer points the residual is more informative. A half has as many blocks as the whole.
_FEWEST_FOR_BLOCKS = 5 * BLOCKS
_FEWEST_FOR_HALVES = 2 * _FEWEST_FOR_BLOCKS
# Smaller predictions are rounding: of points without noise.
_EXACT_DEG = 1e-6
# Error to assume if the fit without one block has no ellipsoid.
_NO_DIRECTION_DEG = 90.0


@dataclass(frozen=True, slots=True)
class DirectionError:
    """Predicted error of calibrated directions, rms over the sphere."""

    spread_deg: float
    """Standard deviation between logs of the same length."""
    bias_deg: float
    """Bias that all logs share, because noise in the points is also noise in the equations; independent of n."""

    @property
    def rms_deg(self) -> float:
        """Root of the sum of squares of both."""
        return math.hypot(self.spread_deg, self.bias_deg)


def predicted_direction_error(
    points: ArrayLike, fit: MagnetometerFit, *, unbiased: bool = False
) -> DirectionError | None:
    """Predict the error of calibrated directions from the points' deviations from an ellipsoid.

    Parameters
    ----------
    points : shape (n, 3)
        Points that the calibration was fitted to, in its unit, in the order of time.
    unbiased
        True if the calibrator has removed the noise bias, as `corrected` does with its steps.

    Returns
    -------
    DirectionError or None
        Prediction; None without an ellipsoid, or if the points do not determine one.

    Notes
    -----
    The spread is a jackknife over 8 blocks in time (Quenouille; Efron, The jackknife, 1982): with ``u_b(k)`` the
    direction k of the fit without block b, ``spread^2 = 7/8 sum_b mean_k |u_b - mean u|^2``. Sums over the blocks add
    up, so a fit without one block needs no pass over the points. Disturbances of a real log last longer than a reading,
    so the residual's variance over n is three times too small in the median, and up to 85 times. Slow changes that
    outlast a block (temperature, place) differ between the first and the second half: in nine recorded logs, halves
    differ by 1.23 times the prediction from 20 blocks in the median, halves of blocks dealt out at random by 0.75. If
    the halves determine ellipsoids well, and differ by more than their spreads predict, the spread is multiplied by
    that ratio: with a hard iron that drifts by 1 uT within a minute, the error of logs of 40 s is 1.02 deg, the
    prediction 0.43 without and 0.75 with it. Fewer than 40
    points have no blocks, and the spread is that of independent noise: with the rows d of `CentredPoints.rows`, ``M =
    sum d d'``, the parameters t and ``e = |p|^2 + d . t``, ``sigma2 = sum e^2 / (n - 9)``, the parameters' covariance
    is ``sigma2 M^-1``, and a Jacobian converts it to directions.

    Noise of variance ``s2 = sigma2 / mean |grad e|^2`` in the points also correlates rows with residuals, which moves
    the parameters by ``-s2 M^-1 sum (grad d . grad e)``. Up to half the sphere that bias dominates: at 1 uT, n = 1000
    and half the sphere the spread is 0.22 of the error.

    The spread of a calibrator other than `corrected` is that of `direct`. Both parts together are within 20 % of the
    error of `direct` for 40 to 100 % of the sphere, 0.4 and 1 uT, 100 and 1000 points. For `iterative`, whose
    normalisation makes a smaller bias, they are up to twice the error on half the sphere or less.
    """
    return ErrorPrediction(points).predict(fit, unbiased=unbiased)


class ErrorPrediction:
    """Predictor like `predicted_direction_error`, for several calibrations of the same points.

    Terms that only depend on the points are computed once, which is most of the work for a million of them.
    """

    def __init__(self, points: ArrayLike) -> None:
        self._centred = CentredPoints.centre(points)
        self._spreads_deg: dict[bool, float] = {}

    def predict(self, fit: MagnetometerFit, *, unbiased: bool = False) -> DirectionError | None:
        """Return the predicted error of one calibration."""
        centred = self._centred
        if fit.status is not FitStatus.ELLIPSOID or centred is None or len(centred.points) <= ELLIPSOID_UNKNOWNS:
            return None
        shape, centre, parameters = _frame_parameters(fit, centred)
        jacobian = _direction_jacobian(parameters)
        if jacobian is None or self._inverse is None:
            return None
        residuals = self._squares + self._rows @ parameters
        variance = float(residuals @ residuals) / (len(residuals) - ELLIPSOID_UNKNOWNS)
        slopes = 2.0 * (centred.points - centre) @ shape
        noise_variance = variance / float(squared_lengths(slopes).mean())
        bias = np.zeros(ELLIPSOID_UNKNOWNS)
        if not unbiased:
            bias = -noise_variance * self._inverse @ _rows_along(slopes, centred)
        if len(residuals) < _FEWEST_FOR_BLOCKS:
            spread_deg = _rms_deg(jacobian, (variance * self._inverse).astype(np.float64))
        else:
            if unbiased not in self._spreads_deg:
                lasting = self.halves_difference if self._halves_condition <= WELL_CONDITIONED else None
                self._spreads_deg[unbiased] = _jackknife(self._pieces[::2] + self._pieces[1::2], unbiased)[1]
                self._spreads_deg[unbiased] *= max(1.0, lasting or 0.0)
            spread_deg = self._spreads_deg[unbiased]
        return DirectionError(spread_deg, _rms_deg(jacobian, np.outer(bias, bias)))

    @cached_property
    def _rows(self) -> Array:
        return np.empty((0, ELLIPSOID_UNKNOWNS)) if self._centred is None else self._centred.rows()

    @cached_property
    def _squares(self) -> Array:
        return np.empty(0) if self._centred is None else squared_lengths(self._centred.points)

    @cached_property
    def _normal(self) -> Array:
        normal: Array = self._rows.T @ self._rows
        return normal

    @cached_property
    def condition(self) -> float:
        """`hiltest.calibration.conditioning.ellipsoid_condition` of the points."""
        return condition_of(self._normal) if len(self._rows) >= ELLIPSOID_UNKNOWNS else CONDITION_SINGULAR

    @cached_property
    def _inverse(self) -> Array | None:
        try:
            return np.linalg.inv(self._normal).astype(np.float64)
        except np.linalg.LinAlgError:
            return None

    @cached_property
    def _pieces(self) -> Array:
        """Power sums of the blocks of both halves."""
        points = np.empty((0, 3)) if self._centred is None else self._centred.points
        return np.array([power_sums(piece) for piece in np.array_split(points, 2 * BLOCKS)])

    @cached_property
    def halves_difference(self) -> float | None:
        """Angle between the calibrations of two halves in time, rms over the sphere, relative to the predicted one.

        It is None if there are too few points, or if a half does not determine an ellipsoid.
        """
        if self._centred is None or not self._halves_condition <= LARGEST_CONDITION:
            return None
        (first, first_deg), (second, second_deg) = (
            _jackknife(half, unbiased=True) for half in np.array_split(self._pieces, 2)
        )
        if first is None or second is None or not 1 / 8 < _volume(first) / _volume(second) < 8:
            return None  # a half at rest is a ball of noise
        readings = np.linalg.solve(first[0], sphere_directions().T).T + first[1]
        off = _calibrated_directions(*second, readings) - sphere_directions()
        predicted_deg = math.hypot(first_deg, second_deg)
        difference_deg = math.degrees(math.sqrt(float((off * off).sum()) / len(off)))
        return difference_deg / predicted_deg if predicted_deg > _EXACT_DEG else None

    @cached_property
    def _halves_condition(self) -> float:
        """Larger condition of the halves."""
        if self._centred is None or len(self._centred.points) < _FEWEST_FOR_HALVES:
            return math.inf
        return max(ellipsoid_condition(half) for half in np.array_split(self._centred.points, 2))


def _volume(calibration: tuple[Array, Array]) -> float:
    """Return the volume of a calibration's ellipsoid, relative to that of a sphere of radius 1."""
    return 1.0 / float(np.linalg.det(calibration[0]))


def _jackknife(blocks: Array, unbiased: bool) -> tuple[tuple[Array, Array] | None, float]:
    """Return the calibration of all blocks, and the standard deviation [deg] of directions from fits without one."""
    whole = blocks.sum(axis=0)
    calibration = calibration_from_sums(whole, unbiased=unbiased)
    if calibration is None:
        return None, _NO_DIRECTION_DEG
    readings = np.linalg.solve(calibration[0], sphere_directions().T).T + calibration[1]
    without = []
    for block in blocks:
        part = calibration_from_sums(whole - block, unbiased=unbiased)
        if part is None:
            return calibration, _NO_DIRECTION_DEG
        without.append(_calibrated_directions(*part, readings))
    off = np.array(without) - np.mean(without, axis=0)
    variance = (1.0 - 1.0 / len(blocks)) * float((off * off).sum(axis=2).mean(axis=1).sum())
    return calibration, math.degrees(math.sqrt(variance))


def _frame_parameters(fit: MagnetometerFit, centred: CentredPoints) -> tuple[Array, Array, Array]:
    """Return shape matrix (trace 3), centre and the nine parameters of a fit in the frame of centred points."""
    soft_iron, centre = fit.soft_iron * centred.scale, (fit.hard_iron - centred.mean) / centred.scale
    shape = soft_iron.T @ soft_iron
    level = 3.0 / float(np.trace(shape))
    shape = shape * level
    traceless = np.tensordot(TRACELESS, shape, axes=2)
    return shape, centre, np.concatenate([traceless, -2.0 * shape @ centre, [centre @ shape @ centre - level]])


def _calibration(parameters: Array) -> tuple[Array, Array] | None:
    shape = np.eye(3) + np.tensordot(parameters[:5], TRACELESS, axes=1)
    # The trace is 1 for a Quadric, and 3 for these parameters.
    return calibration_from_quadric(Quadric(shape / 3.0, parameters[5:8] / 3.0, float(parameters[8]) / 3.0))


def _rows_along(slopes: Array, centred: CentredPoints) -> Array:
    """Return the sum over the points of ``grad d . slope`` for each of the nine columns."""
    quadratic = 2.0 * np.einsum("ni,kij,nj->k", slopes, TRACELESS, centred.points)
    return np.concatenate([quadratic, slopes.sum(axis=0), [0.0]])


def _direction_jacobian(parameters: Array) -> Array | None:
    """Return the derivative of corrected directions by the parameters, shape (9, directions, 3)."""
    calibration = _calibration(parameters)
    if calibration is None:
        return None
    soft_iron, hard_iron = calibration
    readings = np.linalg.solve(soft_iron, sphere_directions().T).T + hard_iron
    columns = []
    for step in _STEP * np.eye(len(parameters)):
        after, before = _directions(parameters + step, readings), _directions(parameters - step, readings)
        if after is None or before is None:
            return None
        columns.append((after - before) / (2.0 * _STEP))
    return np.array(columns)


def _directions(parameters: Array, readings: Array) -> Array | None:
    calibration = _calibration(parameters)
    if calibration is None:
        return None
    return _calibrated_directions(*calibration, readings)


def _calibrated_directions(soft_iron: Array, hard_iron: Array, readings: Array) -> Array:
    corrected = (readings - hard_iron) @ soft_iron.T
    directions: Array = corrected / np.linalg.norm(corrected, axis=1, keepdims=True)
    return directions


def _rms_deg(jacobian: Array, covariance: Array) -> float:
    """Return the root of the mean over directions of ``trace(J covariance J')`` [deg]."""
    flat = jacobian.reshape(len(jacobian), -1)
    variance = float((flat * (covariance @ flat)).sum()) / jacobian.shape[1]
    return math.degrees(math.sqrt(max(0.0, variance)))
