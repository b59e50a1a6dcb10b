"""Calibration of magnetometer samples against the accelerometer of the same rows, if that was not shaken."""

from __future__ import annotations

import math
import shlex
from collections.abc import Sequence
from dataclasses import replace
from typing import TypeAlias

import numpy as np
from numpy.typing import NDArray

from hiltest.calibration.axes import Axes, nearest_axes
from hiltest.calibration.constant_dip import ConstantDip, fit_constant_dip
from hiltest.calibration.direction_error import predicted_direction_error
from hiltest.calibration.fit import FitStatus, MagnetometerFit
from hiltest.calibration.pair_fit import PAIR_METHODS, PairFit, fit_norms, held_out_dip_deg, length_scatter
from hiltest.calibration.quality import rotation_left_deg
from hiltest.calibration.robust import Mask, outliers
from hiltest.log_fitting.fit_result import AgainstGravity, CalibratorFit, GravityFigures
from hiltest.log_fitting.rating import Rating, triple
from hiltest.log_fitting.samples import Samples

Array: TypeAlias = NDArray[np.float64]

# An acceleration of 0.01 g along gravity changes its length, one across it turns it by this angle: 0.57 deg. Simulated
# with 2 deg of rotation and a hand's accelerations of 0.5 s: if lengths vary by 0.8 %, directions err by 0.4 to 0.6 deg
# instead of 1.7, at worst by 1.0; with 1.5 %, at worst by 2.0; with 4 %, rotated norms are worse than norms alone, 2.1
# deg.
_LARGEST_SPREAD = 0.01
# Minimum number of pairs: two per unknown of an ellipsoid, from which on a residual is meaningful.
_FEWEST = 18
# Maximum number of fitted pairs, evenly in time: noise of 1 % then leaves 0.1 deg.
_MOST = 1000
# Ratio of residuals with and without the fitted rotation below which axes that differ from it are wrong.
_CLEARLY_LESS = 0.5
# Multiple of `_LARGEST_SPREAD` within which of length 1 no reading is an outlier, because the scatter of few readings
# is underestimated.
_WILD = 3.0
# Predicted error of gravity's direction up to which it may rotate a field: half of the limit for a fair calibration.
# Above the second value it does not even identify axes.
_LARGEST_ERROR_DEG, _NO_DIRECTION_DEG = 1.0, 10.0


def against_gravity(
    samples: Samples, rating: Rating, *, robust: bool, fit: bool = True
) -> tuple[AgainstGravity | None, list[CalibratorFit]]:
    """Calibrate against gravity, if the log has an unshaken accelerometer whose axes are the magnetometer's.

    Parameters
    ----------
    samples
        Samples without those omitted because of the magnetometer.
    rating
        Rating of these samples.
    robust
        True to omit outliers of the accelerometer's ellipsoid too.
    fit
        False to check the axes and the accelerometer only.

    Returns
    -------
    AgainstGravity or None
        None without an accelerometer.
    list of CalibratorFit
        One fit of each method, if the first result has no objection.
    """
    if samples.acceleration is None:
        return None, []
    points, acceleration = _pairs(samples, samples.acceleration, robust=robust)
    log = _check_spreads(
        AgainstGravity(len(points), str(samples.acceleration_unit)), points, acceleration, samples.columns
    )
    if log.unused or not fit:
        return replace(log, unused=log.unused or "--calibrator names a fit of the field's strength alone"), []
    log = replace(log, norms_held_out_dip_deg=held_out_dip_deg(fit_norms, points, acceleration))
    fits = []
    for name, method in PAIR_METHODS.items():
        pair_fit = method(points, acceleration)
        figures = GravityFigures()
        if pair_fit.is_ellipsoid:
            figures = _figures(pair_fit, points, acceleration, held_out_dip_deg(method, points, acceleration))
        rated = rating.calibrator(name, pair_fit.magnetometer, points, against_gravity=True)
        fits.append(replace(rated, gravity=figures))
    return log, fits


def _pairs(samples: Samples, acceleration: Array, *, robust: bool) -> tuple[Array, Array]:
    """Return readings of both sensors in the same rows, up to the maximum number."""
    both = np.flatnonzero(np.isfinite(acceleration).all(axis=1))
    if robust:
        both = both[~_outliers(samples.points[both], acceleration[both])]
    both = both[:: max(1, -(-len(both) // _MOST))]
    return samples.points[both], acceleration[both]


def _outliers(points: Array, acceleration: Array) -> Mask:
    """Return a mask of the accelerometer's outliers from the ellipsoid of its other readings."""
    wild = outliers(acceleration)
    others = fit_norms(points[~wild], acceleration[~wild])
    if not wild.any() or not others.is_ellipsoid:
        return wild
    lengths = np.linalg.norm(others.accelerometer.gravity_g(acceleration), axis=1)
    far: Mask = wild & (np.abs(lengths - 1.0) > _WILD * _LARGEST_SPREAD)
    return far


def _undetermined_reason(norms: PairFit, acceleration: Array, largest_deg: float) -> str:
    """Return why the accelerometer's own calibration is not good enough; empty if it is."""
    gain, offset = norms.accelerometer.gain, norms.accelerometer.offset
    error = predicted_direction_error(acceleration, MagnetometerFit(FitStatus.ELLIPSOID, False, 0, gain, offset))
    if error is not None and error.rms_deg <= largest_deg:
        return ""
    precision = "not at all" if error is None else f"to {error.rms_deg:.2g} deg"
    return (
        f"the accelerometer's readings determine its direction {precision}, not to {_LARGEST_ERROR_DEG:g}; turn "
        "the sensor all round"
    )


def _check_spreads(log: AgainstGravity, points: Array, acceleration: Array, columns: tuple[str, ...]) -> AgainstGravity:
    """Add the spreads of gravity and dip, and the objections to gravity from these, the axes or the accelerometer."""
    if len(points) < _FEWEST:
        return replace(log, unused=f"{len(points)} rows have readings of both sensors; {_FEWEST} are needed")
    norms = fit_norms(points, acceleration)
    if not norms.is_ellipsoid:
        return replace(
            log,
            unused="the readings of one of the sensors do not form an ellipsoid; turn the sensors in all directions",
        )
    field, gravity = norms.magnetometer.corrected(points), norms.accelerometer.gravity_g(acceleration)
    turn = fit_constant_dip(field, gravity)
    spread = length_scatter(gravity)
    dip_spread = float(norms.turned(turn.rotation).dips_deg(points, acceleration).std())
    # Disturbances of the field's length disturb its dip equally.
    largest = math.degrees(math.hypot(_LARGEST_SPREAD, length_scatter(field)))
    log = replace(log, gravity_spread_percent=100.0 * spread, dip_spread_deg=dip_spread, largest_dip_spread_deg=largest)
    wrong = _wrong_axes(turn)
    if wrong is not None and not _undetermined_reason(norms, acceleration, _NO_DIRECTION_DEG):
        return replace(log, axes=_axes_sentence(wrong, turn, columns), unused="the axes seem wrong")
    if spread <= _LARGEST_SPREAD and dip_spread <= largest:
        return replace(log, unused=_undetermined_reason(norms, acceleration, _LARGEST_ERROR_DEG))
    return replace(
        log,
        unused=(
            f"its length varies by {100.0 * spread:.2g} % (at most {100.0 * _LARGEST_SPREAD:g}), the dip by "
            f"{dip_spread:.2g} deg (at most {largest:.2g}); log attitudes in all directions with the sensor at rest"
        ),
    )


def _wrong_axes(turn: ConstantDip) -> Axes | None:
    """Return the likely axes of the magnetometer relative to the accelerometer's; None if they are equal.

    Notes
    -----
    The dip's sign is unknown, so all signs may be reversed: the result is the variant with fewer negative signs.
    """
    if not turn.spread < _CLEARLY_LESS * turn.spread_unturned:
        return None
    axes = nearest_axes(turn.rotation.T)
    if axes is None or axes.are_right:
        return None
    return axes if sum(axes.signs) > 0 else _negate(axes)


def _negate(axes: Axes) -> Axes:
    x, y, z = axes.signs
    return Axes(axes.order, (-x, -y, -z))


def _axes_sentence(axes: Axes, turn: ConstantDip, columns: Sequence[str]) -> str:
    finding = str(axes).split(" (")[0].replace(" is ", " seems ").replace(" are ", " seem ")
    return (
        f"The magnetometer's axes are not the accelerometer's: {finding} (turned by {turn.angle_deg:.0f} deg the dip "
        f"is constant). --columns {_columns(axes, columns)} corrects that; if headings are then off by 180 deg, use "
        f"--columns {_columns(_negate(axes), columns)}."
    )


def _columns(axes: Axes, columns: Sequence[str]) -> str:
    """Return the columns in the order and with the signs that correct the axes."""
    names = [""] * 3
    for name, axis, sign in zip(columns, axes.order, axes.signs, strict=True):
        bare, negative = name.removeprefix("-"), name.startswith("-") != (sign < 0)
        names[axis] = f"-{bare}" if negative else bare
    return shlex.quote(",".join(f'"{name}"' if "," in name else name for name in names))


def _figures(fit: PairFit, points: Array, acceleration: Array, held_out: float | None) -> GravityFigures:
    x, y, z = map(triple, fit.accelerometer.gain)
    return GravityFigures(
        held_out_dip_deg=held_out,
        dip_deg=abs(float(fit.dips_deg(points, acceleration).mean())),
        rotation_deg=rotation_left_deg(fit.magnetometer, np.eye(3)),
        accelerometer_offset=triple(fit.accelerometer.offset),
        accelerometer_gain=(x, y, z),
    )
