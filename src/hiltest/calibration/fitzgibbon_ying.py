"""`fitzgibbon-ying`: Fitzgibbon's ellipse-specific fit, and its constraint in three dimensions, in float64.

Notes
-----
Fitzgibbon, Pilu and Fisher (Direct least square fitting of ellipses, 1999) minimise the algebraic error of a conic
under ``4 ac - b^2 = 1``. This is ``det A = 1/4`` for the conic's shape A, and makes the fit affine-invariant: an
affine map multiplies all determinants by one number. Mucciaccia (4.2.1) names the extension to ellipsoids by Ying et
al. (2012), and prints none of its equations. Here the constraint is the same as in two dimensions: ``det A = 1`` with
A positive definite, which allows exactly the ellipsoids, whereas the ``4 J - I^2 = 1`` of `li` allows only some.

In two dimensions this is an eigenproblem; in three it is not, but it is convex. With the linear and constant terms
eliminated, the error is ``a' S a`` over the elements a of A, and on any ray of A the smallest value of::

    a' S a / 2 - log det A

is a rising function of the error at ``det A = 1``. It is strictly convex and self-concordant: Newton's steps, shortened
by ``1 + decrement``, keep A positive definite and end at the minimum from anywhere (Nesterov and Nemirovskii, 1994).
"""

from __future__ import annotations

import numpy as np

from hiltest.calibration.clouds import Clouds, Reference, Solution, solution_from_quadrics
from hiltest.calibration.fit import Array, FitStatus
from hiltest.calibration.norm_residuals import symmetric_basis

# Smallest eigenvalue relative to the largest, in place of an error of zero, which sets the accuracy.
_ROUNDING = 1e-15
_MOST_STEPS = 200
# Newton's decrement at which the next step would be below rounding.
_SETTLED = 1e-8


def _solve(clouds: Clouds) -> Solution:
    axes, scatter = clouds.axes, clouds.scatter
    squares = axes * (axes + 1) // 2
    rest = np.linalg.solve(scatter[..., squares:, squares:], scatter[..., squares:, :squares])
    reduced = scatter[..., :squares, :squares] - scatter[..., :squares, squares:] @ rest
    values, vectors = np.linalg.eigh(reduced)
    deviations = np.sqrt(np.maximum(values, _ROUNDING * values[..., -1:]))
    # In units of the error along each eigenvector, in which an error of zero loses no precision.
    whitening = vectors / deviations[..., None, :]
    basis = np.tensordot(np.swapaxes(whitening, -1, -2), _monomial_shapes(axes), axes=1)
    # Start at the unit matrix.
    unknowns = deviations * vectors[..., :axes, :].sum(axis=-2)
    settled = np.zeros((*unknowns.shape[:-1], 1), dtype=bool)
    for _ in range(_MOST_STEPS):
        # Scale to the smallest value on the ray.
        unknowns = unknowns * np.sqrt(axes) / np.linalg.norm(unknowns, axis=-1, keepdims=True)
        inverse = np.linalg.inv(np.einsum("...k,...kij->...ij", unknowns, basis))
        moved = inverse[..., None, :, :] @ basis
        gradient = unknowns - np.trace(moved, axis1=-2, axis2=-1)
        hessian = np.eye(squares) + np.einsum("...kij,...lji->...kl", moved, moved)
        step = -np.linalg.solve(hessian, gradient[..., None])[..., 0]
        decrement = np.sqrt(np.maximum(0.0, -(gradient * step).sum(axis=-1, keepdims=True)))
        unknowns = np.where(settled, unknowns, unknowns + step / np.where(decrement > 0.25, 1.0 + decrement, 1.0))
        settled = settled | (decrement < _SETTLED)
        if settled.all():
            break
    elements = (whitening @ unknowns[..., None])[..., 0]
    coefficients = np.concatenate([elements, -(rest @ elements[..., None])[..., 0]], axis=-1)
    solution = solution_from_quadrics(coefficients, axes)
    status = np.where(settled[..., 0], solution.status, FitStatus.NOT_CONVERGED).astype(np.int8)
    return Solution(solution.soft_iron, solution.centre, status)


def _monomial_shapes(axes: int) -> Array:
    """Return the shape of each square and product: (xx, yy, zz, xy, xz, yz), halves off the diagonal."""
    matrices = symmetric_basis(axes) * (0.5 + 0.5 * np.eye(axes))
    on_diagonal = np.trace(matrices, axis1=1, axis2=2) > 0.0
    return np.concatenate([matrices[on_diagonal], matrices[~on_diagonal]])


fit_fitzgibbon_ying = Reference(_solve)
