"""`gradient-descent`: the algebraic error of unit trace by steepest descent, kept to ellipsoids, in float64.

Notes
-----
The thesis evaluates a simple gradient descent that is kept to ellipsoids, with the algebraic distance, but does not say
how (Mucciaccia, 4.2.1). Here each step goes down the gradient of the mean of ``(p' A p + g . p + j)^2``, ``tr A = 1``,
by 1 over its largest curvature, and A's eigenvalues are then moved to the nearest ones that add up to 1 and are at
least 0.01, so that no axis is longer than ten times another. That set is convex and closed, so there is one minimum and
the descent reaches it: that of `direct` if the set contains it, otherwise an ellipsoid on the set's edge. (The
statement that no constrained algorithm is optimal, Mucciaccia 3.3.3, holds for the open set of all ellipsoids.) A's
trace-free elements use an orthonormal basis, so the result is independent of the orientation of the axes.

With smallest and largest curvature l and L a step of length h ends within ``2 h L / l`` of the minimum.
"""

from __future__ import annotations

import numpy as np

from hiltest.calibration.clouds import (
    Clouds,
    Reference,
    Solution,
    constant_part,
    constant_trace,
    solution_from_quadrics,
)
from hiltest.calibration.conditioning import traceless
from hiltest.calibration.fit import Array, FitStatus

#: Least eigenvalue of the shape relative to the trace.
LEAST_EIGENVALUE = 0.01
# Distance from the minimum at the end of the descent, in parameters of size 1.
_NEAR = 1e-5
# Maximum number of steps: points of condition 250, near the largest that is fitted, took 2 200.
_MOST_STEPS = 10_000


def _solve(clouds: Clouds) -> Solution:
    axes, normal = clouds.axes, clouds.normal
    basis = constant_trace(axes)
    sphere = constant_part(axes)
    target = (basis.T @ clouds.scatter @ sphere[:, None])[..., 0]
    curvatures = np.linalg.eigvalsh(normal)
    largest = curvatures[..., -1:]
    near = _NEAR * curvatures[..., :1] / (2.0 * largest)
    parameters, settled = np.zeros(target.shape), np.zeros(near.shape, dtype=bool)
    for _ in range(_MOST_STEPS):
        down = parameters - ((normal @ parameters[..., None])[..., 0] + target) / largest
        after = _nearest_ellipsoid(down, axes)
        # Converged instances are kept, so that each ends as it would alone.
        parameters, settled = (
            np.where(settled, parameters, after),
            settled | (np.linalg.norm(after - parameters, axis=-1, keepdims=True) <= near),
        )
        if settled.all():
            break
    solution = solution_from_quadrics(sphere + parameters @ basis.T, axes)
    status = np.where(settled[..., 0], solution.status, FitStatus.NOT_CONVERGED).astype(np.int8)
    return Solution(solution.soft_iron, solution.centre, status)


def _nearest_ellipsoid(parameters: Array, axes: int) -> Array:
    """Return the nearest parameters whose shape has no eigenvalue below the least one."""
    matrices = traceless(axes)
    terms = len(matrices)
    # No eigenvalue of trace-free terms of norm 1 is below -sqrt((axes - 1) / axes).
    well_inside = (1.0 / axes - LEAST_EIGENVALUE) * np.sqrt(axes / (axes - 1.0))
    if (np.linalg.norm(parameters[..., :terms], axis=-1) <= well_inside).all():
        return parameters
    shape = np.eye(axes) / axes + np.tensordot(parameters[..., :terms], matrices, axes=1)
    values, vectors = np.linalg.eigh(shape)
    if (values[..., 0] >= LEAST_EIGENVALUE).all():
        return parameters
    values = _nearest_shares(values - LEAST_EIGENVALUE, 1.0 - axes * LEAST_EIGENVALUE) + LEAST_EIGENVALUE
    shape = (vectors * values[..., None, :]) @ np.swapaxes(vectors, -1, -2)
    return np.concatenate([np.tensordot(shape, matrices, axes=([-2, -1], [1, 2])), parameters[..., terms:]], axis=-1)


def _nearest_shares(values: Array, total: float) -> Array:
    """Return the nearest numbers that are not negative and add up to a total, of values in rising order."""
    falling = values[..., ::-1]
    excess = (np.cumsum(falling, axis=-1) - total) / np.arange(1, values.shape[-1] + 1)
    count = (falling > excess).sum(axis=-1, keepdims=True)
    return np.maximum(values - np.take_along_axis(excess, count - 1, axis=-1), 0.0)


fit_gradient_descent = Reference(_solve, bias_share=1.0)
