"""Base of all algebraic fits: the least squares of a quadric under a quadratic constraint.

Notes
-----
With m(p) the ten monomials of a point and theta a quadric's coefficients, an algebraic fit minimises::

    theta' S theta,   S = mean m m',   under   theta' N theta = 1

and each is one matrix N: of ones for the squares the trace, the identity for the unit norm, 4 J - I^2 for Li and
Griffiths, the mean of grad m grad m' for Taubin, and the bias-removing matrix of Kanatani's hyper least squares. The
solution is the eigenvector of ``N theta = mu S theta`` with the largest mu, 1 over the smallest error. S is symmetric
and not negative, so ``S = V W V'`` turns this into the symmetric ``W^-1/2 V' N V W^-1/2``, whatever the signs in N and
however small the noise: eigenvalues of S below rounding are taken for rounding, which moves theta by as much.
"""

from __future__ import annotations

from collections.abc import Callable
from functools import lru_cache
from typing import TypeAlias

import numpy as np
from numpy.typing import NDArray

from hiltest.calibration.clouds import Clouds, Reference, Solution, solution_from_quadrics
from hiltest.calibration.fit import BIAS_LEFT, Array, FitStatus

#: Function that returns N for clouds, shape (10, 10) or (..., 10, 10); in a plane with 6 instead of 10.
Constraint: TypeAlias = Callable[[Clouds], Array]

# Smallest eigenvalue of S relative to the largest, at the precision of float64.
_ROUNDING = 1e-16


def algebraic(constraint: Constraint, *, bias_share: float = BIAS_LEFT) -> Reference:
    """Return the calibrator that minimises the algebraic error under a constraint."""

    def solve(clouds: Clouds) -> Solution:
        coefficients, solvable = smallest_error(clouds.scatter, constraint(clouds))
        solution = solution_from_quadrics(coefficients, clouds.axes)
        status = np.where(solvable, solution.status, FitStatus.NOT_AN_ELLIPSOID).astype(np.int8)
        return Solution(solution.soft_iron, solution.centre, status)

    return Reference(solve, bias_share)


def smallest_error(scatter: Array, constraint: Array) -> tuple[Array, NDArray[np.bool_]]:
    """Return the coefficients with the smallest error, shape (..., 10), and whether any meet the constraint."""
    values, vectors = np.linalg.eigh(scatter)
    whitening = vectors / np.sqrt(np.maximum(values, _ROUNDING * values[..., -1:]))[..., None, :]
    inverse_errors, solutions = np.linalg.eigh(np.swapaxes(whitening, -1, -2) @ constraint @ whitening)
    coefficients: Array = (whitening @ solutions[..., -1:])[..., 0]
    return coefficients, np.asarray(inverse_errors[..., -1] > 0.0)


@lru_cache
def derivatives(axes: int) -> Array:
    """Return the matrices from monomials to derivatives along each axis, shape (axes, 10, 10), in a plane 6."""
    squares = axes * (axes + 1) // 2
    matrices = np.zeros((axes, squares + axes + 1, squares + axes + 1))
    axis = np.arange(axes)
    matrices[axis, axis, squares + axis] = 2.0
    matrices[axis, squares + axis, -1] = 1.0
    for product, (first, second) in enumerate(zip(*np.triu_indices(axes, 1), strict=True), start=axes):
        matrices[first, product, squares + second] = matrices[second, product, squares + first] = 1.0
    return matrices


def slope_products(scatter: Array, axes: int) -> Array:
    """Return the mean of ``grad m grad m'``, summed over the axes, from the mean of ``m m'``."""
    along = derivatives(axes)
    return np.asarray((along @ scatter[..., None, :, :] @ np.swapaxes(along, -1, -2)).sum(axis=-3))
