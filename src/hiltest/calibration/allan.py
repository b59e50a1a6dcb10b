"""The Allan deviation of a rate sensor's log, and what is read off it.

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

from hiltest.errors import CalibrationError

Reals = NDArray[np.float64]

#: Variance of a bias instability of 1: 2 ln 2 / pi, the square of 0.664.
FLICKER = 2.0 * math.log(2.0) / math.pi
#: Fewest samples that a curve is made of.
FEWEST_SAMPLES = 1000
#: Averages below so many samples see the sensor's output filter, and are drawn but not fitted.
FILTERED_SAMPLES = 10
_PER_DECADE = 12
# The longest average is so much of the log: of fewer than eight differences of neighbours a variance says little.
_LONGEST = 1.0 / 9.0


@dataclass(frozen=True, slots=True, eq=False)
class AllanReading:
    """Noise figures from the curve of one axis. Rates are in the unit of the log.

    Attributes
    ----------
    angle_random_walk : float
        N [unit/sqrt(Hz)]: in deg/s that is deg/sqrt(s), and 60 times as much in deg/sqrt(h).
    bias_instability : float or None
        B [unit]; None where the log is too short for it to stand out of the noise: it is then at most `lowest` / 0.664.
    rate_random_walk : float
        K [unit/sqrt(s)]; 0 when nothing of it is seen.
    lowest, lowest_at_s : float
        Smallest deviation of the curve, and at which averaging time.
    """

    angle_random_walk: float
    bias_instability: float | None
    rate_random_walk: float
    lowest: float
    lowest_at_s: float

    def deviation(self, tau_s: Reals) -> Reals:
        """Return the deviation that these numbers together make."""
        flicker = self.bias_instability or 0.0
        variance = self.angle_random_walk**2 / tau_s + FLICKER * flicker**2 + self.rate_random_walk**2 * tau_s / 3.0
        return np.asarray(np.sqrt(variance), dtype=np.float64)


@dataclass(frozen=True, slots=True, eq=False)
class AllanCurve:
    """Overlapping Allan deviation.

    Attributes
    ----------
    tau_s : ndarray, shape (k,)
        Averaging times.
    deviation : ndarray, shape (k, axes)
        In the unit of the log.
    relative_uncertainty : ndarray, shape (k,)
        Standard uncertainty of a deviation, of its value.
    readings : tuple of AllanReading
        One an axis.
    """

    tau_s: Reals
    deviation: Reals
    relative_uncertainty: Reals
    readings: tuple[AllanReading, ...]


def allan_curve(rates: ArrayLike, *, rate_hz: float) -> AllanCurve:
    """Return the Allan deviation of a log without gaps, and what is read off it.

    Parameters
    ----------
    rates : array_like, shape (n, axes)
        At rest, at least 1000 samples.
    rate_hz : float
        Sampling rate.

    Raises
    ------
    CalibrationError
        When there are too few samples, or a column does not change.

    Notes
    -----
    Overlapping: ``1 / (2 tau^2 (n - 2m + 1)) sum (theta[k+2m] - 2 theta[k+m] + theta[k])^2``, tau = m / rate_hz.
    N, B and K are the non-negative least squares fit of the three terms to the variances, each weighted by its
    uncertainty, from ten samples on; the variance's own uncertainty is that for white noise (NIST SP 1065, table 5).
    """
    values = np.asarray(rates, dtype=np.float64)
    n = len(values)
    if n < FEWEST_SAMPLES:
        raise CalibrationError(f"{n} samples; an Allan deviation needs at least {FEWEST_SAMPLES}: take a longer log")
    stuck = [axis for axis in range(values.shape[1]) if (values[:, axis] == values[0, axis]).all()]
    if stuck:
        raise CalibrationError(f"rate {stuck[0] + 1} of {values.shape[1]} has one value only: it is no sensor's noise")
    sizes = averages(n)
    # Without its mean the angle stays small, and keeps its digits.
    theta = np.concatenate([np.zeros((1, values.shape[1])), np.cumsum(values - values.mean(axis=0), axis=0)]) / rate_hz
    variance = np.array([_variance(theta, int(m), rate_hz) for m in sizes])
    if not variance.all():
        raise CalibrationError("the log repeats itself: its averages are all alike, as no sensor's noise is")
    relative = np.array([math.sqrt(2.0 / _degrees_of_freedom(n, int(m))) for m in sizes])
    tau_s = sizes / rate_hz
    fitted = sizes >= FILTERED_SAMPLES
    readings = tuple(
        _read_off(tau_s, variance[:, axis], relative, fitted) for axis in range(values.shape[1])
    )
    return AllanCurve(tau_s, np.sqrt(variance), 0.5 * relative, readings)


def averages(n: int) -> NDArray[np.int64]:
    """Return the numbers of samples averaged: twelve a decade, up to a ninth of the log."""
    steps = math.floor(_PER_DECADE * math.log10(n * _LONGEST))
    sizes = np.unique(np.round(10.0 ** (np.arange(steps + 1) / _PER_DECADE)).astype(np.int64))
    return np.asarray(sizes, dtype=np.int64)


def _variance(theta: Reals, m: int, rate_hz: float) -> Reals:
    second = theta[2 * m :] - 2.0 * theta[m:-m] + theta[: -2 * m]
    return np.asarray((second**2).mean(axis=0) / (2.0 * (m / rate_hz) ** 2), dtype=np.float64)


def _degrees_of_freedom(n: int, m: int) -> float:
    """Return those of an overlapping variance of white noise: NIST SP 1065, table 5, with n + 1 angles."""
    angles = n + 1
    share = 3.0 * (angles - 1) / (2.0 * m) - 2.0 * (angles - 2) / angles
    return max(1.0, share * 4.0 * m * m / (4.0 * m * m + 5.0))


def _read_off(tau_s: Reals, variance: Reals, relative: Reals, fitted: NDArray[np.bool_]) -> AllanReading:
    terms = np.column_stack([1.0 / tau_s, np.full_like(tau_s, FLICKER), tau_s / 3.0])[fitted]
    weights = 1.0 / (variance * relative)[fitted]
    # Columns of one size, or nothing small would ever be taken up.
    scale = np.linalg.norm(terms * weights[:, None], axis=0)
    squares = nnls(terms * weights[:, None] / scale, variance[fitted] * weights)[0] / scale
    lowest = int(np.argmin(variance))
    # Where it is not at least half of the lowest variance, it is lost in the uncertainty of the other terms.
    seen = FLICKER * squares[1] >= 0.5 * variance[lowest]
    return AllanReading(
        float(math.sqrt(squares[0])), float(math.sqrt(squares[1])) if seen else None, float(math.sqrt(squares[2])),
        float(math.sqrt(variance[lowest])), float(tau_s[lowest]),
    )
