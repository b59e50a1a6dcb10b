"""Surfaces for readings that show no whole ellipsoid: part of a sphere, or a turn in a plane.

Notes
-----
All shapes are one model. With traceless symmetric B_k (see `traceless`), of space or of the plane::

    |(I + sum_k s_k B_k) (p - c)| = R

`sphere` and `circle` have s = 0, `ellipse` a free s, `ridge` the prior s_k ~ N(0, 0.01^2). The residual is the distance
from the surface to first order (Sampson, Fitting conic sections to very scattered data, 1982), not the difference of
corrected lengths: a matrix that shortens the readings also shortens the latter, and noise alone would bend the shape of
a cap as far as the prior allows.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from enum import StrEnum

import numpy as np
from numpy.typing import ArrayLike

from hiltest.calibration.conditioning import CentredPoints, traceless
from hiltest.calibration.direction_error import DirectionError
from hiltest.calibration.fit import Array, FitStatus, MagnetometerFit, no_fit, points_array
from hiltest.calibration.plane import FLAT, RING, Plane
from hiltest.calibration.quality import residual_percent, sphere_directions


class Shape(StrEnum):
    """Shape to fit to readings."""

    SPHERE = "sphere"
    RIDGE = "ridge"
    CIRCLE = "circle"
    ELLIPSE = "ellipse"

    @property
    def axes(self) -> int:
        """Number of axes: 2 for a turn in a plane, otherwise 3."""
        return 2 if self in (Shape.CIRCLE, Shape.ELLIPSE) else 3


@dataclass(frozen=True, slots=True, eq=False)
class ShapeFit:
    """Result of fitting a shape."""

    fit: MagnetometerFit
    """Status ELLIPSOID; TOO_FEW_POINTS, SINGULAR or NOT_CONVERGED without a fit. In a plane the centre is in it,
    and along its normal nothing is corrected."""
    plane: Plane | None = None
    """Plane of a shape in a plane."""
    arc_deg: float | None = None
    """Arc of the circle that the turn in a plane covers: all but the largest gap."""
    error: DirectionError | None = None
    error_strong_iron: DirectionError | None = None
    """Errors of directions over the sphere or the circle, if soft iron that the readings do not show has a standard
    deviation of 3 %, as on boards, or of 10 %."""


# Standard deviation of the shape's terms. With 3 % of soft iron a ridge of 1 % is off by 1.1 deg on 40 % of a sphere
# and by 3.5 on 20 %, the ellipsoid by 1.3 and 16, the sphere by 3.1 and 3.9.
_RIDGE = 0.01
# Standard deviation of a board's soft iron for the stated error, and of iron that stretches the field by a fifth.
_SOFT_IRON, _STRONG_IRON = 0.03, 0.1
# Relative standard deviation of a known strength, because soft iron and gain change the reading.
_KNOWN_FIELD = 0.02
# Maximum number of readings in a fit of a long log.
_MOST_FITTED = 20_000
# Passes of the noise that weighs the ridge's prior: it falls from the sphere's noise to the ridge's own.
_PASSES = 4
# Number of parts of the log in time: lasting noise makes their sums larger than independent noise does.
_BLOCKS = 20
# Largest meaningful error of directions.
_NO_DIRECTION_DEG = 90.0


def fit_shape(points: ArrayLike, shape: Shape, *, field: float | None = None) -> ShapeFit:
    """Fit a shape to readings, and predict the error of directions.

    Parameters
    ----------
    points : shape (n, 3)
        Readings in the order of time.
    field
        Strength of the field if it is known, in the unit of the points; of the part in the plane for a turn in it.
    """
    readings = points_array(points)
    centred = CentredPoints.centre(readings)
    unknowns = shape.axes + 1 + (len(traceless(shape.axes)) if shape in (Shape.RIDGE, Shape.ELLIPSE) else 0)
    if centred is None or len(readings) <= unknowns:
        return ShapeFit(no_fit(FitStatus.TOO_FEW_POINTS))
    plane = Plane.fit(readings) if shape.axes == 2 else None
    projected = centred.points if plane is None else centred.points @ plane.axes[:2].T
    model = _Model(
        projected[:: -(-len(projected) // _MOST_FITTED)], shape, None if field is None else field / centred.scale
    )
    solution = model.solved()
    if isinstance(solution, FitStatus):
        return ShapeFit(no_fit(solution), plane)
    centre, matrix, radius = model.parts(solution)
    soft_iron, arc_deg = matrix / radius, None
    if plane is not None:
        arc_deg = _arc_deg((projected - centre) @ matrix)
        # The normal has the same scale, so that the radius is that of the circle.
        whole = np.eye(3)
        whole[:2, :2] = matrix / math.sqrt(float(np.linalg.det(matrix)))
        soft_iron = plane.axes.T @ whole @ plane.axes * (math.sqrt(float(np.linalg.det(matrix))) / radius)
        centre = centre @ plane.axes[:2]
    fit = MagnetometerFit(
        FitStatus.ELLIPSOID, False, 0, soft_iron / centred.scale, centred.mean + centred.scale * centre
    )
    return ShapeFit(fit, plane, arc_deg, model.error(solution, _SOFT_IRON), model.error(solution, _STRONG_IRON))


def allowed_shape(points: ArrayLike) -> Shape:
    """Return the shape for readings without a whole ellipsoid: in a plane circle or ellipse, otherwise a ridge.

    Parameters
    ----------
    points : shape (n, 3)

    Notes
    -----
    In a plane the result is the shape with the smaller error. With 3 % of soft iron, 2 % of noise and 36 readings,
    ellipse and circle have rms errors of 0.38 and 1.3 deg over a full turn, 0.54 and 1.5 over 270 deg, 2.5 and 2.6 over
    180, 19 and 3.4 over 120.
    """
    readings = points_array(points)
    about = fit_shape(readings, Shape.CIRCLE)
    if about.plane is None or about.error is None:
        return Shape.RIDGE
    if about.plane.thickness > FLAT * about.fit.radius or residual_percent(readings, about.fit) > 100.0 * RING:
        return Shape.RIDGE
    return Shape.ELLIPSE if _rms_deg(fit_shape(readings, Shape.ELLIPSE).error) < about.error.rms_deg else Shape.CIRCLE


def _rms_deg(error: DirectionError | None) -> float:
    return math.inf if error is None else error.rms_deg


def _arc_deg(corrected: Array) -> float:
    """Return a full turn minus the largest gap between directions in a plane."""
    angles = np.sort(np.degrees(np.arctan2(corrected[:, 1], corrected[:, 0])))
    return 360.0 - float(np.diff(angles, append=angles[0] + 360.0).max())


class _Model:
    """The model over centred points in 2 or 3 axes; its parameters are c, R, and the terms s."""

    def __init__(self, points: Array, shape: Shape, field: float | None) -> None:
        self._points, self._axes = points, points.shape[1]
        self._basis = traceless(self._axes)
        self._free = np.arange(self._axes + 1 + len(self._basis)) <= self._axes
        self._expected, self._deviation = np.zeros(len(self._free)), np.full(len(self._free), np.inf)
        if shape in (Shape.RIDGE, Shape.ELLIPSE):
            self._free[:] = True
        if shape is Shape.RIDGE:
            self._deviation[self._axes + 1 :] = _RIDGE
        if field is not None:
            self._expected[self._axes], self._deviation[self._axes] = field, _KNOWN_FIELD * field

    def parts(self, parameters: Array) -> tuple[Array, Array, float]:
        """Return centre, matrix and radius."""
        matrix = np.eye(self._axes) + np.tensordot(parameters[self._axes + 1 :], self._basis, axes=1)
        return parameters[: self._axes], matrix, float(parameters[self._axes])

    def solved(self) -> Array | FitStatus:
        """Return the best parameters, or the status of a failure."""
        from scipy.optimize import least_squares  # takes 0.3 s, which a fit of a whole ellipsoid does not need

        parameters = self._linear()
        if parameters is None:
            return FitStatus.SINGULAR
        for _ in range(_PASSES if np.isfinite(self._deviation).any() else 1):
            noise = math.sqrt(self._variance(self._residuals(parameters)))
            result = least_squares(
                self._weighted_residuals, parameters[self._free], self._slopes, method="lm", args=(noise,)
            )
            if not (result.success and np.isfinite(result.x).all()):
                return FitStatus.NOT_CONVERGED
            parameters = self._whole(result.x)
        _, matrix, radius = self.parts(parameters)
        if not (radius > 0.0 and float(np.linalg.eigvalsh(matrix)[0]) > 0.0):
            return FitStatus.NOT_CONVERGED
        return parameters

    def error(self, parameters: Array, soft_iron: float) -> DirectionError | None:
        """Return the error of directions for an expected standard deviation of the soft iron.

        Notes
        -----
        With the Jacobian J and the variance v of the residuals, N = J' J and the prior precision L, the posterior of
        the true parameters is normal with covariance ``v (N + v L)^-1`` about one step from the given ones. The step is
        the bias, the covariance the spread. v is increased to the variance that the sums ``J_b' r_b`` over blocks in
        time show.
        """
        deviation = self._deviation.copy()
        deviation[self._axes + 1 :] = soft_iron
        precision = np.diag(deviation**-2.0)
        jacobian, residuals = self._jacobian(parameters), self._residuals(parameters)
        normal = jacobian.T @ jacobian
        pull = precision @ (parameters - self._expected)
        variance = self._variance(residuals)
        for _ in range(_PASSES):
            step = -np.linalg.solve(normal + variance * precision, jacobian.T @ residuals + variance * pull)
            scatter, variance = self._residual_covariance(jacobian, residuals + jacobian @ step, variance * precision)
        inverse = np.linalg.inv(normal + variance * precision)
        covariance = inverse @ (scatter + variance**2 * precision) @ inverse
        slopes = self._direction_jacobian(parameters)
        spread = float(np.einsum("nik,kl,nil->", slopes, covariance, slopes)) / len(slopes)
        bias = float(((slopes @ step) ** 2).sum()) / len(slopes)
        if not (math.isfinite(spread) and math.isfinite(bias)):
            return None
        spread_deg, bias_deg = math.degrees(math.sqrt(max(0.0, spread))), math.degrees(math.sqrt(bias))
        return DirectionError(min(spread_deg, _NO_DIRECTION_DEG), min(bias_deg, _NO_DIRECTION_DEG))

    def _linear(self) -> Array | None:
        """Return the circle or sphere by least squares in c and R^2 - |c|^2; None if it is undetermined."""
        rows = np.column_stack([2.0 * self._points, np.ones(len(self._points))])
        solution, _, rank, _ = np.linalg.lstsq(rows, (self._points**2).sum(axis=1), rcond=1e-9)
        centre = solution[:-1]
        square = float(solution[-1] + centre @ centre)
        if rank <= self._axes or not square > 0.0:
            return None
        return np.concatenate([centre, [math.sqrt(square)], np.zeros(len(self._basis))])

    def _whole(self, free: Array) -> Array:
        parameters = np.zeros(len(self._free))
        parameters[self._free] = free
        return parameters

    def _weighted_residuals(self, free: Array, noise: float) -> Array:
        """Return the residuals, and the parameters' deviations in units of the noise."""
        parameters = self._whole(free)
        return np.append(self._residuals(parameters), noise * (parameters - self._expected) / self._deviation)

    def _slopes(self, free: Array, noise: float) -> Array:
        slopes: Array = np.vstack([self._jacobian(self._whole(free)), np.diag(noise / self._deviation)])[:, self._free]
        return slopes

    def _residuals(self, parameters: Array) -> Array:
        corrected, slopes, radius = self._correct(parameters)
        residuals: Array = (np.linalg.norm(corrected, axis=1) - radius) / slopes
        return residuals

    def _correct(self, parameters: Array) -> tuple[Array, Array, float]:
        """Return corrected points, the slope of their length over the distance from the surface, and the radius."""
        centre, matrix, radius = self.parts(parameters)
        corrected = (self._points - centre) @ matrix
        lengths = np.maximum(np.linalg.norm(corrected, axis=1), np.finfo(float).tiny)
        return corrected, np.linalg.norm(corrected @ matrix, axis=1) / lengths, radius

    def _jacobian(self, parameters: Array) -> Array:
        corrected, slopes, radius = self._correct(parameters)
        centre, matrix, _ = self.parts(parameters)
        lengths = np.maximum(np.linalg.norm(corrected, axis=1), np.finfo(float).tiny)
        units = corrected / lengths[:, None]
        # Derivatives of the corrected points by c and s, shape (n, axes, parameters without R).
        moved = np.concatenate(
            [
                np.broadcast_to(-matrix, (len(units), *matrix.shape)),
                np.einsum("kij,nj->nik", self._basis, self._points - centre),
            ],
            axis=2,
        )
        grown = np.einsum("ni,nik->nk", units, moved)
        # slope = |M q| / |q|, so its logarithm's derivative is that of |M q| minus that of |q|.
        across = units @ matrix / slopes[:, None]
        steeper = np.einsum("ni,ij,njk->nk", across, matrix, moved)
        steeper[:, self._axes :] += np.einsum("ni,kij,nj->nk", across, self._basis, corrected)
        steeper = steeper / (slopes * lengths)[:, None] - grown / lengths[:, None]
        by_others = grown / slopes[:, None] - ((lengths - radius) / slopes)[:, None] * steeper
        return np.insert(by_others, self._axes, -1.0 / slopes, axis=1)

    def _variance(self, residuals: Array) -> float:
        return float(residuals @ residuals) / (len(residuals) - int(self._free.sum()))

    def _residual_covariance(self, jacobian: Array, residuals: Array, prior: Array) -> tuple[Array, float]:
        """Return the covariance of ``J' r``, and the variance of independent residuals with the same effect."""
        variance, normal = self._variance(residuals), jacobian.T @ jacobian
        if len(residuals) < 2 * _BLOCKS:
            return variance * normal, variance
        scores = np.array([piece.sum(axis=0) for piece in np.array_split(jacobian * residuals[:, None], _BLOCKS)])
        inverse = np.linalg.inv(normal + prior)
        # Each parameter that the readings determine uses one block's degree of freedom.
        decided = float(np.trace(inverse @ normal))
        scatter = scores.T @ scores * _BLOCKS / (_BLOCKS - decided)
        return scatter, max(variance, float(np.trace(inverse @ scatter)) / decided)

    def _direction_jacobian(self, parameters: Array) -> Array:
        """Return the derivative of corrected directions by the parameters, shape (directions, axes, parameters)."""
        if self._axes == 2:
            angles = np.radians(np.arange(0.0, 360.0, 5.0))
            units = np.column_stack([np.cos(angles), np.sin(angles)])
        else:
            units = sphere_directions()
        _, matrix, radius = self.parts(parameters)
        away = radius * np.linalg.solve(matrix, units.T).T
        moved = np.concatenate(
            [
                np.broadcast_to(-matrix, (len(units), *matrix.shape)),
                np.zeros((len(units), self._axes, 1)),
                np.einsum("kij,nj->nik", self._basis, away),
            ],
            axis=2,
        )
        across = np.eye(self._axes) - units[:, :, None] * units[:, None, :]
        jacobian: Array = across @ moved / radius
        return jacobian
