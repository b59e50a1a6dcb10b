"""`dpi`: the magnetometer calibrated against gravity; their dot product is the same in every attitude."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from hiltest.calibration.fit import Array, FitStatus, MagnetometerFit, half_range, mid_range, no_fit, points_array

UNKNOWNS = 12

#: Minimum number of rows: pairs of single readings, and means of at least `POSE_READINGS` at still poses. With 100
#: single pairs the worst heading of the default rig exceeds 2 degrees in 1 % of seeds with an exact accelerometer, in 7
#: % with errors of 2 mg and 0.2 %; with 300 pairs, in none and in one of a thousand.
PAIRS_MINIMUM, POSES_MINIMUM, POSE_READINGS = 300, 38, 16

#: Minimum ratio of the dot product to its standard error: below, noise determines the fit's scale instead of the dip.
SIGNIFICANCE = 5.0

# Largest ratio of the pivot for attitudes in all directions to the actual one. 300 pairs of the default tumble give 6;
# tilts up to 30 degrees give 38 and a worst heading of 1.6 degrees; up to 20 degrees 140 and 6.5; pairs without tilt
# 1e6 and more.
COVERAGE_LIMIT = 100.0

# The same for the last pivot, which also falls with the square of the dip: beyond, it is rounding, even in float32.
_LAST_PIVOT_LIMIT = 1e6


@dataclass(frozen=True, slots=True, eq=False)
class DpiFit:
    """Calibration of a magnetometer against gravity."""

    calibration: MagnetometerFit
    """Fit whose status is ELLIPSOID if there is a calibration; soft_iron is not symmetric, and rotates the field to the
    accelerometer's axes. Coverage: see `COVERAGE_LIMIT`."""
    n_used: int
    """Number of rows of the least squares."""
    dip_deg: float = math.nan
    """Inclination of the field from the data, positive down; NaN without a calibration."""
    strength_counts: float = math.nan
    """``det(soft_iron)^(-1/3)``, with the scale that gives norm 1: the field's strength in the sensor's gain, if its
    soft iron has determinant 1; NaN without a calibration."""
    standard_error: float = math.nan
    """Standard error of the dot product of one row, relative to the field's strength; NaN without one."""

    @property
    def status(self) -> FitStatus:
        """Status of the fit."""
        return self.calibration.status


def fit_dpi(
    magnetometer_counts: ArrayLike, gravity_g: ArrayLike, *, readings: int = 1, dip_deg: float | None = None
) -> DpiFit:
    """Calibrate a magnetometer by the dot product of field and gravity.

    Parameters
    ----------
    magnetometer_counts : shape (n, 3)
        Readings, or means at still poses [counts], body frame.
    gravity_g : shape (n, 3)
        Gravity of a calibrated accelerometer at the same instants [g], body frame, positive down.
    readings
        Number of readings in the mean of each row. At least 300 rows of fewer than 16 readings are needed, or 38 of 16
        or more.
    dip_deg
        Inclination of the field [deg], positive down; estimated if omitted.

    Returns
    -------
    DpiFit
        Fit with the status TOO_FEW_POINTS below these numbers; SINGULAR if the attitudes do not determine all unknowns;
        HORIZONTAL_FIELD if ``|sin dip|``, given or estimated, is below 5 standard errors of the dot product: about 2.4
        degrees of dip for single readings of 0.4 uT, 0.6 for means of 16; MIRRORED if the calibration would be a
        reflection: the sign of the dip or of gravity, or two axes of a sensor, are wrong.

    Notes
    -----
    Coelho and Hemerly, eq. 8 and 9: ``g . (K m - k) = |m| |g| sin(dip)``, with gravity positive down; rows
    ``(g_i, g_i m_j)``, 12 unknowns, linear least squares. It sees the rotation that no fit of norms can, as far as
    the accelerometer's own axes are right.

    The constant on the right only scales K and k, so it is set to 1. The sign makes det K positive, because iron cannot
    mirror a field. The scale gives corrected points the rms norm 1, and then the mean of ``g . (K m - k)`` is
    ``sin(dip)``. A given dip defines the scale instead, and the norms may deviate. The field's strength cancels: the
    data cannot distinguish it from the sensor's gain, and ``strength_counts`` assumes the nominal gain. A heading
    depends on none of these three, only on K and k up to a positive factor, and on the sign.

    Noise in the points reduces the constant: least squares explains ``c^2 / (c^2 + s^2)`` of it, with the dot product c
    and its standard error s, which shrinks K as a whole. Both scales use the mean of the fitted products instead of the
    target 1, so the shrinking cancels.
    """
    points, gravity = points_array(magnetometer_counts), points_array(gravity_g)
    if len(points) != len(gravity):
        raise ValueError(f"{len(points)} points and {len(gravity)} of gravity; they are pairs")
    if len(points) < (POSES_MINIMUM if readings >= POSE_READINGS else PAIRS_MINIMUM):
        return DpiFit(no_fit(FitStatus.TOO_FEW_POINTS), len(points))
    return fit_dpi_of_any_number(points, gravity, dip_deg=dip_deg)


def fit_dpi_of_any_number(points: Array, gravity: Array, *, dip_deg: float | None = None) -> DpiFit:
    """Fit like `fit_dpi` for any number of rows; the caller judges whether they suffice."""
    n, unit = len(points), half_range(points) if len(points) else 0.0
    if n <= UNKNOWNS or not unit > 0.0:
        return DpiFit(no_fit(FitStatus.SINGULAR), n)
    anchor = mid_range(points)
    field = np.column_stack([np.ones(n), (points - anchor) / unit])
    rows = (gravity[:, :, None] * field[:, None, :]).reshape(n, UNKNOWNS)
    coverage = _coverage(rows)
    if coverage > COVERAGE_LIMIT:
        return DpiFit(no_fit(FitStatus.SINGULAR, coverage=coverage), n)
    solution: Array = np.linalg.lstsq(rows, np.ones(n), rcond=None)[0].astype(np.float64)
    return _calibration(rows, solution.reshape(3, 4), anchor, unit, coverage, dip_deg)


def _coverage(rows: Array) -> float:
    """Return the largest ratio of the pivot for attitudes in all directions to the actual one."""
    pivots = np.diag(np.linalg.qr(rows, mode="r")) ** 2 / len(rows)
    ideal = np.array([1.0 / 3.0, 1.0 / 9.0, 1.0 / 9.0, 1.0 / 9.0] * 3)
    # Lower bound at float32 precision, which avoids a division by a zero pivot.
    ratios = ideal / np.maximum(pivots, ideal / _LAST_PIVOT_LIMIT)
    largest = float(ratios[:-1].max())
    return largest if ratios[-1] < _LAST_PIVOT_LIMIT else _LAST_PIVOT_LIMIT


def _calibration(
    rows: Array, solution: Array, anchor: Array, unit: float, coverage: float, dip_deg: float | None
) -> DpiFit:
    n = len(rows)
    fitted = rows @ solution.ravel()
    explained = float(fitted.mean())
    error = math.sqrt(float(((fitted - 1.0) ** 2).sum()) / (n - UNKNOWNS) / explained)
    gain, constant = solution[:, 1:], solution[:, 0]
    corrected = rows.reshape(n, 3, 4) @ solution.T
    # Row i, column j: g_i times element j of the corrected field.
    norm = math.sqrt(float((corrected**2).sum() / (rows[:, ::4] ** 2).sum()))
    sine = math.copysign(explained / norm, float(np.linalg.det(gain)))
    # Standard error of the dot product relative to the field's strength: the explained part of 1 is |sin(dip)| of the
    # field.
    standard_error = abs(sine) * error
    target = sine if dip_deg is None else math.sin(math.radians(dip_deg))
    status = FitStatus.ELLIPSOID
    if min(abs(sine), abs(target)) < SIGNIFICANCE * standard_error:
        status = FitStatus.HORIZONTAL_FIELD
    elif sine * target < 0.0:
        status = FitStatus.MIRRORED
    dip = math.degrees(math.asin(max(-1.0, min(1.0, sine))))
    if status is not FitStatus.ELLIPSOID:
        return DpiFit(no_fit(status, coverage=coverage), n, dip, math.nan, standard_error)
    soft_iron: Array = gain * (target / explained) / unit
    hard_iron: Array = anchor - unit * np.linalg.solve(gain, constant)
    strength = float(np.linalg.det(soft_iron * sine / target)) ** (-1.0 / 3.0)
    calibration = MagnetometerFit(status, False, 0, soft_iron, hard_iron, coverage)
    return DpiFit(calibration, n, dip, strength, standard_error)
