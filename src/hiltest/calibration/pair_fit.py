"""Calibration of magnetometer and accelerometer from the same attitudes: gravity determines the rotation."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import TypeAlias

import numpy as np
from numpy.typing import ArrayLike

from hiltest.calibration.accelerometer import AccelerometerFit
from hiltest.calibration.conditioning import CentredPoints
from hiltest.calibration.constant_dip import fit_constant_dip
from hiltest.calibration.corrected import calibration_from_sums, power_sums
from hiltest.calibration.dpi import fit_dpi_of_any_number
from hiltest.calibration.fit import ELLIPSOID_UNKNOWNS, Array, FitStatus, MagnetometerFit, no_fit, points_array

# Number of blocks in time for cross-validation. With 4 of them the fits lack a quarter of the attitudes, and the order
# of methods agreed with aligned shots in 14 of 16 instruments; with 8 in 15, with 12 and 24 in 16.
_BLOCKS = 12
# Least relative scatter of a sensor: finer than any sensor, to avoid a division by zero.
_LEAST_SCATTER = 1e-4


@dataclass(frozen=True, slots=True, eq=False)
class PairFit:
    """Calibrations of a magnetometer and an accelerometer on one board."""

    magnetometer: MagnetometerFit
    """Magnetometer fit; unless it is from norms alone, soft_iron is not symmetric: it rotates readings to the
    accelerometer's axes."""
    accelerometer: AccelerometerFit
    """Accelerometer fit in the unit of its readings, with symmetric gain. Its gravity has the sign of the readings."""

    @property
    def is_ellipsoid(self) -> bool:
        """True if both are calibrated."""
        return self.magnetometer.status is FitStatus.ELLIPSOID

    def turned(self, rotation: Array) -> PairFit:
        """Return this fit with the corrected field rotated by a matrix, shape (3, 3)."""
        return replace(self, magnetometer=replace(self.magnetometer, soft_iron=rotation @ self.magnetometer.soft_iron))

    def dips_deg(self, points: ArrayLike, acceleration: ArrayLike) -> Array:
        """Return the angle between the field and the horizontal plane in each pair [deg], shape (n,)."""
        field, gravity = self.magnetometer.corrected(points), self.accelerometer.gravity_g(acceleration)
        lengths = np.linalg.norm(field, axis=1) * np.linalg.norm(gravity, axis=1)
        dips: Array = np.degrees(np.arcsin(np.clip((field * gravity).sum(axis=1) / lengths, -1.0, 1.0)))
        return dips


PairMethod: TypeAlias = Callable[[Array, Array], PairFit]
_NO_FIT = PairFit(no_fit(FitStatus.SINGULAR), AccelerometerFit(np.eye(3), np.zeros(3)))


def fit_norms(points: ArrayLike, acceleration: ArrayLike) -> PairFit:
    """Fit the ellipsoid of each sensor separately, like `direct`.

    Parameters
    ----------
    points, acceleration : shape (n, 3)
        Readings of magnetometer and accelerometer at the same instants, in any units, each in its sensor's axes.

    Returns
    -------
    PairFit
        Fit, SINGULAR if the readings of either sensor have no ellipsoid. Their conditioning is a separate criterion:
        `hiltest.calibration.conditioning.ellipsoid_condition`.
    """
    field, gravity = _ellipsoid(points_array(points)), _ellipsoid(points_array(acceleration))
    if field is None or gravity is None:
        return _NO_FIT
    return PairFit(MagnetometerFit(FitStatus.ELLIPSOID, False, 0, *field), AccelerometerFit(*gravity))


def fit_turned(points: ArrayLike, acceleration: ArrayLike) -> PairFit:
    """Fit like `fit_norms`, and rotate the field for constant dip.

    Notes
    -----
    It has three more unknowns than the norms. See `fit_constant_dip`.
    """
    fit = fit_norms(points, acceleration)
    if not fit.is_ellipsoid:
        return fit
    turn = fit_constant_dip(fit.magnetometer.corrected(points), fit.accelerometer.gravity_g(acceleration))
    return fit.turned(turn.rotation)


def fit_dpi_pair(points: ArrayLike, acceleration: ArrayLike) -> PairFit:
    """Fit the ellipsoid of gravity, and the magnetometer against it like `fit_dpi`, for any number of pairs."""
    centred, gravity = CentredPoints.centre(points), _ellipsoid(points_array(acceleration))
    if centred is None or gravity is None:
        return _NO_FIT
    accelerometer = AccelerometerFit(*gravity)
    calibration = fit_dpi_of_any_number(centred.points, accelerometer.gravity_g(acceleration)).calibration
    if calibration.has_fit:
        hard_iron = centred.mean + centred.scale * calibration.hard_iron
        calibration = replace(calibration, soft_iron=calibration.soft_iron / centred.scale, hard_iron=hard_iron)
    return PairFit(calibration, accelerometer)


def fit_joint(points: ArrayLike, acceleration: ArrayLike) -> PairFit:
    """Fit both sensors at once: lengths of field and gravity, and the dip between them, by maximum likelihood.

    Notes
    -----
    There are 22 unknowns: 12 of the magnetometer, 9 of the accelerometer, whose gain is symmetric, and the dip.
    Isotropic noise s_m in the field and s_g in gravity, relative to their lengths, gives three independent residuals
    per pair: ``|m| - 1`` with s_m, ``|g| - 1`` with s_g, and the deviation of the dip with ``hypot(s_m, s_g)``. Both
    scatters are those of the norms alone.
    """
    readings, accelerations = points_array(points), points_array(acceleration)
    start = fit_turned(readings, accelerations)
    if not start.is_ellipsoid:
        return start
    from scipy.optimize import least_squares  # takes 0.3 s, which a log without an accelerometer does not need

    corrected = start.magnetometer.corrected(readings), start.accelerometer.gravity_g(accelerations)
    of_field, of_gravity = (max(_LEAST_SCATTER, length_scatter(vectors)) for vectors in corrected)
    weights = 1.0 / np.array([of_field, of_gravity, np.hypot(of_field, of_gravity)])

    def residuals(unknowns: Array) -> Array:
        fit = _perturb(start, unknowns)
        field, gravity = fit.magnetometer.corrected(readings), fit.accelerometer.gravity_g(accelerations)
        lengths = np.linalg.norm(field, axis=1), np.linalg.norm(gravity, axis=1)
        dips = np.arcsin(np.clip((field * gravity).sum(axis=1) / (lengths[0] * lengths[1]), -1.0, 1.0))
        off: Array = np.concatenate([lengths[0] - 1.0, lengths[1] - 1.0, dips - unknowns[21]])
        return off * np.repeat(weights, len(readings))

    dip = np.radians(start.dips_deg(readings, accelerations).mean())
    result = least_squares(residuals, np.append(np.zeros(21), dip), method="lm")
    fit = _perturb(start, result.x)
    if not result.success:
        return replace(fit, magnetometer=replace(fit.magnetometer, status=FitStatus.NOT_CONVERGED))
    return fit


#: Methods that use gravity besides the norms, by name, fewest unknowns first.
PAIR_METHODS: dict[str, PairMethod] = {"direct+rotation": fit_turned, "joint": fit_joint, "dpi": fit_dpi_pair}


def held_out_dip_deg(method: PairMethod, points: ArrayLike, acceleration: ArrayLike) -> float | None:
    """Return the difference in dip between held-out pairs and the fitted ones, rms [deg].

    Parameters
    ----------
    method
        See `PAIR_METHODS`.
    points, acceleration : shape (n, 3)
        Pairs in the order of time.

    Returns
    -------
    float or None
        None if the pairs without one of the blocks determine no calibration.

    Notes
    -----
    The method is cross-validation over 12 blocks in time. The spread of the dip within the fitted pairs is not a
    measure, because more unknowns always reduce it.
    """
    readings, accelerations = points_array(points), points_array(acceleration)
    off = []
    for block in np.array_split(np.arange(len(readings)), _BLOCKS):
        used = np.delete(np.arange(len(readings)), block)
        fit = method(readings[used], accelerations[used])
        if not fit.is_ellipsoid:
            return None
        dip = fit.dips_deg(readings[used], accelerations[used]).mean()
        off.append(fit.dips_deg(readings[block], accelerations[block]) - dip)
    return float(np.sqrt(np.mean(np.concatenate(off) ** 2)))


def _ellipsoid(readings: Array) -> tuple[Array, Array] | None:
    """Return the symmetric gain that scales readings to length 1, and their centre; None without an ellipsoid."""
    centred = CentredPoints.centre(readings)
    calibration = None if centred is None else calibration_from_sums(power_sums(centred.points), unbiased=False)
    if centred is None or calibration is None:
        return None
    return calibration[0] / centred.scale, centred.mean + centred.scale * calibration[1]


def length_scatter(corrected: Array) -> float:
    """Return the standard deviation of lengths about 1, for as many unknowns as an ellipsoid has."""
    off = np.linalg.norm(corrected, axis=1) - 1.0
    return float(np.sqrt((off @ off) / max(1, len(off) - ELLIPSOID_UNKNOWNS)))


def _perturb(start: PairFit, unknowns: Array) -> PairFit:
    """Return perturbed calibrations: 9 and 3 unknowns of the magnetometer, 6 and 3 of the accelerometer."""
    soft_iron, gain = start.magnetometer.soft_iron, start.accelerometer.gain
    # Length 1 in the readings of each sensor.
    field, gravity = 1.0 / np.cbrt(np.linalg.det([soft_iron, gain]))
    stretch = np.zeros((3, 3))
    stretch[np.triu_indices(3)] = unknowns[12:18]
    stretch += np.triu(stretch, 1).T
    magnetometer = replace(
        start.magnetometer,
        soft_iron=soft_iron @ (np.eye(3) + unknowns[:9].reshape(3, 3)),
        hard_iron=start.magnetometer.hard_iron + unknowns[9:12] * field,
    )
    return PairFit(
        magnetometer, AccelerometerFit(gain + stretch / gravity, start.accelerometer.offset + unknowns[18:21] * gravity)
    )
