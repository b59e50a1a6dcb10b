"""Source of a calibrated sensor's error at known attitudes: offset, scale, soft iron, rotation or a constant turn."""

from __future__ import annotations

import math
from dataclasses import dataclass
from enum import StrEnum

import numpy as np
from numpy.typing import ArrayLike

from hiltest.calibration.fit import Array

# Relative residual of a vector below which it is rounding of the firmware's float32: 0.002 degrees.
_ROUNDING = 3.5e-5

# Minimum part of the known vectors' squares along an axis that determines its gain: 0.05 for gravity at tilts of 20
# degrees, 1e-4 for an operator's level.
_LEAST_POWER = 1e-3


class Source(StrEnum):
    """Cause of a difference between calibrated and known vectors."""

    CONSTANT_TURN = "constant turn"
    OFFSET = "offset"
    SCALE = "scale"
    ROTATION = "rotation"
    SOFT_IRON = "soft iron"


@dataclass(frozen=True, slots=True, eq=False)
class ErrorSource:
    """One source, with the size that explains the vectors best."""

    source: Source
    size: Array
    """Shape (3,). Offset, relative to the known vectors' length; scale of each axis minus 1; rotation about each axis
    [deg]; the elements yz, zx and xy of the soft iron; a constant turn about the vertical in the last [deg]."""
    gain: Array
    shift: Array
    """Shape (3, 3) and (3,). ``vector @ gain.T - shift`` is a calibrated vector without it and without a common
    factor; a constant turn, which is another at each attitude, has no such gain."""
    undone: Array
    """Shape (n, 3). The vectors without it."""
    mean_square: float
    """Mean square error of the vectors without it."""
    criterion: float
    """Bayesian information criterion, which counts the parameters: the smallest is the best explanation."""


def error_sources(truth: ArrayLike, calibrated: ArrayLike, *, down: ArrayLike | None = None) -> list[ErrorSource]:
    """Return the sources that separately may explain calibrated vectors from known ones, the best first.

    Parameters
    ----------
    truth, calibrated : shape (n, 3)
        Vectors along the board's axes, n >= 3. A common factor of the calibrated ones is ignored, because it rotates
        none.
    down : shape (n, 3)
        Known direction of gravity; with it a constant turn about it is one of the sources.
    """
    reference = np.asarray(truth, dtype=np.float64)
    reference = reference / math.sqrt(float((reference**2).sum(axis=1).mean()))
    measured = np.asarray(calibrated, dtype=np.float64)
    scale, soft_iron = _scale(reference, measured), _soft_iron(reference, measured)
    # A scale is a soft iron with only diagonal elements: it is preferred if it explains at least half as much.
    all_error = float(((measured / _factor(reference, measured) - reference) ** 2).mean())
    is_scale = all_error - scale.mean_square >= 0.5 * (all_error - soft_iron.mean_square)
    sources = [_offset(reference, measured), scale if is_scale else soft_iron, _rotation(reference, measured)]
    if down is not None:
        sources.append(_constant_turn(reference, measured, np.asarray(down, dtype=np.float64)))
    return sorted(sources, key=lambda source: source.criterion)


def _offset(reference: Array, measured: Array) -> ErrorSource:
    design = np.hstack([reference.reshape(-1, 1), np.tile(np.eye(3), (len(reference), 1))])
    factor, *size = _solve(design, measured)
    offset: Array = np.array(size) / (factor or 1.0)
    return _linear(Source.OFFSET, offset, np.eye(3) / (factor or 1.0), reference, measured, parameters=3, shift=offset)


def _scale(reference: Array, measured: Array) -> ErrorSource:
    power = (reference**2).sum(axis=0)
    has_power = power > _LEAST_POWER * power.sum()
    # The gain of an axis without any component is undetermined.
    gains = np.where(
        has_power, (reference * measured).sum(axis=0) / np.where(has_power, power, 1.0), _factor(reference, measured)
    )
    return _linear(Source.SCALE, gains - 1.0, np.linalg.pinv(np.diag(gains)), reference, measured, parameters=2)


def _soft_iron(reference: Array, measured: Array) -> ErrorSource:
    x, y, z = reference.T
    none = np.zeros_like(x)
    columns = [(x, none, none), (none, y, none), (none, none, z), (none, z, y), (z, none, x), (y, x, none)]
    design = np.stack([np.column_stack(column).ravel() for column in columns], axis=1)
    xx, yy, zz, yz, zx, xy = _solve(design, measured)
    size: Array = 3.0 * np.array([yz, zx, xy]) / ((xx + yy + zz) or 1.0)
    matrix = np.array([[xx, xy, zx], [xy, yy, yz], [zx, yz, zz]])
    return _linear(Source.SOFT_IRON, size, np.linalg.pinv(matrix), reference, measured, parameters=5)


def _rotation(reference: Array, measured: Array) -> ErrorSource:
    """Rotate by the orthogonal matrix of the Procrustes problem, its determinant +1 (Kabsch)."""
    u, _, right = np.linalg.svd(measured.T @ reference)
    hand = np.diag([1.0, 1.0, float(np.sign(np.linalg.det(u @ right)))])
    turn = u @ hand @ right
    across = np.array([turn[2, 1] - turn[1, 2], turn[0, 2] - turn[2, 0], turn[1, 0] - turn[0, 1]])
    sine = float(np.linalg.norm(across))
    angle_deg = math.degrees(math.atan2(sine, float(np.trace(turn)) - 1.0))
    size: Array = across * (angle_deg / sine if sine else 0.0)
    return _linear(
        Source.ROTATION, size, turn.T / _factor(reference, measured @ turn), reference, measured, parameters=3
    )


def _constant_turn(reference: Array, measured: Array, down: Array) -> ErrorSource:
    """Turn the board about the vertical: its heading is then wrong by the same angle in every attitude."""
    down = down / np.linalg.norm(down, axis=1, keepdims=True)
    along = (measured * down).sum(axis=1, keepdims=True) * down
    flat, wanted_flat = measured - along, reference - (reference * down).sum(axis=1, keepdims=True) * down
    sine, cosine = (np.cross(flat, wanted_flat) * down).sum(), (flat * wanted_flat).sum()
    angle = math.atan2(sine, cosine)
    turned: Array = along + math.cos(angle) * flat + math.sin(angle) * np.cross(down, flat)
    size = np.array([0.0, 0.0, math.degrees(angle)])
    level = np.eye(3) / _factor(reference, turned)
    return _linear(Source.CONSTANT_TURN, size, level, reference, turned, parameters=1)


def _solve(design: Array, measured: Array) -> list[float]:
    solution: list[float] = np.linalg.lstsq(design, measured.ravel(), rcond=None)[0].tolist()
    return solution


def _factor(reference: Array, measured: Array) -> float:
    """Return the common factor between measured and reference vectors."""
    return float((reference * measured).sum() / (reference**2).sum()) or 1.0


def _linear(
    source: Source,
    size: Array,
    gain: Array,
    reference: Array,
    measured: Array,
    *,
    parameters: int,
    shift: Array | None = None,
) -> ErrorSource:
    off: Array = np.zeros(3) if shift is None else shift
    undone: Array = measured @ gain.T - off
    mean_square = max(_ROUNDING**2, float(((undone - reference) ** 2).mean()))
    criterion = reference.size * math.log(mean_square) + parameters * math.log(reference.size)
    return ErrorSource(source, size, gain, off, undone, mean_square, criterion)
