"""Readings that belong to no ellipsoid, found before any is fitted: wild rows, trails past iron, a stuck sensor."""

from __future__ import annotations

from itertools import pairwise
from typing import TypeAlias

import numpy as np
from numpy.typing import ArrayLike, NDArray

from hiltest.calibration.conditioning import quadric_rows, traceless
from hiltest.calibration.fit import Array, points_array, squared_lengths
from hiltest.calibration.plane import FLAT, RING, Plane

Mask: TypeAlias = NDArray[np.bool_]

#: Times the scatter of the readings about the ellipsoid. Of readings with normal noise 1 in 150 000 is further out.
FURTHEST = 4.5
#: Part of the readings from which on leaving them out is worth a warning. Of logs with a tenth spoilt none of 384
#: was calibrated wrongly, of those with a fifth 6 of 48.
MANY_LEFT_OUT = 0.2
# Two for each unknown, as where a residual begins to be known: with less nothing tells a wild row from a good one.
_FEWEST = 18

#: From the median of absolute values to the standard deviation of a normal distribution.
SIGMA = 1.4826
# Tukey's biweight: where a reading's weight ends, in scatters.
_WEIGHT_ENDS = 6.0
# Largest change of a weight at which the reweighting ends; then no reading moves over `FURTHEST`.
_SETTLED, _MOST_PASSES = 1e-3, 50
# Of the cloud's size, the least scatter: 5 nT in the earth's field, finer than any sensor reads.
_LEAST_SCATTER = 1e-4

# A cloud's size comes from the log cut into so many pieces at most, of at least so many readings each; a piece nearer
# to the one before than this part of the size is the same rest. So a minute on the bench weighs no more than a turn.
_PIECES, _LEAST_PIECE, _WHOLE_BELOW, _MOVED = 200, 5, 100, 0.05
# Four readings make a sphere; with a fifth of the readings wild, 400 draws miss a good four with a chance of 1e-91,
# with half of them wild with one of 6e-12. Each is rated on so many readings at most.
_DRAWS, _RATED = 400, 2_000
# Of the radius: how far the soft iron of a board takes a reading from the sphere.
_FAR = 0.3
# Part of the readings that a plane has to hold: with less the others may be a tilt, and no wild rows.
_IN_PLANE = 0.85
# Readings that the passes take of a long log; all are tested in the end.
_MOST_FITTED = 50_000


def repeats(points: ArrayLike) -> Mask:
    """Say of each reading, shape (n, 3), whether it equals the one before it."""
    given = points_array(points)
    repeated: Mask = np.append(np.zeros(min(1, len(given)), dtype=bool), (np.diff(given, axis=0) == 0.0).all(axis=1))
    return repeated


def outliers(points: ArrayLike) -> Mask:
    """Say of each reading whether it is too far from the ellipsoid of the others to be its noise.

    Parameters
    ----------
    points : shape (n, 3)
        Readings in the order in which they were taken, in any unit.

    Returns
    -------
    ndarray of bool, shape (n,)
        All False for fewer than 18 readings, and for readings on a line or in one place.

    Notes
    -----
    Three steps, each for what the one before cannot do. The cloud's size is that of the pieces of the log that moved,
    so that neither a rest nor a wild row sets it. A sphere by least median of squares over random fours tells what is
    far off (Rousseeuw, Least median of squares regression, 1984): it stands up to half of the readings being wild, but
    is no ellipsoid, so only readings beyond what soft iron does are set aside. Then the quadric of unit trace is
    fitted with Tukey's biweight on Sampson's distance, ``|D| / |grad D|``, until the weights settle. The draws are
    the same every time. Readings in a plane are fitted by an ellipse in it, and none may be far from it.
    """
    given = points_array(points)
    out = np.zeros(len(given), dtype=bool)
    distinct = np.flatnonzero(~repeats(given))
    if len(distinct) < _FEWEST:
        return out
    readings = given[distinct]
    moving, middle, size = _moving(readings)
    if not size > 0.0:
        return out
    readings = (readings - middle) / size
    chosen = np.arange(0, len(readings), -(-len(readings) // _MOST_FITTED))
    flat = _flat(readings[chosen], moving[chosen])
    inside = None if flat is None else _off_surface(readings @ flat.axes[:2].T, chosen, moving)
    if flat is not None and inside is not None and inside[1] <= RING:
        off_plane = (readings - flat.middle) @ flat.axes[2]
        wild = _far(*inside) | _far(off_plane, max(_LEAST_SCATTER, flat.thickness))
    elif (off := _off_surface(readings, chosen, moving)) is not None:
        wild = _far(*off)
    else:
        return out
    # What repeats a wild reading is as wild.
    out[:] = np.repeat(wild, np.diff(np.append(distinct, len(given))))
    return out


def _off_surface(readings: Array, chosen: NDArray[np.intp], moving: Mask) -> tuple[Array, float] | None:
    """Return how far readings, in space or in a plane, are from what the chosen ones agree on, and those's scatter."""
    fitted = _reweighted(readings[chosen], moving[chosen])
    return None if fitted is None else (_distances(fitted[0], readings), fitted[1])


def _far(distances: Array, scatter: float) -> Mask:
    wild: Mask = np.abs(distances) > FURTHEST * scatter
    return wild


def _moving(readings: Array) -> tuple[Mask, Array, float]:
    """Return which readings are of a piece of the log that moved, and the middle and the size of those."""
    count = len(readings)
    pieces = count if count < _WHOLE_BELOW else min(_PIECES, count // _LEAST_PIECE)
    edges = np.arange(pieces + 1) * count // pieces
    medians = np.array([np.median(readings[a:b], axis=0) for a, b in pairwise(edges)])
    kept = np.arange(pieces)
    middle: Array = np.median(medians, axis=0)
    size = float(np.linalg.norm(medians - middle, axis=1).max())
    while True:
        thinned = _apart(medians, _MOVED * size)
        centre: Array = np.median(medians[thinned], axis=0)
        smaller = float(np.percentile(np.linalg.norm(medians[thinned] - centre, axis=1), 75))
        # It falls each time, and ends at 0 at the latest.
        if not smaller < size:
            break
        kept, middle, size = thinned, centre, smaller
    moving = np.zeros(count, dtype=bool)
    for piece in kept:
        moving[edges[piece] : edges[piece + 1]] = True
    return moving, middle, size


def _apart(medians: Array, distance: float) -> NDArray[np.intp]:
    """Return the pieces that are further than a distance from the last that was kept."""
    kept = [0]
    for place, median in enumerate(medians):
        if float(np.linalg.norm(median - medians[kept[-1]])) > distance:
            kept.append(place)
    return np.array(kept)


def _reweighted(readings: Array, moving: Mask) -> tuple[Array, float] | None:
    """Return the ellipsoid that the readings agree on, and their scatter about it; None where they fix none.

    A small cap is bent less than its noise: what fits its squares best is no ellipsoid, or one as flat as the cap with
    more scatter than the sphere that it started from, and a sphere stands in for it.
    """
    sphere = _median_sphere(readings[moving])
    if sphere is None:
        return None
    centre, radius, median = sphere
    off = np.abs(np.linalg.norm(readings - centre, axis=1) - radius)
    weights = (off <= max(_FAR * radius, _WEIGHT_ENDS * SIGMA * median)).astype(np.float64)
    for terms in (len(traceless(readings.shape[1])), 0):
        parameters, scatter = _settled(readings, moving, weights, terms)
        closed = float(np.linalg.eigvalsh(_shape(parameters, readings.shape[1]))[0]) > 0.0
        if closed and scatter <= max(_LEAST_SCATTER, SIGMA * median):
            break
    return parameters, scatter


def _settled(readings: Array, moving: Mask, weights: Array, terms: int) -> tuple[Array, float]:
    """Return parameters, with so many terms of shape that are not zero, and the scatter when the weights settle."""
    # Few readings lie closer to what is fitted to them than to what is true.
    free = np.sqrt(len(readings) / max(1, len(readings) - terms - readings.shape[1] - 1))
    for _ in range(_MOST_PASSES):
        parameters = _weighted_quadric(readings, weights, terms)
        distances = _distances(parameters, readings)
        scatter = max(_LEAST_SCATTER, free * SIGMA * float(np.median(np.abs(distances[moving]))))
        before = weights
        weights = np.clip(1.0 - (distances / (_WEIGHT_ENDS * scatter)) ** 2, 0.0, None) ** 2
        if float(np.abs(weights - before).max()) < _SETTLED:
            break
    return parameters, scatter


def _median_sphere(readings: Array) -> tuple[Array, float, float] | None:
    """Return centre, radius and median distance of the sphere, or circle, with the smallest median distance."""
    rated, drawn = _draws(readings, readings.shape[1] + 1)
    matrices = np.concatenate([2.0 * drawn, np.ones((*drawn.shape[:2], 1))], axis=2)
    solvable = np.abs(np.linalg.det(matrices)) > 1e-9  # four in a plane make no sphere
    if not solvable.any():
        return None
    solved = np.linalg.solve(matrices[solvable], (drawn[solvable] ** 2).sum(axis=2)[..., None])[..., 0]
    centres = solved[:, :-1]
    radii = np.sqrt(np.maximum(0.0, solved[:, -1] + (centres * centres).sum(axis=1)))
    distances = np.linalg.norm(rated - centres[:, None], axis=2) - radii[:, None]
    medians = np.median(np.abs(distances), axis=1)
    best = int(medians.argmin())
    return centres[best], float(radii[best]), float(medians[best])


def _draws(readings: Array, size: int) -> tuple[Array, Array]:
    """Return the readings that a draw is rated by, and the draws, shape (draws, size, axes)."""
    random = np.random.default_rng(0)
    rated = readings if len(readings) <= _RATED else readings[random.choice(len(readings), _RATED, replace=False)]
    return rated, rated[random.integers(0, len(rated), (_DRAWS, size))]


def _flat(readings: Array, moving: Mask) -> Plane | None:
    """Return the plane that all but a few readings lie in, None where there is none."""
    rated, drawn = _draws(readings[moving], 3)
    normals = np.cross(drawn[:, 1] - drawn[:, 0], drawn[:, 2] - drawn[:, 0])
    lengths = np.linalg.norm(normals, axis=1)
    normals = normals[lengths > 0.0] / lengths[lengths > 0.0, None]
    if not len(normals):
        return None
    distances = np.abs(rated @ normals.T - (drawn[lengths > 0.0, 0] * normals).sum(axis=1))
    best = int(np.median(distances, axis=0).argmin())
    near = distances[:, best] <= FURTHEST * max(_LEAST_SCATTER, SIGMA * float(np.median(distances[:, best])))
    plane = Plane.of(rated[near])
    return plane if near.mean() >= _IN_PLANE and plane.thickness <= FLAT else None


def _weighted_quadric(readings: Array, weights: Array, terms: int) -> Array:
    """Return the parameters of `quadric_rows` by weighted least squares; those of shape behind `terms` are zero."""
    rows, target = quadric_rows(readings), -squared_lengths(readings)
    free = np.arange(rows.shape[1])
    free = free[(free < terms) | (free >= len(traceless(readings.shape[1])))]
    rows = rows[:, free]
    weighted = rows * weights[:, None]
    parameters = np.zeros(free[-1] + 1)
    # Least norm where the readings leave a direction open.
    parameters[free] = np.linalg.lstsq(weighted.T @ rows, weighted.T @ target, rcond=1e-12)[0]
    return parameters


def _shape(parameters: Array, axes: int) -> Array:
    """Return the matrix of a quadric's squares."""
    basis = traceless(axes)
    shape: Array = np.eye(axes) + np.tensordot(parameters[: len(basis)], basis, axes=1)
    return shape


def _distances(parameters: Array, readings: Array) -> Array:
    """Return Sampson's distances from a quadric, signed."""
    axes = readings.shape[1]
    value = squared_lengths(readings) + quadric_rows(readings) @ parameters
    slope = np.linalg.norm(2.0 * readings @ _shape(parameters, axes) + parameters[-axes - 1 : -1], axis=1)
    distances: Array = value / np.maximum(slope, 1e-9)  # 0 at the centre alone, which is far from the surface
    return distances
