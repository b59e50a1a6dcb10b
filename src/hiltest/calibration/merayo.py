"""`merayo`: the quadric of unit norm about the sensor's zero, in float64.

Notes
-----
Least squares of ``a x^2 + b y^2 + c z^2 + d xy + e xz + f yz + g x + h y + i z + j = 0`` under ``sum of squares = 1``,
the closed form by which Merayo's scalar calibration (Merayo, Brauer, Primdahl, Petersen and Nielsen, Scalar calibration
of vector magnetometers, 2000) is commonly computed, and which Puc, Podobnik and Munih compare with. That norm depends
on origin, unit and axes: the coordinates are those of the sensor, divided by the rms distance of the points from their
mean so that at least the unit does not matter. About the middle of the points the fit differs, and is better for a
large offset (`iterative` is that fit, except for the weights of the products). Soft iron is the symmetric root instead
of the triangular one, which gives the same norms in rotated axes.
"""

from __future__ import annotations

import numpy as np

from hiltest.calibration.algebraic import smallest_error
from hiltest.calibration.clouds import Clouds, Reference, Solution, mean_products, monomials, solution_from_quadrics


def _solve(clouds: Clouds) -> Solution:
    scatter = mean_products(monomials(clouds.points - clouds.zero[..., None, :]))
    coefficients, _ = smallest_error(scatter, np.eye(scatter.shape[-1]))
    about_zero = solution_from_quadrics(coefficients, clouds.axes)
    return Solution(about_zero.soft_iron, about_zero.centre + clouds.zero, about_zero.status)


fit_merayo = Reference(_solve)
