"""Detection of outliers before an ellipsoid is fitted: wrong rows, motion past iron, a stuck sensor."""

from __future__ import annotations

from itertools import pairwise
from typing import TypeAlias

import numpy as np
from numpy.typing import ArrayLike, NDArray

from hiltest.calibration.conditioning import quadric_rows, traceless
from hiltest.calibration.fit import Array, points_array, squared_lengths
from hiltest.calibration.plane import FLAT, RING, Plane

Mask: TypeAlias = NDArray[np.bool_]

#: Largest distance in scatters of the readings about the ellipsoid. 1 in 150 000 readings with normal noise is further
#: out.
FURTHEST = 4.5
#: Share of omitted readings above which a log gets a warning. With a tenth of wrong readings none of 384 logs was
#: calibrated wrongly, with a fifth 6 of 48.
MANY_LEFT_OUT = 0.2
# Minimum number of readings, two per unknown: with fewer, outliers cannot be distinguished.
_FEWEST = 18

#: Factor from the median of absolute values to the standard deviation of a normal distribution.
SIGMA = 1.4826
# Tukey's biweight: distance at which a reading's weight becomes zero, in scatters.
_WEIGHT_ENDS = 6.0
# Largest change of a weight at which the reweighting ends; then no reading moves over `FURTHEST`.
_SETTLED, _MOST_PASSES = 1e-3, 50
# Least scatter relative to the cloud's size: 5 nT in the earth's field, finer than any sensor.
_LEAST_SCATTER = 1e-4

# A cloud's size is computed from at most this many pieces of the log, of at least this many readings each; a piece that
# is closer to the previous one than this part of the size belongs to the same rest. So a minute on the bench weighs no
# more than a turn.
_PIECES, _LEAST_PIECE, _WHOLE_BELOW, _MOVED = 200, 5, 100, 0.05
# Four readings make a sphere; with a fifth of the readings as outliers, 400 draws miss a good four with a probability
# of 1e-91, with half of them 6e-12. Each is rated on at most this many readings.
_DRAWS, _RATED = 400, 2_000
# Largest distance from the sphere by a board's soft iron, relative to the radius.
_FAR = 0.3
# Minimum part of the readings in a plane: with less the others may be a tilt instead of outliers.
_IN_PLANE = 0.85
# Number of readings of a long log that the passes use; all are tested in the end.
_MOST_FITTED = 50_000


def repeats(points: ArrayLike) -> Mask:
    """Return a mask of readings, shape (n, 3), that equal the previous one."""
    readings = points_array(points)
    repeated: Mask = np.append(
        np.zeros(min(1, len(readings)), dtype=bool), (np.diff(readings, axis=0) == 0.0).all(axis=1)
    )
    return repeated


def outliers(points: ArrayLike) -> Mask:
    """Return a mask of readings that are further from the others' ellipsoid than noise explains.

    Parameters
    ----------
    points : shape (n, 3)
        Readings in the order of time, in any unit.

    Returns
    -------
    ndarray of bool, shape (n,)
        Mask; all False for fewer than 18 readings, and for readings on a line or in one place.

    Notes
    -----
    The method has three steps, each covering a weakness of the previous one. The cloud's size is that of the moving
    pieces of the log, so that neither a rest nor an outlier determines it. A sphere by least median of squares over
    random fours detects distant readings (Rousseeuw, Least median of squares regression, 1984): it tolerates half of
    the readings as outliers, but is not an ellipsoid, so only readings beyond the effect of soft iron are excluded.
    Then the quadric of unit trace is fitted with Tukey's biweight on Sampson's distance, ``|D| / |grad D|``, until the
    weights settle. The draws are deterministic. For readings in a plane an ellipse is fitted, and readings far from the
    plane are outliers.
    """
    all_readings = points_array(points)
    out = np.zeros(len(all_readings), dtype=bool)
    distinct = np.flatnonzero(~repeats(all_readings))
    if len(distinct) < _FEWEST:
        return out
    readings = all_readings[distinct]
    moving, middle, size = _moving_pieces(readings)
    if not size > 0.0:
        return out
    readings = (readings - middle) / size
    chosen = np.arange(0, len(readings), -(-len(readings) // _MOST_FITTED))
    flat = _fit_plane(readings[chosen], moving[chosen])
    inside = None if flat is None else _surface_distances(readings @ flat.axes[:2].T, chosen, moving)
    if flat is not None and inside is not None and inside[1] <= RING:
        off_plane = (readings - flat.middle) @ flat.axes[2]
        wild = _is_far(*inside) | _is_far(off_plane, max(_LEAST_SCATTER, flat.thickness))
    elif (off := _surface_distances(readings, chosen, moving)) is not None:
        wild = _is_far(*off)
    else:
        return out
    # Repetitions of an outlier are outliers too.
    out[:] = np.repeat(wild, np.diff(np.append(distinct, len(all_readings))))
    return out


def _surface_distances(readings: Array, chosen: NDArray[np.intp], moving: Mask) -> tuple[Array, float] | None:
    """Return the distances of readings from the surface of the chosen ones, and the scatter of these."""
    fitted = _robust_ellipsoid(readings[chosen], moving[chosen])
    return None if fitted is None else (_distances(fitted[0], readings), fitted[1])


def _is_far(distances: Array, scatter: float) -> Mask:
    wild: Mask = np.abs(distances) > FURTHEST * scatter
    return wild


def _moving_pieces(readings: Array) -> tuple[Mask, Array, float]:
    """Return a mask of readings in moving pieces of the log, and the middle and the size of these."""
    count = len(readings)
    pieces = count if count < _WHOLE_BELOW else min(_PIECES, count // _LEAST_PIECE)
    edges = np.arange(pieces + 1) * count // pieces
    medians = np.array([np.median(readings[a:b], axis=0) for a, b in pairwise(edges)])
    used = np.arange(pieces)
    middle: Array = np.median(medians, axis=0)
    size = float(np.linalg.norm(medians - middle, axis=1).max())
    while True:
        thinned = _distinct_pieces(medians, _MOVED * size)
        centre: Array = np.median(medians[thinned], axis=0)
        smaller = float(np.percentile(np.linalg.norm(medians[thinned] - centre, axis=1), 75))
        # The size falls each time, and ends at 0 at the latest.
        if not smaller < size:
            break
        used, middle, size = thinned, centre, smaller
    moving = np.zeros(count, dtype=bool)
    for piece in used:
        moving[edges[piece] : edges[piece + 1]] = True
    return moving, middle, size


def _distinct_pieces(medians: Array, distance: float) -> NDArray[np.intp]:
    """Return the pieces that are further than a distance from the last selected one."""
    used = [0]
    for place, median in enumerate(medians):
        if float(np.linalg.norm(median - medians[used[-1]])) > distance:
            used.append(place)
    return np.array(used)


def _robust_ellipsoid(readings: Array, moving: Mask) -> tuple[Array, float] | None:
    """Return the robust ellipsoid of the readings, and their scatter about it; None if it is undetermined.

    A small cap is curved less than its noise: its least-squares quadric is not an ellipsoid, or one as flat as the cap
    with more scatter than the initial sphere, so the sphere replaces it.
    """
    sphere = _median_sphere(readings[moving])
    if sphere is None:
        return None
    centre, radius, median = sphere
    off = np.abs(np.linalg.norm(readings - centre, axis=1) - radius)
    weights = (off <= max(_FAR * radius, _WEIGHT_ENDS * SIGMA * median)).astype(np.float64)
    for terms in (len(traceless(readings.shape[1])), 0):
        parameters, scatter = _reweight_until_settled(readings, moving, weights, terms)
        closed = float(np.linalg.eigvalsh(_shape(parameters, readings.shape[1]))[0]) > 0.0
        if closed and scatter <= max(_LEAST_SCATTER, SIGMA * median):
            break
    return parameters, scatter


def _reweight_until_settled(readings: Array, moving: Mask, weights: Array, terms: int) -> tuple[Array, float]:
    """Return the parameters, with `terms` non-zero shape terms, and the scatter after the weights settle."""
    # A small number of readings is closer to the fitted surface than to the true one.
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


def _fit_plane(readings: Array, moving: Mask) -> Plane | None:
    """Return the plane of all but a few readings; None without one."""
    rated, drawn = _draws(readings[moving], 3)
    normals = np.cross(drawn[:, 1] - drawn[:, 0], drawn[:, 2] - drawn[:, 0])
    lengths = np.linalg.norm(normals, axis=1)
    normals = normals[lengths > 0.0] / lengths[lengths > 0.0, None]
    if not len(normals):
        return None
    distances = np.abs(rated @ normals.T - (drawn[lengths > 0.0, 0] * normals).sum(axis=1))
    best = int(np.median(distances, axis=0).argmin())
    near = distances[:, best] <= FURTHEST * max(_LEAST_SCATTER, SIGMA * float(np.median(distances[:, best])))
    plane = Plane.fit(rated[near])
    return plane if near.mean() >= _IN_PLANE and plane.thickness <= FLAT else None


def _weighted_quadric(readings: Array, weights: Array, terms: int) -> Array:
    """Return the parameters of `quadric_rows` by weighted least squares; shape terms after `terms` are zero."""
    rows, target = quadric_rows(readings), -squared_lengths(readings)
    free = np.arange(rows.shape[1])
    free = free[(free < terms) | (free >= len(traceless(readings.shape[1])))]
    rows = rows[:, free]
    weighted = rows * weights[:, None]
    parameters = np.zeros(free[-1] + 1)
    # The solution has the least norm if the readings leave a direction undetermined.
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
    distances: Array = value / np.maximum(slope, 1e-9)  # 0 only at the centre, which is far from the surface
    return distances
