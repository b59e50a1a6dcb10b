"""`joint`: the magnetometer calibrated by norms and against gravity at once, in Gauss-Newton steps, in float64.

Notes
-----
The field ``f = K (m - k)`` of a calibrated reading has norm 1, and its direction u the same dot product with gravity g
in every attitude: the sine of the dip. That is two residuals per pair, ``|f| - 1`` and ``g . u - c``, with 13 unknowns:
nine of K, which also rotates the field to the accelerometer's axes, three of k, and c. `dpi` fits ``g . f``, one linear
residual, in which the noise of the norm is most of the noise: its heading error is nearly twice as large.

A step changes f by ``Q v``, ``v = (u, 1)``, with Q of shape (3, 4). To first order ``|f|`` changes by ``u . Q v`` and
``g . u`` by ``p . Q v``, where ``p = g - (g . u) u``. Isotropic noise s of f has the standard deviation s in ``|f|``
and ``|p| s`` in ``g . u``. The residuals weighted with it have the normal equations::

    sum (|p|^2 u u' + p p') x v v'  -  b b' / n,    b = sum p x v
    -sum h x v  +  mean(g . u) b,                   h = |p|^2 (|f| - 1) u + (g . u) p

of which the terms with b eliminate c (x is the Kronecker product). With ``t = u x g``, perpendicular to both u and p
and as long as p, ``|p|^2 u u' + p p' = |p|^2 I - t t'``. The firmware sums the right-hand side, one vector's products
instead of two, and only those that do not follow from ``t . u = 0`` and ``|u| = 1``.

The start is the fit of `direct`. Its norms have no gradient there except for the bias of noise, so the first step
mostly brings in gravity. The symmetric part of Q stretches the field, the other part w is a rotation vector, applied
as Cayley's rotation ``(I - [w/2])^-1 (I + [w/2])``. What a rotation of w leaves to the next step is its square, so a
step by less than 2 degrees is the last.

The covariance of the estimate is the inverse of the normal matrix times s^2, which is the Cramér-Rao bound of these
unknowns: without a prior for the direction of a pair no unbiased calibrator has a smaller one.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from hiltest.calibration.direct import fit_direct
from hiltest.calibration.dpi import COVERAGE_LIMIT, DpiFit
from hiltest.calibration.fit import Array, FitStatus, MagnetometerFit, no_fit, points_array

UNKNOWNS = 13

#: Minimum number of pairs. With 100 the median largest heading error of the default rig is that of `dpi` with 300.
PAIRS_MINIMUM = 100

#: Rotation of a step below which it is the last, and the largest number of steps: axes 60 degrees off need three.
LARGEST_TURN_DEG, STEPS = 2.0, 4

# A field within 3 degrees of the vertical has a horizontal part of 5 %: no heading.
_SMALLEST_COSINE = 0.05
# Standard error of a dot product relative to the cosine of the dip, which is the noise relative to the field. Reversed
# or exchanged axes make 0.3 or more, noise of a tenth of the field 0.1.
_LARGEST_ERROR = 0.2
_LAST_PIVOT_LIMIT = 1e6


@dataclass(frozen=True, slots=True, eq=False)
class _Step:
    change: Array
    """Shape (3, 4)."""
    coverage: float
    cosine_squared: float
    """Mean of ``|p|^2``, the squared cosine of the dip."""
    sine: float
    standard_error: float

    @property
    def half_turn(self) -> Array:
        """Half of the rotation vector, shape (3,) [rad]."""
        q = self.change
        vector: Array = 0.25 * np.array([q[2, 1] - q[1, 2], q[0, 2] - q[2, 0], q[1, 0] - q[0, 1]])
        return vector

    @property
    def turn_deg(self) -> float:
        """Size of the rotation [deg]."""
        return math.degrees(2.0 * float(np.linalg.norm(self.half_turn)))

    def applied_to(self, gain: Array, constant: Array) -> tuple[Array, Array]:
        """Return the changed gain and constant of ``f = gain m + constant``."""
        x, y, z = self.half_turn
        cross = np.array([[0.0, -z, y], [z, 0.0, -x], [-y, x, 0.0]])
        stretch = np.eye(3) + 0.5 * (self.change[:, :3] + self.change[:, :3].T)
        factor = stretch @ np.linalg.solve(np.eye(3) - cross, np.eye(3) + cross)
        return factor @ gain, factor @ constant + self.change[:, 3]


def fit_joint_pairs(magnetometer_counts: ArrayLike, gravity_g: ArrayLike, *, dip_deg: float | None = None) -> DpiFit:
    """Calibrate a magnetometer by the norm of the field and its dot product with gravity.

    Parameters
    ----------
    magnetometer_counts : shape (n, 3)
        Readings [counts], body frame, at least 100.
    gravity_g : shape (n, 3)
        Gravity of a calibrated accelerometer at the same instants [g], body frame, positive down.
    dip_deg
        Inclination of the field [deg], positive down; only its sign is used.

    Returns
    -------
    DpiFit
        Fit whose `iterations` are the steps. Status TOO_FEW_POINTS below 100 pairs; that of `direct` if it refuses the
        points; SINGULAR if the attitudes do not determine all unknowns; POOR_COVERAGE if the field is vertical within 3
        degrees; MIRRORED if no rotation makes the dot product the same in all attitudes, or if its sign is not that of
        the dip: the sign of gravity, or an axis, is wrong, or two axes are exchanged; NOT_CONVERGED, with a fit, if
        the last step still turned it by more than 2 degrees. The standard error is that of a dot product of unit
        vectors.

    Raises
    ------
    ValueError
        When the numbers of readings differ, or one is not finite.
    """
    points, gravity = points_array(magnetometer_counts), points_array(gravity_g)
    if len(points) != len(gravity):
        raise ValueError(f"{len(points)} points and {len(gravity)} of gravity; they are pairs")
    if len(points) < PAIRS_MINIMUM:
        return DpiFit(no_fit(FitStatus.TOO_FEW_POINTS), len(points))
    start = fit_direct(points)
    if not start.has_fit:
        return DpiFit(start, len(points))
    return _refine(points, gravity, start, dip_deg)


def _refine(points: Array, gravity: Array, start: MagnetometerFit, dip_deg: float | None) -> DpiFit:
    n, gain, constant = len(points), start.soft_iron, -start.soft_iron @ start.hard_iron
    down = gravity / np.linalg.norm(gravity, axis=1)[:, None]
    steps: list[_Step] = []
    while len(steps) < STEPS and (not steps or steps[-1].turn_deg >= LARGEST_TURN_DEG):
        step = _step(points @ gain.T + constant, down)
        if step is None or not step.coverage <= COVERAGE_LIMIT:
            # Attitudes that determined the step before do so again, unless it went astray.
            return DpiFit(no_fit(FitStatus.MIRRORED if steps else FitStatus.SINGULAR), n)
        gain, constant = step.applied_to(gain, constant)
        steps.append(step)
    last = steps[-1]
    status, dip = _status(last, dip_deg), math.degrees(math.asin(max(-1.0, min(1.0, last.sine))))
    determinant = float(np.linalg.det(gain))
    if status not in (FitStatus.ELLIPSOID, FitStatus.NOT_CONVERGED) or not determinant > 0.0:
        status = FitStatus.SINGULAR if status is FitStatus.ELLIPSOID else status
        return DpiFit(no_fit(status, coverage=last.coverage), n, dip, math.nan, last.standard_error)
    hard_iron: Array = -np.asarray(np.linalg.solve(gain, constant), dtype=np.float64)
    fit = MagnetometerFit(status, False, len(steps), gain, hard_iron, last.coverage)
    return DpiFit(fit, n, dip, determinant ** (-1.0 / 3.0), last.standard_error)


def _step(field: Array, down: Array) -> _Step | None:
    """Return the Gauss-Newton step from calibrated readings and unit gravity, shape (n, 3) each; None without one."""
    n, norms = len(field), np.linalg.norm(field, axis=1)
    u = field / norms[:, None]
    sines = (u * down).sum(axis=1)
    p = down - sines[:, None] * u
    weights = (p * p).sum(axis=1)
    v = np.column_stack([u, np.ones(n)])
    by_norm, by_dot = (np.einsum("ni,nk->nik", vector, v).reshape(n, 12) for vector in (u, p))
    off = weights * (norms - 1.0), sines - sines.mean()
    border = by_dot.sum(axis=0)
    normal = (by_norm * weights[:, None]).T @ by_norm + by_dot.T @ by_dot - np.outer(border, border) / n
    target = -(by_norm.T @ off[0] + by_dot.T @ off[1])
    try:
        # As in the firmware, the constant of each component is the first of its four.
        order = [4 * i + k for i in range(3) for k in (3, 0, 1, 2)]
        pivots = np.diag(np.linalg.cholesky(normal[np.ix_(order, order)])) ** 2 / weights.sum()
    except np.linalg.LinAlgError:
        return None
    ratios = np.tile([1.0 / 3.0, 1.0 / 9.0, 1.0 / 9.0, 1.0 / 9.0], 3) / pivots
    if not ratios[-1] < _LAST_PIVOT_LIMIT:
        return None
    change = np.linalg.solve(normal, target)
    squares = float(off[0] @ (norms - 1.0) + off[1] @ off[1] - target @ change)
    return _Step(
        change.reshape(3, 4),
        float(ratios[:-1].max()),
        float(weights.mean()),
        float(sines.mean() + border @ change / n),
        math.sqrt(max(0.0, squares) / (2 * n - UNKNOWNS)),
    )


def _status(step: _Step, dip_deg: float | None) -> FitStatus:
    if not step.cosine_squared >= _SMALLEST_COSINE**2:
        return FitStatus.POOR_COVERAGE
    if not step.standard_error**2 <= _LARGEST_ERROR**2 * step.cosine_squared:
        return FitStatus.MIRRORED
    if dip_deg is not None and step.sine * math.sin(math.radians(dip_deg)) < 0.0:
        return FitStatus.MIRRORED
    return FitStatus.ELLIPSOID if step.turn_deg < LARGEST_TURN_DEG else FitStatus.NOT_CONVERGED
