"""`li`: the ellipsoid-specific fit of Li and Griffiths, in float64.

Notes
-----
Two invariants of ``a x^2 + b y^2 + c z^2 + 2 f yz + 2 g xz + 2 h xy + ... = 0`` are ``I = a + b + c`` and ``J = ab + bc
+ ca - f^2 - g^2 - h^2``. ``4 J - I^2 > 0`` makes it an ellipsoid, so least squares under ``4 J - I^2 = 1`` gives one
for any points (Li and Griffiths, Least squares ellipsoid specific fitting, 2004, theorem 1 and eq. 9 to 15). It
excludes ellipsoids whose shortest axis is below about half of the longest: with eigenvalues ``l`` of the shape ``4 J -
I^2 = 2 sum l_i l_j - sum l_i^2``, which is 0 for (1, 1, 4). The fit to such points is a wrong ellipsoid, even without
noise.

Puc, Podobnik and Munih calibrate with it. This module corrects their errata: the gradient of eq. 19 and 21 lacks a
factor of 2, eq. 22 gives h for the offset ``b = -M^-1 n``, and eq. 23 has ``b' M^-1 b - d`` for the level ``b' M b -
d``; and only v1 is an eigenvector, ``v2 = -S22^-1 S12' v1``. Subtracting the mean cannot improve the fit, because
eliminating v2 makes it independent of the origin.

In a plane ``4 J - I^2`` is never positive; the constraint there is Fitzgibbon's, ``4 J = 1`` (Fitzgibbon, Pilu and
Fisher, Direct least square fitting of ellipses, 1999).
"""

from __future__ import annotations

import numpy as np

from hiltest.calibration.algebraic import algebraic
from hiltest.calibration.clouds import Clouds
from hiltest.calibration.fit import Array


def _constraint(clouds: Clouds) -> Array:
    axes = clouds.axes
    squares = axes * (axes + 1) // 2
    constraint = np.zeros((squares + axes + 1, squares + axes + 1))
    # 4 J, for coefficients of the products 2 f, 2 g, 2 h.
    constraint[:axes, :axes] = 2.0 * (1.0 - np.eye(axes))
    constraint[axes:squares, axes:squares] = -np.eye(squares - axes)
    if axes == 3:
        constraint[:axes, :axes] -= 1.0
    return constraint


fit_li = algebraic(_constraint, bias_share=1.0)
