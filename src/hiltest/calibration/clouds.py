"""Points of many instances in normalised coordinates, and the conversion of a solver's result to a calibration.

Coordinates are relative to the mean and divided by the rms distance from it: unlike the middle and the half of the
range they rotate with the points, so that a fit is as equivariant as its objective.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property, lru_cache
from typing import TypeAlias

import numpy as np
from numpy.typing import ArrayLike, NDArray

from hiltest.calibration.batch import BatchFit
from hiltest.calibration.conditioning import CONDITION_SINGULAR, LARGEST_CONDITION, traceless
from hiltest.calibration.direct import fit_about
from hiltest.calibration.fit import (
    BIAS_LEFT,
    ELLIPSOID_UNKNOWNS,
    LARGEST_DIRECTION_ERROR_DEG,
    SMALLEST_DETERMINANT,
    Array,
    FitStatus,
    MagnetometerFit,
    clouds_array,
    mid_range,
    no_fit,
    points_array,
)

#: Largest distance of a centre in rms distances of the points from their mean. The centre of a sphere of which points
#: cover a third is 0.9 off their mean; one that is further off than this has run away.
FURTHEST_CENTRE = 3.0


@dataclass(frozen=True, eq=False)
class Clouds:
    """Points of instances along leading axes, centred and scaled; of a plane with 2 axes, of space with 3."""

    points: Array
    """Shape (..., n, axes) [1]."""
    mean: Array
    """Shape (..., axes) [counts]."""
    scale: Array
    """Shape (...). rms distance from the mean [counts]; 1 if it is 0."""

    @classmethod
    def centre(cls, points_counts: ArrayLike) -> Clouds:
        """Centre and scale points, shape (..., n, 2 or 3).

        Raises
        ------
        ValueError
            When the shape is another, or a coordinate is not finite.
        """
        stack = clouds_array(points_counts, axes=(2, 3))
        if not stack.shape[-2]:
            raise ValueError(f"points have shape {stack.shape}, of no points")
        mean = stack.mean(axis=-2)
        centred = stack - mean[..., None, :]
        scale = np.sqrt((centred * centred).sum(axis=-1).mean(axis=-1))
        # Equal points differ from their mean by its rounding.
        scale = np.where(scale > 1e-14 * np.abs(stack).max(axis=(-2, -1)), scale, 0.0)
        unit = np.where(scale > 0.0, scale, 1.0)
        return cls(centred / unit[..., None, None] * (scale > 0.0)[..., None, None], mean, unit)

    @property
    def axes(self) -> int:
        """2 in a plane, 3 in space."""
        return int(self.points.shape[-1])

    @property
    def zero(self) -> Array:
        """The sensor's zero, shape (..., axes)."""
        return np.asarray(-self.mean / self.scale[..., None])

    @cached_property
    def rows(self) -> Array:
        """`monomials` of the points, shape (..., n, 10), in a plane 6."""
        return monomials(self.points)

    @cached_property
    def scatter(self) -> Array:
        """Mean over the points of the products of two monomials, shape (..., 10, 10), in a plane (..., 6, 6)."""
        return mean_products(self.rows)

    @cached_property
    def normal(self) -> Array:
        """Normal matrix of the quadric of constant trace, shape (..., 9, 9), in a plane (..., 5, 5).

        Its condition number is `hiltest.calibration.conditioning.ellipsoid_condition`.
        """
        basis = constant_trace(self.axes)
        return np.asarray(basis.T @ self.scatter @ basis)

    @cached_property
    def status(self) -> NDArray[np.int8]:
        """ELLIPSOID if the points determine one, otherwise TOO_FEW_POINTS or POOR_COVERAGE, shape (...)."""
        if self.points.shape[-2] < self.rows.shape[-1] - 1:
            return np.full(self.scale.shape, FitStatus.TOO_FEW_POINTS, dtype=np.int8)
        values = np.linalg.eigvalsh(self.normal)
        condition = values[..., -1] / np.maximum(values[..., 0], values[..., -1] / CONDITION_SINGULAR)
        poor = ~(condition <= LARGEST_CONDITION)
        return np.where(poor, FitStatus.POOR_COVERAGE, FitStatus.ELLIPSOID).astype(np.int8)


@dataclass(frozen=True, slots=True, eq=False)
class Solution:
    """Symmetric calibrations in the coordinates of clouds, undefined if the status is not ELLIPSOID."""

    soft_iron: Array
    centre: Array
    status: NDArray[np.int8]


Solver: TypeAlias = Callable[[Clouds], Solution]


@dataclass(frozen=True, slots=True)
class Reference:
    """A calibrator with a given solver: for one instance when it is called, for many with `batch`."""

    solve: Solver
    bias_share: float = BIAS_LEFT
    """See `hiltest.calibration.direct.direction_variance`."""

    def __call__(
        self, points_counts: ArrayLike, *, largest_error_deg: float = LARGEST_DIRECTION_ERROR_DEG
    ) -> MagnetometerFit:
        """Calibrate from one instance.

        Parameters
        ----------
        points_counts : shape (n, 3)
            Raw points [counts], body frame.
        largest_error_deg
            See `hiltest.calibration.direct.fit_direct`.

        Returns
        -------
        MagnetometerFit
            Status ELLIPSOID; or without a fit TOO_FEW_POINTS, SINGULAR, NOT_AN_ELLIPSOID, or
            POOR_COVERAGE if the error of directions that is predicted for least squares with `bias_share` exceeds
            `largest_error_deg`.
        """
        points = points_array(points_counts)
        if len(points) < ELLIPSOID_UNKNOWNS:
            return no_fit(FitStatus.TOO_FEW_POINTS)
        least_squares = fit_about(
            points, mid_range(points), bias_share=self.bias_share, largest_error_deg=largest_error_deg
        )
        if not least_squares.has_fit:
            return no_fit(least_squares.status, coverage=least_squares.coverage)
        result = self.batch(points)
        status = FitStatus(int(result.status))
        if status is not FitStatus.ELLIPSOID:
            return no_fit(FitStatus.NOT_AN_ELLIPSOID if status is FitStatus.NOT_CONVERGED else status)
        return MagnetometerFit(status, False, 0, result.soft_iron, result.hard_iron, least_squares.coverage)

    def batch(self, points_counts: ArrayLike) -> BatchFit:
        """Calibrate from instances along leading axes, points of shape (..., n, 3), or (..., n, 2) in a plane.

        In a plane soft iron has shape (..., 2, 2), hard iron (..., 2). Nothing is refused by its predicted error, so
        that studies can compare estimators.
        """
        clouds = Clouds.centre(points_counts)
        status = clouds.status
        soft_iron = np.full((*status.shape, clouds.axes, clouds.axes), np.nan)
        hard_iron = np.full((*status.shape, clouds.axes), np.nan)
        determined = status == FitStatus.ELLIPSOID
        if determined.any():
            part = Clouds(clouds.points[determined], clouds.mean[determined], clouds.scale[determined])
            result = self.solve(part)
            fitted = result.status == FitStatus.ELLIPSOID
            soft = np.where(fitted[:, None, None], result.soft_iron / part.scale[:, None, None], np.nan)
            hard = np.where(fitted[:, None], part.mean + part.scale[:, None] * result.centre, np.nan)
            soft_iron[determined], hard_iron[determined] = soft, hard
            status = status.copy()
            status[determined] = result.status
        return BatchFit(status, soft_iron, hard_iron)


def monomials(points: Array) -> Array:
    """Return the squares, products of two axes, axes and 1 of points: ``(x^2, y^2, z^2, xy, xz, yz, x, y, z, 1)``."""
    first, second = np.triu_indices(points.shape[-1], 1)
    ones = np.ones((*points.shape[:-1], 1))
    return np.concatenate([points**2, points[..., first] * points[..., second], points, ones], axis=-1)


def mean_products(rows: Array, weights: Array | None = None) -> Array:
    """Return the mean of ``w m m'`` over rows m, shape (..., n, k), with weights w, shape (..., n)."""
    weighted = rows if weights is None else rows * weights[..., None]
    means: Array = np.swapaxes(weighted, -1, -2) @ rows / rows.shape[-2]
    return means


@lru_cache
def constant_trace(axes: int) -> Array:
    """Return coefficients of monomials, a column for each of the `traceless` matrices, the axes and 1."""
    squares = axes * (axes + 1) // 2
    basis = np.zeros((squares + axes + 1, squares + axes))
    first, second = np.triu_indices(axes, 1)
    for column, matrix in enumerate(traceless(axes)):
        basis[:axes, column] = np.diag(matrix)
        basis[axes:squares, column] = 2.0 * matrix[first, second]
    basis[squares:, squares - 1 :] = np.eye(axes + 1)
    return basis


def constant_part(axes: int) -> Array:
    """Return the coefficients of ``|p|^2 / axes``, the quadric of unit trace that `constant_trace` leaves out."""
    coefficients = np.zeros(len(constant_trace(axes)))
    coefficients[:axes] = 1.0 / axes
    return coefficients


def solution_from_quadrics(coefficients: Array, axes: int) -> Solution:
    """Return the calibrations that take quadrics of such coefficients, shape (..., 10 or 6), to the unit sphere.

    Notes
    -----
    See `hiltest.calibration.quadric.calibration_from_quadric`, here for any number of axes and instances.
    """
    squares = axes * (axes + 1) // 2
    trace = coefficients[..., :axes].sum(axis=-1)
    flat = ~(np.abs(trace) > 1e-6 * np.linalg.norm(coefficients, axis=-1))
    unit_trace = coefficients / np.where(flat, 1.0, trace)[..., None]
    shape = np.zeros((*trace.shape, axes, axes))
    first, second = np.triu_indices(axes, 1)
    shape[..., first, second] = shape[..., second, first] = unit_trace[..., axes:squares] / 2.0
    shape[..., np.arange(axes), np.arange(axes)] = unit_trace[..., :axes]
    values, vectors = np.linalg.eigh(shape)
    closed = ~flat & (values[..., 0] > 0.0) & (np.prod(values, axis=-1) > SMALLEST_DETERMINANT)
    values = np.where(closed[..., None], values, 1.0)
    # The centre is -1/2 A^-1 g.
    along = (np.swapaxes(vectors, -1, -2) @ unit_trace[..., squares:-1, None])[..., 0]
    centre = -0.5 * (vectors @ (along / values)[..., None])[..., 0]
    level = 0.25 * (along * along / values).sum(axis=-1) - unit_trace[..., -1]
    closed &= level > 0.0
    roots = np.sqrt(values / np.where(closed, level, 1.0)[..., None])
    soft_iron: Array = (vectors * roots[..., None, :]) @ np.swapaxes(vectors, -1, -2)
    status = np.where(closed, FitStatus.ELLIPSOID, FitStatus.NOT_AN_ELLIPSOID).astype(np.int8)
    return Solution(soft_iron, centre, status)
