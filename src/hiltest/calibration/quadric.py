"""Conversion of a quadric to the calibration that maps its ellipsoid to the unit sphere."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from hiltest.calibration.fit import SMALLEST_DETERMINANT, Array


@dataclass(frozen=True, slots=True, eq=False)
class Quadric:
    """The surface ``p' shape p + linear . p + constant = 0``, with a shape of trace 1."""

    shape: Array
    """Shape (3, 3). Symmetric [1]."""
    linear: Array
    """Shape (3,) [counts]."""
    constant: float
    """[counts^2]."""


def quadric_from_coefficients(coefficients: Array, *, unit: float) -> Quadric | None:
    """Return the quadric of ten coefficients in coordinates divided by `unit`.

    Parameters
    ----------
    coefficients : shape (10,)
        Coefficients of x^2, y^2, z^2, xy, xz, yz, x, y, z, 1, in any common scale.
    unit
        Divisor of the coordinates [counts].

    Returns
    -------
    Quadric or None
        Quadric; None if the trace is zero, which is impossible for an ellipsoid.
    """
    a, b, c, d, e, f, g, h, i, j = coefficients
    trace = a + b + c
    if not abs(trace) > 1e-6 * float(np.linalg.norm(coefficients)):
        return None
    shape = np.array([[a, d / 2, e / 2], [d / 2, b, f / 2], [e / 2, f / 2, c]]) / trace
    return Quadric(shape, np.array([g, h, i]) * unit / trace, float(j) * unit**2 / float(trace))


def calibration_from_quadric(quadric: Quadric) -> tuple[Array, Array] | None:
    """Return soft and hard iron of a quadric, or None when it is not an ellipsoid.

    Returns
    -------
    soft_iron : ndarray, shape (3, 3)
        Symmetric positive definite [1/count].
    hard_iron : ndarray, shape (3,)
        Centre in the quadric's coordinates [counts].

    Notes
    -----
    centre ``x0 = -1/2 A^-1 g``, level ``k = x0' A x0 - j``; the surface is
    ``(x - x0)' A (x - x0) = k``, and ``C = A^(1/2) / sqrt(k)`` takes it to the unit
    sphere. Any rotation of C does so as well: heading can be wrong with a perfect fit.
    """
    eigenvalues, vectors = np.linalg.eigh(quadric.shape)
    if not (eigenvalues[0] > 0.0 and float(np.prod(eigenvalues)) > SMALLEST_DETERMINANT):
        return None
    centre: Array = np.linalg.solve(quadric.shape, -0.5 * quadric.linear).astype(np.float64)
    level = float(centre @ quadric.shape @ centre) - quadric.constant
    if not level > 0.0:
        return None
    soft_iron: Array = (vectors * np.sqrt(eigenvalues / level)) @ vectors.T
    return soft_iron, centre
