"""Surfaces for readings that show no whole ellipsoid: part of a sphere, or a turn in a plane.

Notes
-----
All are one model. With traceless symmetric B_k (see `traceless`), of space or of the plane::

    |(I + sum_k s_k B_k) (p - c)| = R

`sphere` and `circle` have s = 0, `ellipse` a free s, `ridge` the prior s_k ~ N(0, 0.01^2). What is squared is the
distance from the surface to first order (Sampson, Fitting conic sections to very scattered data, 1982), not the
difference of corrected lengths: a matrix that shortens the readings shortens that with them, and noise alone would bend
the shape of a cap by as much as the prior lets it.
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
    """What readings are fitted by."""

    SPHERE = "sphere"
    RIDGE = "ridge"
    CIRCLE = "circle"
    ELLIPSE = "ellipse"

    @property
    def axes(self) -> int:
        """2 for a turn in a plane, else 3."""
        return 2 if self in (Shape.CIRCLE, Shape.ELLIPSE) else 3


@dataclass(frozen=True, slots=True, eq=False)
class ShapeFit:
    """Result of a shape."""

    fit: MagnetometerFit
    """Status ELLIPSOID; TOO_FEW_POINTS, SINGULAR or NOT_CONVERGED without a fit. In a plane the centre is in it,
    and along its normal nothing is corrected."""
    plane: Plane | None = None
    """Of a shape in a plane."""
    arc_deg: float | None = None
    """What the turn in a plane shows of the circle: all but the largest gap."""
    error: DirectionError | None = None
    error_strong_iron: DirectionError | None = None
    """Of directions all over the sphere, or over the circle, where soft iron beyond what the readings show has a
    standard deviation of 3 %, as boards have, or of 10 %."""


# Standard deviation of the shape's terms. With 3 % of soft iron a ridge of 1 % is off by 1.1 deg on 40 % of a sphere
# and by 3.5 on 20 %, the ellipsoid by 1.3 and 16, the sphere by 3.1 and 3.9.
_RIDGE = 0.01
# That of a board's soft iron, which the stated error is for, and of iron that stretches the field by a fifth.
_SOFT_IRON, _STRONG_IRON = 0.03, 0.1
# That of a strength which is known, as a part of it: soft iron and gain change what the sensor reads.
_KNOWN_FIELD = 0.02
# Readings that a fit takes of a long log.
_MOST_FITTED = 20_000
# Of the noise that the ridge weighs its prior by: from the sphere's it falls to its own.
_PASSES = 4
# Parts of the log in time: noise that lasts makes their sums larger than independent noise does.
_BLOCKS = 20
# Directions that are off by more tell nothing.
_NO_DIRECTION_DEG = 90.0


def fit_shape(points: ArrayLike, shape: Shape, *, field: float | None = None) -> ShapeFit:
    """Fit a shape to readings, and say how far directions are off.

    Parameters
    ----------
    points : shape (n, 3)
        In the order in which they were read.
    field
        Strength of the field where it is known, in the unit of the points; of the part in the plane for a turn in it.
    """
    given = points_array(points)
    centred = CentredPoints.of(given)
    unknowns = shape.axes + 1 + (len(traceless(shape.axes)) if shape in (Shape.RIDGE, Shape.ELLIPSE) else 0)
    if centred is None or len(given) <= unknowns:
        return ShapeFit(no_fit(FitStatus.TOO_FEW_POINTS))
    plane = Plane.of(given) if shape.axes == 2 else None
    seen = centred.points if plane is None else centred.points @ plane.axes[:2].T
    model = _Model(seen[:: -(-len(seen) // _MOST_FITTED)], shape, None if field is None else field / centred.scale)
    found = model.solved()
    if isinstance(found, FitStatus):
        return ShapeFit(no_fit(found), plane)
    centre, matrix, radius = model.parts(found)
    soft_iron, arc_deg = matrix / radius, None
    if plane is not None:
        arc_deg = _arc_deg((seen - centre) @ matrix)
        # One scale for the normal too, so that the radius is that of the circle.
        whole = np.eye(3)
        whole[:2, :2] = matrix / math.sqrt(float(np.linalg.det(matrix)))
        soft_iron = plane.axes.T @ whole @ plane.axes * (math.sqrt(float(np.linalg.det(matrix))) / radius)
        centre = centre @ plane.axes[:2]
    fit = MagnetometerFit(
        FitStatus.ELLIPSOID, False, 0, soft_iron / centred.scale, centred.mean + centred.scale * centre
    )
    return ShapeFit(fit, plane, arc_deg, model.error(found, _SOFT_IRON), model.error(found, _STRONG_IRON))


def allowed_shape(points: ArrayLike) -> Shape:
    """Return what readings that show no whole ellipsoid allow: in a plane circle or ellipse, else a ridge.

    Parameters
    ----------
    points : shape (n, 3)

    Notes
    -----
    Of the two in a plane that with the smaller error. With 3 % of soft iron, 2 % of noise and 36 readings the ellipse
    has 0.38 deg rms all round, where the circle has 1.3, 0.54 and 1.5 over 270 deg, 2.5 and 2.6 over 180, 19 and 3.4
    over 120.
    """
    given = points_array(points)
    about = fit_shape(given, Shape.CIRCLE)
    if about.plane is None or about.error is None:
        return Shape.RIDGE
    radius = float(np.linalg.det(about.fit.soft_iron)) ** (-1.0 / 3.0)
    if about.plane.thickness > FLAT * radius or residual_percent(given, about.fit) > 100.0 * RING:
        return Shape.RIDGE
    return Shape.ELLIPSE if _rms_deg(fit_shape(given, Shape.ELLIPSE).error) < about.error.rms_deg else Shape.CIRCLE


def _rms_deg(error: DirectionError | None) -> float:
    return math.inf if error is None else error.rms_deg


def _arc_deg(corrected: Array) -> float:
    """Return a full turn less the largest gap between directions in a plane."""
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
        """Return the parameters that fit best, or why there are none."""
        from scipy.optimize import least_squares  # 0.3 s, which a fit of a whole ellipsoid need not wait for

        parameters = self._linear()
        if parameters is None:
            return FitStatus.SINGULAR
        for _ in range(_PASSES if np.isfinite(self._deviation).any() else 1):
            noise = math.sqrt(self._variance(self._residuals(parameters)))
            found = least_squares(self._off, parameters[self._free], self._slopes, method="lm", args=(noise,))
            if not (found.success and np.isfinite(found.x).all()):
                return FitStatus.NOT_CONVERGED
            parameters = self._whole(found.x)
        _, matrix, radius = self.parts(parameters)
        if not (radius > 0.0 and float(np.linalg.eigvalsh(matrix)[0]) > 0.0):
            return FitStatus.NOT_CONVERGED
        return parameters

    def error(self, parameters: Array, soft_iron: float) -> DirectionError | None:
        """Return what directions are off by, where soft iron of such a deviation is expected.

        Notes
        -----
        With the Jacobian J and the variance v of the residuals, N = J' J and the prior precision L, the readings make
        of the true parameters a normal distribution of covariance ``v (N + v L)^-1`` about one step from those given.
        The step is the bias, the covariance the spread. For v stands the larger one that the sums ``J_b' r_b`` over
        blocks in time show.
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
            scatter, variance = self._lasting(jacobian, residuals + jacobian @ step, variance * precision)
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
        """Return the circle or sphere that is linear in c and R^2 - |c|^2, None for points on a line or in a plane."""
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

    def _off(self, free: Array, noise: float) -> Array:
        """Return the residuals, and the parameters' deviations in units of the noise."""
        parameters = self._whole(free)
        return np.append(self._residuals(parameters), noise * (parameters - self._expected) / self._deviation)

    def _slopes(self, free: Array, noise: float) -> Array:
        slopes: Array = np.vstack([self._jacobian(self._whole(free)), np.diag(noise / self._deviation)])[:, self._free]
        return slopes

    def _residuals(self, parameters: Array) -> Array:
        corrected, slopes, radius = self._corrected(parameters)
        residuals: Array = (np.linalg.norm(corrected, axis=1) - radius) / slopes
        return residuals

    def _corrected(self, parameters: Array) -> tuple[Array, Array, float]:
        """Return corrected points, how fast their length grows with the distance from the surface, and the radius."""
        centre, matrix, radius = self.parts(parameters)
        corrected = (self._points - centre) @ matrix
        lengths = np.maximum(np.linalg.norm(corrected, axis=1), np.finfo(float).tiny)
        return corrected, np.linalg.norm(corrected @ matrix, axis=1) / lengths, radius

    def _jacobian(self, parameters: Array) -> Array:
        corrected, slopes, radius = self._corrected(parameters)
        centre, matrix, _ = self.parts(parameters)
        lengths = np.maximum(np.linalg.norm(corrected, axis=1), np.finfo(float).tiny)
        units = corrected / lengths[:, None]
        # Of the corrected points by c and s, shape (n, axes, parameters without R).
        moved = np.concatenate(
            [np.broadcast_to(-matrix, (len(units), *matrix.shape)),
             np.einsum("kij,nj->nik", self._basis, self._points - centre)], axis=2,
        )  # fmt: skip
        grown = np.einsum("ni,nik->nk", units, moved)
        # slope = |M q| / |q|, so its logarithm's derivative is that of |M q| less that of |q|.
        across = units @ matrix / slopes[:, None]
        steeper = np.einsum("ni,ij,njk->nk", across, matrix, moved)
        steeper[:, self._axes :] += np.einsum("ni,kij,nj->nk", across, self._basis, corrected)
        steeper = steeper / (slopes * lengths)[:, None] - grown / lengths[:, None]
        by_others = grown / slopes[:, None] - ((lengths - radius) / slopes)[:, None] * steeper
        return np.insert(by_others, self._axes, -1.0 / slopes, axis=1)

    def _variance(self, residuals: Array) -> float:
        return float(residuals @ residuals) / (len(residuals) - int(self._free.sum()))

    def _lasting(self, jacobian: Array, residuals: Array, prior: Array) -> tuple[Array, float]:
        """Return the covariance of ``J' r``, and the variance of independent residuals that move as far."""
        variance, normal = self._variance(residuals), jacobian.T @ jacobian
        if len(residuals) < 2 * _BLOCKS:
            return variance * normal, variance
        scores = np.array([piece.sum(axis=0) for piece in np.array_split(jacobian * residuals[:, None], _BLOCKS)])
        inverse = np.linalg.inv(normal + prior)
        # Each parameter that the readings decide takes one block's freedom.
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
            [np.broadcast_to(-matrix, (len(units), *matrix.shape)), np.zeros((len(units), self._axes, 1)),
             np.einsum("kij,nj->nik", self._basis, away)], axis=2,
        )  # fmt: skip
        across = np.eye(self._axes) - units[:, :, None] * units[:, None, :]
        jacobian: Array = across @ moved / radius
        return jacobian
