"""Heading errors that noise makes unavoidable: the Cramér-Rao bound, and the chance of a smaller largest error.

A calibration from norms alone has nine parameters: ``reading = S field + o`` with a symmetric S; the direction of each
point is unknown. Only the component of a reading along the ellipsoid's normal informs about them. With the derivatives
J of that component the information is ``sum J J' / sigma^2``, and no unbiased calibrator has a smaller covariance than
its inverse (Kay, Estimation Theory, 1993, chapter 3). A heading has the error of the fit at its field, and that of its
own readings; both are linear in noise of a few per cent.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import ArrayLike
from scipy.special import log_ndtr

from hiltest.calibration.fit import Array, MagnetometerFit

LEAST_CHANCE = 1e-6
"""Share of honest runs below which an error is impossible."""
_DRAWS = 20_000  # determine a median to 0.3 % and a 99th percentile to 1 %
_CHANCE_DRAWS = 1_000  # importance sampling: a chance of 1e-6 to a tenth of it
_SEED = 1
_LEAST_INFORMATION = 1e-14  # of the largest, as float64 has it
_SYMMETRIC = [
    np.array(rows, dtype=float)
    for rows in (
        ((1, 0, 0), (0, 0, 0), (0, 0, 0)),
        ((0, 0, 0), (0, 1, 0), (0, 0, 0)),
        ((0, 0, 0), (0, 0, 0), (0, 0, 1)),
        ((0, 1, 0), (1, 0, 0), (0, 0, 0)),
        ((0, 0, 1), (0, 0, 0), (1, 0, 0)),
        ((0, 0, 0), (0, 0, 1), (0, 1, 0)),
    )
]


@dataclass(frozen=True, slots=False, eq=False)
class HeadingBound:
    """Smallest errors of headings at several poses, given the noise."""

    fit_deg: Array
    """Shape (poses, parameters). Error per unit of each of the fit's independent standard normal errors; no columns if
    the fit is taken as exact."""
    readings_deg: Array
    """Shape (poses,). Standard deviation from the readings at the pose."""

    @property
    def fit_rms_deg(self) -> float:
        """The bound of the rms error from the fit alone."""
        return float(np.sqrt(np.mean(np.sum(self.fit_deg**2, axis=1))))

    @property
    def readings_rms_deg(self) -> float:
        """The bound of the rms error from the readings alone."""
        return float(np.sqrt(np.mean(self.readings_deg**2)))

    @property
    def rms_deg(self) -> float:
        """The bound of the rms error."""
        return math.hypot(self.fit_rms_deg, self.readings_rms_deg)

    @cached_property
    def _largest_deg(self) -> Array:
        """Largest errors of an efficient calibrator, one per draw with a fixed seed."""
        draws = np.random.default_rng(_SEED)
        errors = draws.standard_normal((_DRAWS, self.fit_deg.shape[1]), np.float32) @ self.fit_deg.T
        errors += draws.standard_normal((_DRAWS, len(self.readings_deg)), np.float32) * self.readings_deg
        return np.asarray(np.abs(errors).max(axis=1))

    @property
    def expected_largest_deg(self) -> float:
        """Largest error of an efficient calibrator that half of all runs exceed."""
        return float(np.median(self._largest_deg))

    @property
    def largest_in_99_percent_deg(self) -> float:
        """Largest error that an efficient calibrator exceeds in one run of 100."""
        return float(np.quantile(self._largest_deg, 0.99))

    def chance(self, largest_deg: float) -> float:
        """Return the probability that the largest error of an efficient calibrator is as small.

        Given the fit's error, the poses are independent. The integral over the fit's error is importance sampled with
        the normal distribution whose information is that of the prior and of poses that are uniform within the limit.
        """
        if not np.all(self.readings_deg > 0.0):
            return 1.0
        parameters = self.fit_deg.shape[1]
        weights = self.fit_deg / np.sqrt(self.readings_deg**2 + largest_deg**2 / 3.0)[:, None]
        information = np.linalg.cholesky(np.eye(parameters) + weights.T @ weights)
        standard = np.random.default_rng(_SEED).standard_normal((_CHANCE_DRAWS if parameters else 1, parameters))
        drawn = np.linalg.solve(information.T, standard.T).T
        error = (drawn @ self.fit_deg.T) / self.readings_deg
        limit = largest_deg / self.readings_deg
        within = _log_probability_between(-limit - error, limit - error).sum(axis=1)
        importance = 0.5 * (standard**2 - drawn**2).sum(axis=1) - np.log(np.diag(information)).sum()
        return float(min(1.0, np.mean(np.exp(within + importance))))

    @property
    def least_deg(self) -> float:
        """Largest error below which fewer than `LEAST_CHANCE` of all runs are."""
        low, high = 0.0, self.expected_largest_deg
        for _ in range(30):  # to a billionth of it
            middle = 0.5 * (low + high)
            low, high = (middle, high) if self.chance(middle) < LEAST_CHANCE else (low, middle)
        return high


def _log_probability_between(low: Array, high: Array) -> Array:
    """Return the logarithm of the probability that a standard normal is between two bounds."""
    # Both bounds in the lower tail, where the difference of the logarithms keeps its digits.
    flipped = low > 0.0
    low, high = np.where(flipped, -high, low), np.where(flipped, -low, high)
    at_low, at_high = log_ndtr(low), log_ndtr(high)
    with np.errstate(divide="ignore"):  # a probability of 0
        return np.asarray(at_high + np.log(-np.expm1(at_low - at_high)))


def heading_bound(
    fit: MagnetometerFit,
    points: ArrayLike | None,
    *,
    field: ArrayLike,
    gravity: ArrayLike,
    noise: float,
    readings: ArrayLike,
) -> HeadingBound:
    """Return the bound for headings at known attitudes.

    Parameters
    ----------
    fit
        Calibration near the true one, in the unit of the points.
    points : shape (n, 3)
        Points that calibrators use; None to take the fit as exact.
    field, gravity : shape (m, 3)
        True vectors in the body frame at each pose, in any unit.
    noise
        rms of one axis of one reading, in the unit of the points.
    readings : shape (m,)
        Number of readings at each pose.
    """
    inverse = np.asarray(fit.soft_iron)
    field, gravity = np.asarray(field, dtype=float), np.asarray(gravity, dtype=float)
    unit_field = field / np.linalg.norm(field, axis=1)[:, None]
    by_field = heading_derivatives(unit_field, gravity) @ inverse
    spread = np.linalg.norm(by_field, axis=1) * noise / np.sqrt(np.asarray(readings, dtype=float))
    columns = np.zeros((len(field), 0))
    if points is not None:
        unit = (np.asarray(points, dtype=float) - fit.hard_iron) @ inverse.T
        unit /= np.linalg.norm(unit, axis=1)[:, None]
        normals = unit @ inverse
        normals /= np.linalg.norm(normals, axis=1)[:, None]
        rows = _parameter_derivatives(normals, unit) / noise
        information, axes = np.linalg.eigh(rows.T @ rows)
        # Parameters that the points do not determine have a large error, not an infinite one.
        deviations = axes / np.sqrt(np.maximum(information, _LEAST_INFORMATION * information[-1]))
        columns = -_parameter_derivatives(by_field, unit_field) @ deviations
    return HeadingBound(np.degrees(columns), np.degrees(spread))


def _parameter_derivatives(rows: Array, unit: Array) -> Array:
    """Return ``row . (dS u + do)`` by the six elements of a symmetric S and the three of o, shape (n, 9)."""
    by_matrix = [np.einsum("ni,ij,nj->n", rows, matrix, unit) for matrix in _SYMMETRIC]
    return np.column_stack([*by_matrix, rows])


def heading_derivatives(field: Array, gravity: Array) -> Array:
    """Return the derivatives of each heading by its field, shape (m, 3) [rad]."""
    down = gravity / np.linalg.norm(gravity, axis=1)[:, None]
    east = np.cross(down, field)
    north = np.cross(east, down)
    # heading = atan2(-east_x, north_x), and both are linear in the field.
    east_by_field = np.stack([np.zeros(len(down)), -down[:, 2], down[:, 1]], axis=1)
    north_by_field = np.array([1.0, 0.0, 0.0]) - down[:, :1] * down
    squared = east[:, 0] ** 2 + north[:, 0] ** 2
    return np.asarray((east[:, :1] * north_by_field - north[:, :1] * east_by_field) / squared[:, None])
