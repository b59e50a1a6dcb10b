"""Distances of points from an ellipsoid in terms of centre and soft iron, for iterative calibrators.

Notes
-----
The parameters are the centre c and the elements s of the symmetric soft iron ``C = sum s_k B_k``. With
``u = C (p - c)``:

- calibrated norm: ``|u| - 1``,
- squared norm: ``|u|^2 - 1``,
- geometric distance: of the point from the nearest one of the surface, signed. That point f has
  ``p - f = t C^2 (f - c)``; in the axes of C with eigenvalues l, ``sum (l q_i / (1 + t l^2))^2 = 1`` is convex and
  falls with t, so Newton's method from the left finds it. Moving the surface changes the distance by the change of the
  norm at f, divided by the norm's slope there.
"""

from __future__ import annotations

from collections.abc import Callable
from functools import lru_cache
from typing import TypeAlias

import numpy as np

from hiltest.calibration.clouds import FURTHEST_CENTRE, Clouds, Reference, Solution
from hiltest.calibration.fit import BIAS_LEFT, SMALLEST_DETERMINANT, Array, FitStatus

#: Function of parameters and points that returns residuals, shape (n,), and their derivatives by the parameters, shape
#: (n, parameters).
Residuals: TypeAlias = Callable[[Array, Array], tuple[Array, Array]]
#: Function of points, shape (n, axes), and the sensor's zero that returns the parameters, or the status of a failure.
Search: TypeAlias = Callable[[Array, Array], Array | FitStatus]

# Newton's steps on the foot points: 10 at most for 2000 points from the centre to 1.5 times an ellipsoid of two to one.
_FOOT_STEPS = 50
_TINY = 1e-12


def one_by_one(search: Search, *, bias_share: float = BIAS_LEFT) -> Reference:
    """Return the calibrator that searches each instance on its own."""

    def solve(clouds: Clouds) -> Solution:
        axes, instances = clouds.axes, clouds.scale.shape
        soft_iron = np.broadcast_to(np.eye(axes), (*instances, axes, axes)).copy()
        centre, status = np.zeros((*instances, axes)), np.zeros(instances, dtype=np.int8)
        for place in np.ndindex(instances):
            result = search(clouds.points[place], clouds.zero[place])
            status[place] = result if isinstance(result, FitStatus) else ellipsoid_status(result, axes)
            if not isinstance(result, FitStatus):
                centre[place], soft_iron[place] = result[:axes], positive_soft_iron(result, axes)
        return Solution(soft_iron, centre, status)

    return Reference(solve, bias_share)


@lru_cache
def symmetric_basis(axes: int) -> Array:
    """Return symmetric matrices with a one for each element on and above the diagonal, shape (6, 3, 3) or (3, 2, 2)."""
    rows, columns = np.triu_indices(axes)
    basis = np.zeros((len(rows), axes, axes))
    basis[np.arange(len(rows)), rows, columns] = basis[np.arange(len(rows)), columns, rows] = 1.0
    return basis


def soft_iron_of(parameters: Array, axes: int) -> Array:
    """Return the soft iron of parameters, shape (axes, axes)."""
    return np.asarray(np.tensordot(parameters[axes:], symmetric_basis(axes), axes=1))


def parameters_of(centre: Array, soft_iron: Array) -> Array:
    """Return the parameters of a centre and a soft iron."""
    return np.concatenate([centre, soft_iron[np.triu_indices(len(centre))]])


def positive_soft_iron(parameters: Array, axes: int) -> Array:
    """Return the soft iron with positive eigenvalues: norms are the same for either sign."""
    values, vectors = np.linalg.eigh(soft_iron_of(parameters, axes))
    return np.asarray((vectors * np.abs(values)) @ vectors.T)


def ellipsoid_status(parameters: Array, axes: int) -> FitStatus:
    """Return ELLIPSOID, or NOT_CONVERGED for a flat or distant surface, at which norms have no smallest error.

    The calibrated norms of growing and receding spheres approach 1 for any points.
    """
    shape = positive_soft_iron(parameters, axes) @ positive_soft_iron(parameters, axes)
    flat = not float(np.linalg.det(shape / np.trace(shape))) > SMALLEST_DETERMINANT
    far = not float(np.linalg.norm(parameters[:axes])) < FURTHEST_CENTRE
    return FitStatus.NOT_CONVERGED if flat or far else FitStatus.ELLIPSOID


def sphere_parameters(points: Array) -> Array | None:
    """Return the parameters of the least-squares sphere; None if the points determine none."""
    axes = points.shape[1]
    rows = np.column_stack([2.0 * points, np.ones(len(points))])
    solution = np.linalg.lstsq(rows, (points * points).sum(axis=1), rcond=None)[0]
    centre, square = solution[:axes], float(solution[axes] + solution[:axes] @ solution[:axes])
    return parameters_of(centre, np.eye(axes) / np.sqrt(square)) if square > 0.0 else None


def calibrated_norms(parameters: Array, points: Array) -> tuple[Array, Array]:
    """Return ``|C (p - c)| - 1`` and its derivatives."""
    norms, slopes, _ = _norms(parameters, points)
    return norms - 1.0, slopes


def squared_norms(parameters: Array, points: Array) -> tuple[Array, Array]:
    """Return ``|C (p - c)|^2 - 1`` and its derivatives."""
    norms, slopes, _ = _norms(parameters, points)
    return norms**2 - 1.0, 2.0 * norms[:, None] * slopes


def geometric_distances(parameters: Array, points: Array) -> tuple[Array, Array]:
    """Return the distances from the ellipsoid, positive outside, and their derivatives."""
    feet = nearest_points(parameters, points)
    _, slopes, steepness = _norms(parameters, feet)
    outside = np.where(_norms(parameters, points)[0] > 1.0, 1.0, -1.0)
    return outside * np.linalg.norm(points - feet, axis=1), slopes / steepness[:, None]


def nearest_points(parameters: Array, points: Array) -> Array:
    """Return the points of the ellipsoid that are nearest to points, shape (n, axes)."""
    centre = parameters[: points.shape[1]]
    values, vectors = np.linalg.eigh(soft_iron_of(parameters, len(centre)))
    squares = np.maximum(values**2, _TINY)
    along = (points - centre) @ vectors
    scaled = np.maximum(np.abs(along) * np.sqrt(squares), _TINY)
    shift = ((scaled - 1.0) / squares).max(axis=1)
    for _ in range(_FOOT_STEPS):
        parts = scaled / (1.0 + shift[:, None] * squares)
        excess = (parts * parts).sum(axis=1) - 1.0
        step = excess / (2.0 * parts * parts * squares / (1.0 + shift[:, None] * squares)).sum(axis=1)
        shift = shift + step
        if not (np.abs(step) > 1e-14 * (1.0 + np.abs(shift))).any():
            break
    feet: Array = centre + (along / (1.0 + shift[:, None] * squares)) @ vectors.T
    return feet


def _norms(parameters: Array, points: Array) -> tuple[Array, Array, Array]:
    """Return the calibrated norms, their derivatives by the parameters, and how steep they are over the points."""
    axes = points.shape[1]
    soft_iron, away = soft_iron_of(parameters, axes), points - parameters[:axes]
    calibrated = away @ soft_iron
    norms = np.linalg.norm(calibrated, axis=1)
    units = calibrated / np.maximum(norms, _TINY)[:, None]
    gradients = units @ soft_iron
    by_iron = np.einsum("ni,kij,nj->nk", units, symmetric_basis(axes), away, optimize=True)
    return norms, np.concatenate([-gradients, by_iron], axis=1), np.linalg.norm(gradients, axis=1)
