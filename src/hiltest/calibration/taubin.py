"""`taubin`: algebraic least squares with Taubin's normalisation, in float64.

Notes
-----
The fit minimises ``sum D(p)^2 / sum |grad D(p)|^2``: the squared distance from the surface to first order, but with one
slope for all points (Taubin, Estimation of planar curves, surfaces and nonplanar space curves defined by implicit
equations, 1991, eq. 25). N is the mean of ``grad m grad m'``.
"""

from __future__ import annotations

from hiltest.calibration.algebraic import algebraic, slope_products

fit_taubin = algebraic(lambda clouds: slope_products(clouds.scatter, clouds.axes))
