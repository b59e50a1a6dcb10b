"""Magnetometer samples calibrated against the accelerometer of the same rows, where that stood still."""

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
from hiltest.logs.fit_result import AgainstGravity, CalibratorFit, GravityFigures
from hiltest.logs.rating import Rating, triple
from hiltest.logs.samples import Samples

Array: TypeAlias = NDArray[np.float64]

# A hundredth of gravity along it shows in its length, one across turns it by this: 0.57 deg. Simulated with 2 deg of
# rotation and a hand's accelerations of 0.5 s: where lengths vary by 0.8 % directions are off by 0.4 to 0.6 deg instead
# of 1.7, at worst by 1.0; by 1.5 % at worst by 2.0; by 4 % norms that are turned are worse than norms alone, 2.1 deg.
_LARGEST_SPREAD = 0.01
# Two for each unknown of an ellipsoid, as where a residual begins to be known.
_FEWEST = 18
# Pairs that are fitted at most, evenly in time: of noise of 1 % they leave 0.1 deg.
_MOST = 1000
# Where the rotation found leaves less than half of what none does, axes far from it are wrong.
_CLEARLY_LESS = 0.5
# Times `_LARGEST_SPREAD`: nearer to length 1 no reading is wild. Of few readings the scatter is estimated too small.
_WILD = 3.0
# Predicted error of gravity's direction up to which a field is turned by it: the half of what any calibrator may have
# that a calibration is rated fair for. Above the second not even axes are named by it.
_LARGEST_ERROR_DEG, _NO_DIRECTION_DEG = 1.0, 10.0


def against_gravity(
    samples: Samples, rating: Rating, *, robust: bool
) -> tuple[AgainstGravity | None, list[CalibratorFit]]:
    """Calibrate against gravity, if the log has an accelerometer that stood still and its axes are the magnetometer's.

    Parameters
    ----------
    samples
        Without what is left out for the magnetometer's sake.
    rating
        Of these samples.
    robust
        Leave out what is no part of the accelerometer's ellipsoid too.

    Returns
    -------
    AgainstGravity or None
        None without an accelerometer.
    list of CalibratorFit
        One of each method, if the first has nothing against it.
    """
    if samples.acceleration is None:
        return None, []
    points, acceleration = _pairs(samples, samples.acceleration, robust=robust)
    log = _checked(AgainstGravity(len(points), str(samples.acceleration_unit)), points, acceleration, samples.columns)
    if log.unused:
        return log, []
    log = replace(log, norms_held_out_dip_deg=held_out_dip_deg(fit_norms, points, acceleration))
    fits = []
    for name, method in PAIR_METHODS.items():
        fit = method(points, acceleration)
        figures = GravityFigures()
        if fit.is_ellipsoid:
            figures = _figures(fit, points, acceleration, held_out_dip_deg(method, points, acceleration))
        fits.append(replace(rating.calibrator(name, fit.magnetometer, points), gravity=figures))
    return log, fits


def _pairs(samples: Samples, acceleration: Array, *, robust: bool) -> tuple[Array, Array]:
    """Return readings of both sensors in the same rows, at most so many."""
    both = np.flatnonzero(np.isfinite(acceleration).all(axis=1))
    if robust:
        both = both[~_wild(samples.points[both], acceleration[both])]
    both = both[:: max(1, -(-len(both) // _MOST))]
    return samples.points[both], acceleration[both]


def _wild(points: Array, acceleration: Array) -> Mask:
    """Say of each of the accelerometer's readings whether it is no part of the ellipsoid of the others."""
    wild = outliers(acceleration)
    others = fit_norms(points[~wild], acceleration[~wild])
    if not wild.any() or not others.is_ellipsoid:
        return wild
    lengths = np.linalg.norm(others.accelerometer.gravity_g(acceleration), axis=1)
    far: Mask = wild & (np.abs(lengths - 1.0) > _WILD * _LARGEST_SPREAD)
    return far


def _undetermined(norms: PairFit, acceleration: Array, largest_deg: float) -> str:
    """Say why the accelerometer's own calibration is not good enough; empty where it is."""
    gain, offset = norms.accelerometer.gain, norms.accelerometer.offset
    error = predicted_direction_error(acceleration, MagnetometerFit(FitStatus.ELLIPSOID, False, 0, gain, offset))
    if error is not None and error.rms_deg <= largest_deg:
        return ""
    known = "not at all" if error is None else f"to {error.rms_deg:.2g} deg"
    return (
        f"the accelerometer's readings determine its direction {known}, not to {_LARGEST_ERROR_DEG:g}; turn the sensor "
        "all round"
    )


def _checked(
    log: AgainstGravity, points: Array, acceleration: Array, columns: tuple[str, str, str]
) -> AgainstGravity:
    """Add the spreads of gravity and dip, and what they, the axes or the accelerometer have against using gravity."""
    if len(points) < _FEWEST:
        return replace(log, unused=f"{len(points)} rows have readings of both sensors; {_FEWEST} are needed")
    norms = fit_norms(points, acceleration)
    if not norms.is_ellipsoid:
        return replace(log, unused="the readings of one of the sensors make no ellipsoid; turn them all round")
    field, gravity = norms.magnetometer.corrected(points), norms.accelerometer.gravity_g(acceleration)
    turn = fit_constant_dip(field, gravity)
    spread = length_scatter(gravity)
    dip_spread = float(norms.turned(turn.rotation).dips_deg(points, acceleration).std())
    # What scatters the field's length scatters its dip as much.
    largest = math.degrees(math.hypot(_LARGEST_SPREAD, length_scatter(field)))
    log = replace(
        log, gravity_spread_percent=100.0 * spread, dip_spread_deg=dip_spread, largest_dip_spread_deg=largest
    )
    wrong = _wrong_axes(turn)
    if wrong is not None and not _undetermined(norms, acceleration, _NO_DIRECTION_DEG):
        return replace(log, axes=_axes_sentence(wrong, turn, columns), unused="the axes seem wrong")
    if spread <= _LARGEST_SPREAD and dip_spread <= largest:
        return replace(log, unused=_undetermined(norms, acceleration, _LARGEST_ERROR_DEG))
    return replace(log, unused=(
        f"its length varies by {100.0 * spread:.2g} % (at most {100.0 * _LARGEST_SPREAD:g}), the dip by "
        f"{dip_spread:.2g} deg (at most {largest:.2g}); log attitudes all round at which the sensor stands still"
    ))  # fmt: skip


def _wrong_axes(turn: ConstantDip) -> Axes | None:
    """Return what the magnetometer's axes seem to be, seen from the accelerometer's; None where they are the same.

    Notes
    -----
    The dip's sign is not known, so all signs may be the other way round: of the two the one with fewer.
    """
    if not turn.spread < _CLEARLY_LESS * turn.spread_unturned:
        return None
    axes = nearest_axes(turn.rotation.T)
    if axes is None or axes.are_right:
        return None
    return axes if sum(axes.signs) > 0 else _negated(axes)


def _negated(axes: Axes) -> Axes:
    x, y, z = axes.signs
    return Axes(axes.order, (-x, -y, -z))


def _axes_sentence(axes: Axes, turn: ConstantDip, columns: tuple[str, str, str]) -> str:
    what = str(axes).split(" (")[0].replace(" is ", " seems ").replace(" are ", " seem ")
    return (
        f"The magnetometer's axes are not the accelerometer's: {what} (turned by {turn.angle_deg:.0f} deg the dip is "
        f"constant). --columns {_columns(axes, columns)} puts that right, or, where headings are off by 180 deg then, "
        f"--columns {_columns(_negated(axes), columns)}."
    )


def _columns(axes: Axes, columns: Sequence[str]) -> str:
    """Return the columns in the order, and with the signs, that make the axes right."""
    names = [""] * 3
    for name, axis, sign in zip(columns, axes.order, axes.signs, strict=True):
        bare, negative = name.removeprefix("-"), name.startswith("-") != (sign < 0)
        names[axis] = f"-{bare}" if negative else bare
    return shlex.quote(",".join(f'"{each}"' if "," in each else each for each in names))


def _figures(fit: PairFit, points: Array, acceleration: Array, held_out: float | None) -> GravityFigures:
    x, y, z = map(triple, fit.accelerometer.gain)
    return GravityFigures(
        held_out_dip_deg=held_out, dip_deg=abs(float(fit.dips_deg(points, acceleration).mean())),
        rotation_deg=rotation_left_deg(fit.magnetometer, np.eye(3)),
        accelerometer_offset=triple(fit.accelerometer.offset), accelerometer_gain=(x, y, z),
    )  # fmt: skip
