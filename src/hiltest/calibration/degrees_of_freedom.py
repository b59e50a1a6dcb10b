"""Uncertainty of an overlapping Allan variance: kind of noise, equivalent degrees of freedom, interval.

An Allan variance times its degrees of freedom over the true one is taken as chi-squared. Overlapping terms are
correlated, so these are fewer than the terms, and depend on the noise: Greenhall and Riley, Uncertainty of stability
variances based on finite differences, PTTI 2003, for second differences, stride one sample. The noise is identified by
the lag-1 autocorrelation of the angles at the averaging time: Riley and Greenhall, Power law noise identification using
the lag 1 autocorrelation, EFTF 2004. Its exponent alpha is that of the rate's density, f^alpha.
"""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.special import gammaincinv, xlogy

Reals = NDArray[np.float64]

#: Confidence level of an interval: that of one sigma of a normal deviate.
CONFIDENCE = math.erf(math.sqrt(0.5))
#: Exponent of a rate's white noise, whose integral is the angle random walk.
WHITE = 0
#: Range of exponents, from a white angle, as by rounding, to a random walk of the rate.
_STEEPEST, _FLATTEST = 2, -2
# Minimum number of angles for the autocorrelation.
_FEWEST_ANGLES = 30
# Number of angles from which it is wrong in one of a hundred logs.
_MANY_AVERAGES = 200
# Maximum number of lags for the sum of the paper's equation 10; beyond, its tables for long averages apply.
_LAGS = 100
# Table 2 of the paper, second differences, by alpha.
_LONG_AVERAGES = {1: (790.0, 410.0), 0: (2.0 / 3.0, 1.0 / 3.0), -1: (0.852, 0.375), -2: (1.079, 0.368)}


def noise_exponents(theta: Reals, sizes: Sequence[int]) -> list[int]:
    """Return the exponent alpha, 2 to -2, of the noise at averages of some numbers of samples.

    Parameters
    ----------
    theta : shape (n + 1,)
        Integral of the rate, one per sample.
    sizes
        Numbers of samples, increasing.

    Notes
    -----
    Steeper noise prevails in longer averages. With 30 to 45 averages of white noise, one in five shows a larger
    exponent, whose interval would be a tenth as wide: with few averages such a change is ignored, and below 30 averages
    the exponent of the previous size is used.
    """
    exponents: list[int] = []
    for m in sizes:
        alpha = noise_exponent(theta, m)
        if exponents and (alpha is None or len(theta) < _MANY_AVERAGES * m):
            alpha = exponents[-1] if alpha is None else min(alpha, exponents[-1])
        exponents.append(WHITE if alpha is None else alpha)
    return exponents


def noise_exponent(theta: Reals, m: int) -> int | None:
    """Return the exponent at averages of m samples; None below 30 of them."""
    residuals = _remove_parabola(theta[::m])
    if len(residuals) < _FEWEST_ANGLES or not residuals.any():
        return None
    differences = 0
    while True:
        residuals = residuals - residuals.mean()
        correlation = float(residuals[:-1] @ residuals[1:] / (residuals @ residuals))
        rho = correlation / (1.0 + correlation)
        if rho < 0.25 or differences == 2:
            return int(np.clip(2 - 2 * differences - round(2.0 * rho), _FLATTEST, _STEEPEST))
        residuals, differences = np.diff(residuals), differences + 1


def degrees_of_freedom(n: int, m: int, alpha: int) -> float:
    """Return the degrees of freedom of an overlapping Allan variance of n samples, averages of m <= n / 9."""
    terms = n + 1 - 2 * m
    ratio = terms / m
    if alpha == _STEEPEST:
        return terms / (70.0 / 36.0 - 1.0 / ratio)
    if 3 * m <= _LAGS:
        lags = np.arange(3 * m + 1)
        correlation = _second_difference(lags / m, m, alpha) ** 2
        weights = (1.0 - lags / terms) * np.where(lags % (3 * m), 2.0, 1.0)
        return terms * float(correlation[0] / (weights @ correlation))
    first, second = _LONG_AVERAGES[alpha]
    longer = (15.23 + 12.0 * math.log(m)) ** 2 if alpha == 1 else 1.0
    return longer * ratio / (first - second / ratio)


def interval(deviation: ArrayLike, freedom: ArrayLike) -> tuple[Reals, Reals]:
    """Return the ends of the true deviation's interval with the level `CONFIDENCE`."""
    half = np.asarray(freedom, dtype=np.float64) / 2.0
    tails = 0.5 - 0.5 * CONFIDENCE, 0.5 + 0.5 * CONFIDENCE
    high, low = (np.asarray(deviation * np.sqrt(half / gammaincinv(half, tail))) for tail in tails)
    return low, high


def _second_difference(t: Reals, m: int, alpha: int) -> Reals:
    """Return the paper's s_z at lags t, in averages: the covariance of second differences of averaged angles."""
    around = np.array([1.0, -4.0, 6.0, -4.0, 1.0])
    return np.asarray(around @ [_average_covariance(t + at, m, alpha) for at in (-2.0, -1.0, 0.0, 1.0, 2.0)])


def _average_covariance(t: Reals, m: int, alpha: int) -> Reals:
    covariance = _generalised_covariance(t, alpha)
    beside = _generalised_covariance(t - 1.0 / m, alpha) + _generalised_covariance(t + 1.0 / m, alpha)
    return np.asarray(m * m * (2.0 * covariance - beside))


def _generalised_covariance(t: Reals, alpha: int) -> Reals:
    """Return the generalised autocovariance of angles whose rate has the exponent, up to a factor."""
    size = np.abs(t)
    return np.asarray(size ** (3 - alpha) if alpha % 2 == 0 else xlogy(size ** (3 - alpha), size))


def _remove_parabola(values: Reals) -> Reals:
    """Subtract the closest parabola from values: a bias and its linear drift."""
    line = np.arange(len(values)) - 0.5 * (len(values) - 1)
    residuals: Reals = values - values.mean()
    for power in (line, line * line - (line @ line) / len(line)):
        residuals = residuals - power * (residuals @ power / (power @ power))
    return residuals
