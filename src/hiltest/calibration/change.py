"""Detection of a step of the hard iron in a log, with its place and size, and of a growth of the field."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from hiltest.calibration.fit import ELLIPSOID_UNKNOWNS, Array, points_array
from hiltest.calibration.plain_quadric import PlainQuadric
from hiltest.calibration.robust import SIGMA

#: Smallest step relative to the radius: 1.7 degrees across.
LEAST_STEP_PERCENT = 3.0
# Minimum part of the residual's squares that a step must explain. None of 22 clean recorded logs has such a step.
_LEAST_EXPLAINED = 0.2
# Largest deviation of a step relative to the radius, so that a log with few data on one side of an instant raises no
# alarm.
_LARGEST_DEVIATION = 0.03
# Deviations of a growth above which it is no accident.
_CLEARLY = 4.0
# Blocks of a log in time: a step is located to 1.25 % of it, and each part has at least 15 %. Two neighbours together
# are a block of the sandwich.
_BLOCKS, _LEAST_BLOCKS = 80, 12
# Minimum number of rows per block, so that its sums do not depend on one reading.
_FEWEST = 2 * _BLOCKS
# Limits for trimming before the search, relative to the median distance from the middle, and to the scatter about a
# plain fit. Two states of the hard iron are far closer together.
_GATE, _TRIM, _PASSES = 3.0, 5.0 * SIGMA, 4


@dataclass(frozen=True, slots=True, eq=False)
class Change:
    """A step of the hard iron."""

    row: int
    """First reading after the step."""
    step: Array
    """Shape (3,). Change of the hard iron, in the unit of the readings."""
    percent: float
    """Length of the step relative to the radius."""


def find_change(points: ArrayLike) -> Change | None:
    """Return the step of the hard iron that explains a log best; None if none does.

    Parameters
    ----------
    points : shape (n, 3)
        Readings in the order of time; fewer than 160 cannot show a step.

    Notes
    -----
    With the rows d of `CentredPoints.rows` and the slope ``g = 2 A (p - c)`` of the fitted quadric, a step b of the
    centre at the instant tau leaves ``|p|^2 + d . t - [after tau] g . b``, linear in t and b. Its deviation is that of
    a sandwich over the blocks, since noise lasts. Of all instants with a deviation of at most 3 % of the radius the one
    that leaves the smallest sum of squares counts, if it takes away a fifth of the squares and the step is 3 % or more.
    All sums are of blocks, so an instant costs no pass over the readings.
    """
    trimmed = _trim(points_array(points))
    if trimmed is None:
        return None
    used, quadric, square, slopes = trimmed
    radius = math.sqrt(max(0.0, square))
    sums, edges = _block_sums(quadric, -slopes)
    steps = [_step(sums, place) for place in range(_LEAST_BLOCKS, _BLOCKS - _LEAST_BLOCKS + 1)]
    valid = [step for step in steps if step is not None and step.deviation <= _LARGEST_DEVIATION * radius]
    if not valid:
        return None
    best = max(valid, key=lambda step: step.explained)
    percent = 100.0 * float(np.linalg.norm(best.step)) / radius
    if percent < LEAST_STEP_PERCENT or best.explained < _LEAST_EXPLAINED:
        return None
    return Change(int(used[edges[best.place]]), quadric.centred.scale * best.step, percent)


def find_growth(points: ArrayLike) -> float | None:
    """Return the growth of the field's strength over a log, relative to its middle [%]; None if there is none.

    Parameters
    ----------
    points : shape (n, 3)
        Readings in the order of time; fewer than 160 cannot show a growth.

    Notes
    -----
    A strength that grows by g from the first to the last reading leaves ``|p|^2 + d . t - 2 g R^2 s``, with s from -1/2
    to 1/2, linear in t and g. It counts from 3 % on, and from four of its deviations, of a sandwich over the blocks.
    """
    readings = points_array(points)
    trimmed = _trim(readings)
    if trimmed is None:
        return None
    used, quadric, square, _ = trimmed
    blocks, _ = _block_sums(quadric, (used / max(1, len(readings) - 1) - 0.5)[:, None])
    blocks = blocks[::2] + blocks[1::2]
    whole = blocks.sum(axis=0)
    try:
        inverse = np.linalg.inv(whole[:-1, :-1])
    except np.linalg.LinAlgError:
        return None
    solved = inverse @ whole[:-1, -1]
    scores = (blocks[:, :-1, -1] - blocks[:, :-1, :-1] @ solved) @ inverse[-1]
    growth, deviation = -float(solved[-1]) / (2.0 * square), math.sqrt(float(scores @ scores)) / (2.0 * square)
    return 100.0 * growth if abs(growth) >= max(0.01 * LEAST_STEP_PERCENT, _CLEARLY * deviation) else None


def _block_sums(quadric: PlainQuadric, further: Array) -> tuple[Array, NDArray[np.int64]]:
    """Return the sums of products of the rows, further columns and the target in each block, and the blocks' edges."""
    edges = np.arange(_BLOCKS + 1) * len(quadric.rows) // _BLOCKS
    every = np.column_stack([quadric.rows, further, quadric.target])
    return np.array([part.T @ part for part in np.split(every, edges[1:-1])]), edges


@dataclass(frozen=True, slots=True, eq=False)
class _Step:
    place: int
    step: Array
    deviation: float
    explained: float


def _trim(points: Array) -> tuple[NDArray[np.intp], PlainQuadric, float, Array] | None:
    """Return the readings without outliers, their fit, and its squared radius and slopes.

    The result is None if there are too few readings, or if they are on no ellipsoid.
    """
    if len(points) < _FEWEST:
        return None
    off = np.linalg.norm(points - np.median(points, axis=0), axis=1)
    used = np.flatnonzero(off <= _GATE * float(np.median(off)))
    fit = PlainQuadric.fit(points[used])
    for _ in range(_PASSES):
        if fit is None:
            return None
        residuals = np.abs(fit.residuals)
        inside = residuals <= _TRIM * float(np.median(residuals))
        if inside.all():
            break
        used = used[inside]
        fit = PlainQuadric.fit(points[used])
    ellipsoid = None if fit is None or len(used) < _FEWEST else fit.ellipsoid()
    return None if fit is None or ellipsoid is None else (used, fit, *ellipsoid)


def _step(sums: Array, place: int) -> _Step | None:
    """Solve for a step at the beginning of a block."""
    unknowns = ELLIPSOID_UNKNOWNS + 3
    blocks = sums.copy()
    # Before the instant the columns of the step are zero.
    blocks[:place, ELLIPSOID_UNKNOWNS:unknowns, :] = 0.0
    blocks[:place, :, ELLIPSOID_UNKNOWNS:unknowns] = 0.0
    whole = blocks.sum(axis=0)
    normal, along, squares = whole[:unknowns, :unknowns], whole[:unknowns, unknowns], float(whole[unknowns, unknowns])
    try:
        inverse = np.linalg.inv(normal)
        without = np.linalg.solve(normal[:ELLIPSOID_UNKNOWNS, :ELLIPSOID_UNKNOWNS], along[:ELLIPSOID_UNKNOWNS])
    except np.linalg.LinAlgError:
        return None
    solved = inverse @ along
    remaining, left_without = squares - float(along @ solved), squares - float(along[:ELLIPSOID_UNKNOWNS] @ without)
    scores = blocks[:, :unknowns, unknowns] - blocks[:, :unknowns, :unknowns] @ solved
    scores = scores[::2] + scores[1::2]
    covariance = inverse @ (scores.T @ scores) @ inverse
    variance = float(np.trace(covariance[ELLIPSOID_UNKNOWNS:, ELLIPSOID_UNKNOWNS:]))
    if not (left_without > 0.0 and variance >= 0.0):
        return None
    return _Step(place, solved[ELLIPSOID_UNKNOWNS:], variance**0.5, 1.0 - remaining / left_without)
