"""Source of a calibrated sensor's error at known attitudes: offset, scale, soft iron, rotation or a constant turn."""

from __future__ import annotations

import math
from dataclasses import dataclass
from enum import StrEnum

import numpy as np
from numpy.typing import ArrayLike

from hiltest.calibration.fit import Array

# What is left below this many parts of a vector is rounding of the firmware's float32: 0.002 degrees.
_ROUNDING = 3.5e-5

# Part of the known vectors' squares that lies along an axis from which its gain can be told: of gravity at tilts of
# 20 degrees 0.05, of an operator's level 1e-4.
_LEAST_POWER = 1e-3


class Source(StrEnum):
    """What makes calibrated vectors differ from the known ones."""

    CONSTANT_TURN = "constant turn"
    OFFSET = "offset"
    SCALE = "scale"
    ROTATION = "rotation"
    SOFT_IRON = "soft iron"


@dataclass(frozen=True, slots=True, eq=False)
class ErrorSource:
    """One source, as large as it explains the vectors best."""

    source: Source
    size: Array
    """Shape (3,). Offset, in parts of the known vectors' length; scale of each axis less 1; rotation about each
    axis [deg]; the elements yz, zx and xy of the soft iron; a constant turn about the vertical in the last [deg]."""
    gain: Array
    shift: Array
    """Shape (3, 3) and (3,). ``vector @ gain.T - shift`` is a calibrated vector without it and without a common
    factor; a constant turn, which is another at each attitude, has no such gain."""
    undone: Array
    """Shape (n, 3). The vectors without it."""
    mean_square: float
    """Of what it leaves of the vectors' error."""
    criterion: float
    """Bayesian information criterion, which counts the parameters: the smallest is the best explanation."""


def error_sources(known: ArrayLike, calibrated: ArrayLike, *, down: ArrayLike | None = None) -> list[ErrorSource]:
    """Return the sources, each by itself, that may make calibrated vectors of known ones; the best first.

    Parameters
    ----------
    known, calibrated : shape (n, 3)
        Vectors along the board's axes, n >= 3. A common factor of the calibrated ones does not count: it turns none.
    down : shape (n, 3)
        Known direction of gravity; with it a constant turn about it is one of the sources.
    """
    wanted = np.asarray(known, dtype=np.float64)
    wanted = wanted / math.sqrt(float((wanted**2).sum(axis=1).mean()))
    given = np.asarray(calibrated, dtype=np.float64)
    scale, soft_iron = _scale(wanted, given), _soft_iron(wanted, given)
    # A scale is a soft iron of the three axes alone: it is called so where it explains at least half of what that does.
    all_error = float(((given / _factor(wanted, given) - wanted) ** 2).mean())
    is_scale = all_error - scale.mean_square >= 0.5 * (all_error - soft_iron.mean_square)
    sources = [_offset(wanted, given), scale if is_scale else soft_iron, _rotation(wanted, given)]
    if down is not None:
        sources.append(_constant_turn(wanted, given, np.asarray(down, dtype=np.float64)))
    return sorted(sources, key=lambda source: source.criterion)


def _offset(wanted: Array, given: Array) -> ErrorSource:
    design = np.hstack([wanted.reshape(-1, 1), np.tile(np.eye(3), (len(wanted), 1))])
    factor, *size = _solve(design, given)
    offset: Array = np.array(size) / (factor or 1.0)
    return _linear(Source.OFFSET, offset, np.eye(3) / (factor or 1.0), wanted, given, parameters=3, shift=offset)


def _scale(wanted: Array, given: Array) -> ErrorSource:
    power = (wanted**2).sum(axis=0)
    seen = power > _LEAST_POWER * power.sum()
    # Nothing is known of the gain of an axis along which there was nothing to read.
    gains = np.where(seen, (wanted * given).sum(axis=0) / np.where(seen, power, 1.0), _factor(wanted, given))
    return _linear(Source.SCALE, gains - 1.0, np.linalg.pinv(np.diag(gains)), wanted, given, parameters=2)


def _soft_iron(wanted: Array, given: Array) -> ErrorSource:
    x, y, z = wanted.T
    none = np.zeros_like(x)
    columns = [(x, none, none), (none, y, none), (none, none, z), (none, z, y), (z, none, x), (y, x, none)]
    design = np.stack([np.column_stack(column).ravel() for column in columns], axis=1)
    xx, yy, zz, yz, zx, xy = _solve(design, given)
    size: Array = 3.0 * np.array([yz, zx, xy]) / ((xx + yy + zz) or 1.0)
    matrix = np.array([[xx, xy, zx], [xy, yy, yz], [zx, yz, zz]])
    return _linear(Source.SOFT_IRON, size, np.linalg.pinv(matrix), wanted, given, parameters=5)


def _rotation(wanted: Array, given: Array) -> ErrorSource:
    """Rotate by the orthogonal matrix of the Procrustes problem, its determinant +1 (Kabsch)."""
    left, _, right = np.linalg.svd(given.T @ wanted)
    hand = np.diag([1.0, 1.0, float(np.sign(np.linalg.det(left @ right)))])
    turn = left @ hand @ right
    across = np.array([turn[2, 1] - turn[1, 2], turn[0, 2] - turn[2, 0], turn[1, 0] - turn[0, 1]])
    sine = float(np.linalg.norm(across))
    angle_deg = math.degrees(math.atan2(sine, float(np.trace(turn)) - 1.0))
    size: Array = across * (angle_deg / sine if sine else 0.0)
    return _linear(Source.ROTATION, size, turn.T / _factor(wanted, given @ turn), wanted, given, parameters=3)


def _constant_turn(wanted: Array, given: Array, down: Array) -> ErrorSource:
    """Turn the board about the vertical: its heading is then wrong by the same angle in every attitude."""
    down = down / np.linalg.norm(down, axis=1, keepdims=True)
    along = (given * down).sum(axis=1, keepdims=True) * down
    flat, wanted_flat = given - along, wanted - (wanted * down).sum(axis=1, keepdims=True) * down
    sine, cosine = (np.cross(flat, wanted_flat) * down).sum(), (flat * wanted_flat).sum()
    angle = math.atan2(sine, cosine)
    turned: Array = along + math.cos(angle) * flat + math.sin(angle) * np.cross(down, flat)
    size = np.array([0.0, 0.0, math.degrees(angle)])
    level = np.eye(3) / _factor(wanted, turned)
    return _linear(Source.CONSTANT_TURN, size, level, wanted, turned, parameters=1)


def _solve(design: Array, given: Array) -> list[float]:
    solution: list[float] = np.linalg.lstsq(design, given.ravel(), rcond=None)[0].tolist()
    return solution


def _factor(wanted: Array, given: Array) -> float:
    """Return the common factor of vectors that are those wanted but for it."""
    return float((wanted * given).sum() / (wanted**2).sum()) or 1.0


def _linear(
    source: Source, size: Array, gain: Array, wanted: Array, given: Array, *, parameters: int,
    shift: Array | None = None,
) -> ErrorSource:
    off: Array = np.zeros(3) if shift is None else shift
    undone: Array = given @ gain.T - off
    mean_square = max(_ROUNDING**2, float(((undone - wanted) ** 2).mean()))
    criterion = wanted.size * math.log(mean_square) + parameters * math.log(wanted.size)
    return ErrorSource(source, size, gain, off, undone, mean_square, criterion)
