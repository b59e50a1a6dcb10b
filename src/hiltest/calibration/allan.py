"""The Allan deviation of a rate sensor's log, and its noise figures.

Definitions as in IEEE Std 952-1997, annex C: the Allan variance is half the mean square of the difference of two
neighbouring mean rates, each over ``tau``. White noise of the rate falls as ``N^2 / tau``, with the angle random walk
N; the bias instability B, noise whose density goes as 1/f, stays at ``(2 ln 2 / pi) B^2``; a random walk of the rate
rises as ``K^2 tau / 3``.

The angle random walk is the root of a *two-sided* density. A data sheet's density is one-sided: N is that over the
root of 2.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.optimize import nnls

from hiltest.calibration.degrees_of_freedom import degrees_of_freedom, interval, noise_exponents
from hiltest.errors import CalibrationError

Reals = NDArray[np.float64]

#: Variance of a bias instability of 1: 2 ln 2 / pi, the square of 0.664.
FLICKER = 2.0 * math.log(2.0) / math.pi
#: Minimum number of samples of a curve.
FEWEST_SAMPLES = 1000
#: Minimum number of averaged samples for the fit: shorter averages show the sensor's output filter, and are only drawn.
FILTERED_SAMPLES = 10
_PER_DECADE = 12
# Longest average relative to the log: a variance of fewer than eight differences is too uncertain.
_LONGEST = 1.0 / 9.0
_FREQUENCIES = 4000


# A term is significant if its variance exceeds this multiple of its uncertainty.
_SIGNIFICANT = 2.0


@dataclass(frozen=True, slots=True)
class Estimate:
    """A deviation, and the 68 % confidence interval of the true one."""

    value: float
    low: float
    high: float

    def scaled(self, factor: float) -> Estimate:
        """Return the estimate in another unit."""
        return Estimate(factor * self.value, factor * self.low, factor * self.high)


@dataclass(frozen=True, slots=True)
class AllanReading:
    """Noise figures from the curve of one axis. Rates are in the unit of the log."""

    angle_random_walk: Estimate | None
    """N [unit/sqrt(Hz)]: in deg/s that is deg/sqrt(s), and 60 times as much in deg/sqrt(h)."""
    bias_instability: Estimate | None
    """B [unit]; None if the log is too short to distinguish it from noise: `bias_instability_at_most` is then an upper
    bound."""
    rate_random_walk: Estimate | None
    """K [unit/sqrt(s)]."""
    lowest: Estimate
    """Smallest deviation of the curve."""
    lowest_at_s: float
    """Averaging time of the smallest deviation."""

    @property
    def bias_instability_at_most(self) -> float:
        """Upper bound of the bias instability, which would cause all of the lowest deviation's upper limit."""
        return self.lowest.high / math.sqrt(FLICKER)

    def terms(self, tau_s: Reals) -> Reals:
        """Return the deviations by N, B and K, shape (k, 3); zero for undetected terms."""
        terms = (self.angle_random_walk, self.bias_instability, self.rate_random_walk)
        values = [0.0 if term is None else term.value for term in terms]
        return np.asarray(np.sqrt(_terms(tau_s)) * values, dtype=np.float64)


@dataclass(frozen=True, slots=True, eq=False)
class AllanCurve:
    """Overlapping Allan deviation."""

    tau_s: Reals
    """Shape (k,). Averaging times."""
    deviation: Reals
    """Shape (k, axes). Deviations in the unit of the log."""
    low: Reals
    high: Reals
    """Shape (k, axes). 68 % confidence interval of the true deviation."""
    freedom: Reals
    """Shape (k, axes). Equivalent degrees of freedom of the variance."""
    readings: tuple[AllanReading, ...]
    """Noise figures of each axis."""


def allan_curve(rates: ArrayLike, *, rate_hz: float) -> AllanCurve:
    """Return the Allan deviation of a log without gaps, and its noise figures.

    Parameters
    ----------
    rates : shape (n, axes)
        Rates at rest, at least 1000 samples.
    rate_hz
        Sampling rate.

    Raises
    ------
    CalibrationError
        When there are too few samples, or a column does not change.

    Notes
    -----
    Overlapping: ``1 / (2 tau^2 (n - 2m + 1)) sum (theta[k+2m] - 2 theta[k+m] + theta[k])^2``, tau = m / rate_hz.
    N, B and K are the non-negative least squares fit of the three terms to the variances, each weighted by its
    uncertainty, from ten samples on. Their own uncertainty follows from that of the variances and the correlation of
    these, which overlap in frequency: `_correlation`.
    """
    values = np.asarray(rates, dtype=np.float64)
    n = len(values)
    if n < FEWEST_SAMPLES:
        raise CalibrationError(f"{n} samples; an Allan deviation needs at least {FEWEST_SAMPLES}: take a longer log")
    stuck = [axis for axis in range(values.shape[1]) if (values[:, axis] == values[0, axis]).all()]
    if stuck:
        raise CalibrationError(
            f"rate {stuck[0] + 1} of {values.shape[1]} has a single value, which is not sensor noise"
        )
    sizes = averages(n)
    # Subtracting the mean keeps the angle small and precise; one row per axis, so that neighbours are contiguous.
    theta = np.zeros((values.shape[1], n + 1))
    np.cumsum((values - values.mean(axis=0)).T, axis=1, out=theta[:, 1:])
    theta /= rate_hz
    variance = np.array([_variance(theta, int(m), rate_hz) for m in sizes])
    if not variance.all():
        raise CalibrationError("the log repeats itself: its averages are too similar for sensor noise")
    kinds = [noise_exponents(angle, sizes.tolist()) for angle in theta]
    freedom = np.array(
        [[degrees_of_freedom(n, m, alpha) for m, alpha in zip(sizes.tolist(), kind, strict=True)] for kind in kinds]
    ).T
    tau_s = sizes / rate_hz
    fitted = sizes >= FILTERED_SAMPLES
    readings = tuple(_read_off(tau_s, *axis, fitted) for axis in zip(variance.T, freedom.T, strict=True))
    deviation = np.sqrt(variance)
    return AllanCurve(tau_s, deviation, *interval(deviation, freedom), freedom, readings)


def averages(n: int) -> NDArray[np.int64]:
    """Return the numbers of samples averaged: twelve a decade, up to a ninth of the log."""
    steps = math.floor(_PER_DECADE * math.log10(n * _LONGEST))
    sizes = np.unique(np.round(10.0 ** (np.arange(steps + 1) / _PER_DECADE)).astype(np.int64))
    return np.asarray(sizes, dtype=np.int64)


def _variance(theta: Reals, m: int, rate_hz: float) -> Reals:
    second = theta[:, 2 * m :] - 2.0 * theta[:, m:-m] + theta[:, : -2 * m]
    return np.asarray(np.einsum("ij,ij->i", second, second) / second.shape[1] / (2.0 * (m / rate_hz) ** 2))


def _terms(tau_s: Reals) -> Reals:
    """Return the variances for N, B and K equal to 1, shape (k, 3)."""
    return np.column_stack([1.0 / tau_s, np.full_like(tau_s, FLICKER), tau_s / 3.0])


def _read_off(tau_s: Reals, variance: Reals, freedom: Reals, fitted: NDArray[np.bool_]) -> AllanReading:
    squares, uncertainty = _fit(tau_s[fitted], variance[fitted], np.sqrt(2.0 / freedom[fitted]))
    walk, instability, rate_walk = (
        _estimate(math.sqrt(square), 2.0 * (square / error) ** 2) if square > _SIGNIFICANT * error else None
        for square, error in zip(squares.tolist(), uncertainty.tolist(), strict=True)
    )
    lowest = int(np.argmin(variance))
    # Below half of the lowest variance it is hidden in the uncertainty of the other terms.
    if instability is not None and FLICKER * instability.value**2 < 0.5 * variance[lowest]:
        instability = None
    return AllanReading(
        walk,
        instability,
        rate_walk,
        _estimate(math.sqrt(variance[lowest]), float(freedom[lowest])),
        float(tau_s[lowest]),
    )


def _fit(tau_s: Reals, variance: Reals, relative: Reals) -> tuple[Reals, Reals]:
    """Return the squares of N, B and K, and their uncertainties."""
    terms, expected = _terms(tau_s), variance
    # Two passes, because weights from the variances themselves favour those that are small by chance.
    for _ in range(2):
        weights = 1.0 / (expected * relative)
        # Columns of equal norm, because otherwise NNLS would never select small ones.
        scale = np.linalg.norm(terms * weights[:, None], axis=0)
        rows = terms * weights[:, None] / scale
        squares = np.asarray(nnls(rows, variance * weights)[0] / scale, dtype=np.float64)
        expected = terms @ squares
    uncertainty = np.zeros(3)
    used = np.flatnonzero(squares)
    # The fit is linear in the variances, so errors propagate linearly.
    errors = np.linalg.pinv(rows[:, used]) / scale[used, None] * (weights * expected * relative)
    uncertainty[used] = np.sqrt(np.einsum("ij,jk,ik->i", errors, _correlation(tau_s, squares), errors))
    return squares, uncertainty


def _correlation(tau_s: Reals, squares: Reals) -> Reals:
    """Return the correlation of the variances at some averaging times, shape (k, k).

    A variance is the integral of the rate's density over ``sin^4(pi f tau) / (pi f tau)^2``; of a long log the
    covariance of two is that of the density squared over the product of theirs.
    """
    # The integrand vanishes four octaves below the longest average, and is a thousandth above the shortest one.
    f = np.geomspace(1.0 / (16.0 * tau_s[-1]), 16.0 / tau_s[0], _FREQUENCIES)
    density = squares @ np.array([np.ones_like(f), 1.0 / (2.0 * np.pi * f), 1.0 / (2.0 * np.pi * f) ** 2])
    x = np.pi * np.outer(tau_s, f)
    columns = np.sin(x) ** 4 / x**2 * density * np.sqrt(f)
    columns /= np.linalg.norm(columns, axis=1)[:, None]
    return np.asarray(columns @ columns.T)


def _estimate(value: float, freedom: float) -> Estimate:
    low, high = interval(value, freedom)
    return Estimate(value, float(low), float(high))
