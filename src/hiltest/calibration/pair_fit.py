"""Magnetometer and accelerometer calibrated from the same attitudes: gravity shows how the field's sphere is turned."""

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

# Blocks in time, each left out once. With 4 of them the fits lack a quarter of the attitudes, and the order of methods
# was that of aligned shots in 14 of 16 instruments; with 8 in 15, with 12 and 24 in 16.
_BLOCKS = 12
# The least scatter of a sensor, of its length: finer than any reads, and no division by zero.
_LEAST_SCATTER = 1e-4


@dataclass(frozen=True, slots=True, eq=False)
class PairFit:
    """Calibrations of a magnetometer and an accelerometer on one board."""

    magnetometer: MagnetometerFit
    """Unless it is from norms alone, soft_iron is no symmetric matrix: it takes readings to the accelerometer's
    axes."""
    accelerometer: AccelerometerFit
    """In the unit of its readings; its gain is symmetric. What it calls gravity has the sign of the readings."""

    @property
    def is_ellipsoid(self) -> bool:
        """Whether both are calibrated."""
        return self.magnetometer.status is FitStatus.ELLIPSOID

    def turned(self, rotation: Array) -> PairFit:
        """Return the same with the corrected field turned by a rotation, shape (3, 3)."""
        return replace(self, magnetometer=replace(self.magnetometer, soft_iron=rotation @ self.magnetometer.soft_iron))

    def dips_deg(self, points: ArrayLike, acceleration: ArrayLike) -> Array:
        """Return the angle of the field to the plane across gravity in each pair [deg], shape (n,)."""
        field, gravity = self.magnetometer.corrected(points), self.accelerometer.gravity_g(acceleration)
        lengths = np.linalg.norm(field, axis=1) * np.linalg.norm(gravity, axis=1)
        dips: Array = np.degrees(np.arcsin(np.clip((field * gravity).sum(axis=1) / lengths, -1.0, 1.0)))
        return dips


PairMethod: TypeAlias = Callable[[Array, Array], PairFit]
_NO_FIT = PairFit(no_fit(FitStatus.SINGULAR), AccelerometerFit(np.eye(3), np.zeros(3)))


def fit_norms(points: ArrayLike, acceleration: ArrayLike) -> PairFit:
    """Fit the ellipsoid of each sensor for itself, as `direct` does.

    Parameters
    ----------
    points, acceleration : shape (n, 3)
        Readings of magnetometer and accelerometer at the same instants, in any units, each in its sensor's axes.

    Returns
    -------
    PairFit
        SINGULAR where the readings of either make no ellipsoid. How well they determine it is a question of its own:
        `hiltest.calibration.conditioning.ellipsoid_condition`.
    """
    field, gravity = _ellipsoid(points_array(points)), _ellipsoid(points_array(acceleration))
    if field is None or gravity is None:
        return _NO_FIT
    return PairFit(MagnetometerFit(FitStatus.ELLIPSOID, False, 0, *field), AccelerometerFit(*gravity))


def fit_turned(points: ArrayLike, acceleration: ArrayLike) -> PairFit:
    """Fit as `fit_norms` does, and turn the field by the rotation of constant dip.

    Notes
    -----
    Three unknowns more than the norms have. See `fit_constant_dip`.
    """
    found = fit_norms(points, acceleration)
    if not found.is_ellipsoid:
        return found
    turn = fit_constant_dip(found.magnetometer.corrected(points), found.accelerometer.gravity_g(acceleration))
    return found.turned(turn.rotation)


def fit_dpi_pair(points: ArrayLike, acceleration: ArrayLike) -> PairFit:
    """Fit the ellipsoid of gravity, and the magnetometer against it as `fit_dpi` does, however few pairs there are."""
    centred, gravity = CentredPoints.of(points), _ellipsoid(points_array(acceleration))
    if centred is None or gravity is None:
        return _NO_FIT
    accelerometer = AccelerometerFit(*gravity)
    found = fit_dpi_of_any_number(centred.points, accelerometer.gravity_g(acceleration)).calibration
    if found.has_fit:
        hard_iron = centred.mean + centred.scale * found.hard_iron
        found = replace(found, soft_iron=found.soft_iron / centred.scale, hard_iron=hard_iron)
    return PairFit(found, accelerometer)


def fit_joint(points: ArrayLike, acceleration: ArrayLike) -> PairFit:
    """Fit both sensors at once: lengths of field and gravity, and the dip between them, by maximum likelihood.

    Notes
    -----
    22 unknowns: 12 of the magnetometer, 9 of the accelerometer, whose gain is symmetric, and the dip. Noise of s_m in
    the field and s_g in gravity, of length 1 and the same in all directions, gives three residuals a pair that are
    independent: ``|m| - 1`` of s_m, ``|g| - 1`` of s_g, and the dip less its mean of ``hypot(s_m, s_g)``. Both scatters
    are those that the norms alone leave.
    """
    given, accelerations = points_array(points), points_array(acceleration)
    start = fit_turned(given, accelerations)
    if not start.is_ellipsoid:
        return start
    from scipy.optimize import least_squares  # 0.3 s, which a log without an accelerometer need not wait for

    corrected = start.magnetometer.corrected(given), start.accelerometer.gravity_g(accelerations)
    of_field, of_gravity = (max(_LEAST_SCATTER, length_scatter(each)) for each in corrected)
    weights = 1.0 / np.array([of_field, of_gravity, np.hypot(of_field, of_gravity)])

    def residuals(unknowns: Array) -> Array:
        fit = _moved(start, unknowns)
        field, gravity = fit.magnetometer.corrected(given), fit.accelerometer.gravity_g(accelerations)
        lengths = np.linalg.norm(field, axis=1), np.linalg.norm(gravity, axis=1)
        dips = np.arcsin(np.clip((field * gravity).sum(axis=1) / (lengths[0] * lengths[1]), -1.0, 1.0))
        off: Array = np.concatenate([lengths[0] - 1.0, lengths[1] - 1.0, dips - unknowns[21]])
        return off * np.repeat(weights, len(given))

    dip = np.radians(start.dips_deg(given, accelerations).mean())
    found = least_squares(residuals, np.append(np.zeros(21), dip), method="lm")
    fit = _moved(start, found.x)
    if not found.success:
        return replace(fit, magnetometer=replace(fit.magnetometer, status=FitStatus.NOT_CONVERGED))
    return fit


#: What gravity adds to the norms, by name, fewest unknowns first.
PAIR_METHODS: dict[str, PairMethod] = {"direct+rotation": fit_turned, "joint": fit_joint, "dpi": fit_dpi_pair}


def held_out_dip_deg(method: PairMethod, points: ArrayLike, acceleration: ArrayLike) -> float | None:
    """Return how far the dip of pairs that a fit has not seen is from that of those it has, rms [deg].

    Parameters
    ----------
    method
        As in `PAIR_METHODS`.
    points, acceleration : shape (n, 3)
        Pairs in the order in which they were read.

    Returns
    -------
    float or None
        None where the pairs without one of the blocks determine no calibration.

    Notes
    -----
    Cross-validation over 12 blocks in time. The dip within the pairs of a fit is no measure: more unknowns always make
    it smaller.
    """
    given, accelerations = points_array(points), points_array(acceleration)
    off = []
    for block in np.array_split(np.arange(len(given)), _BLOCKS):
        kept = np.delete(np.arange(len(given)), block)
        fit = method(given[kept], accelerations[kept])
        if not fit.is_ellipsoid:
            return None
        seen = fit.dips_deg(given[kept], accelerations[kept]).mean()
        off.append(fit.dips_deg(given[block], accelerations[block]) - seen)
    return float(np.sqrt(np.mean(np.concatenate(off) ** 2)))


def _ellipsoid(readings: Array) -> tuple[Array, Array] | None:
    """Return the symmetric gain that takes readings to length 1, and their centre; None without an ellipsoid."""
    centred = CentredPoints.of(readings)
    found = None if centred is None else calibration_from_sums(power_sums(centred.points), unbiased=False)
    if centred is None or found is None:
        return None
    return found[0] / centred.scale, centred.mean + centred.scale * found[1]


def length_scatter(corrected: Array) -> float:
    """Return the standard deviation of lengths about 1, for as many unknowns as an ellipsoid has."""
    off = np.linalg.norm(corrected, axis=1) - 1.0
    return float(np.sqrt((off @ off) / max(1, len(off) - ELLIPSOID_UNKNOWNS)))


def _moved(start: PairFit, unknowns: Array) -> PairFit:
    """Return calibrations near those of the start: 9 and 3 of the magnetometer, 6 and 3 of the accelerometer."""
    soft_iron, gain = start.magnetometer.soft_iron, start.accelerometer.gain
    # What length 1 is in the readings of each.
    field, gravity = 1.0 / np.cbrt(np.linalg.det([soft_iron, gain]))
    stretch = np.zeros((3, 3))
    stretch[np.triu_indices(3)] = unknowns[12:18]
    stretch += np.triu(stretch, 1).T
    magnetometer = replace(
        start.magnetometer, soft_iron=soft_iron @ (np.eye(3) + unknowns[:9].reshape(3, 3)),
        hard_iron=start.magnetometer.hard_iron + unknowns[9:12] * field,
    )  # fmt: skip
    return PairFit(
        magnetometer, AccelerometerFit(gain + stretch / gravity, start.accelerometer.offset + unknowns[18:21] * gravity)
    )
