"""The noise density of a rate sensor from a log at rest, apart from its drift and its output filter."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from hiltest.errors import CalibrationError

Reals = NDArray[np.float64]

#: Lower edge of a gyroscope's flat spectrum [Hz]: above its bias drift.
LOWEST_HZ = 1.0
#: Upper edge in sampling rates, well below its low-pass filter: one of three taps with 3 dB at 0.32 of the rate reduces
#: the density at 0.08 by 2.7 %, and the mean up to there by 0.9 %.
HIGHEST_SHARE = 0.08
_FEWEST_BINS = 30


@dataclass(frozen=True, slots=True, eq=False)
class NoiseDensity:
    """One-sided noise density in a band."""

    per_axis: Reals
    """Shape (k,). Density of each axis, in the unit of the samples over sqrt(Hz)."""
    together: float
    """Root of the mean of the axes' spectra, which is more certain than one axis."""
    relative_uncertainty: float
    """Relative standard uncertainty of `together`."""


def noise_density(samples: ArrayLike, *, rate_hz: float) -> NoiseDensity:
    """Return the noise density of samples taken at rest without a gap.

    Parameters
    ----------
    samples : shape (n, k)
        Samples with one column per axis.
    rate_hz
        Sampling rate.

    Raises
    ------
    CalibrationError
        When there are fewer than 30 frequencies between 1 Hz and 0.08 of the rate.

    Notes
    -----
    A straight line is subtracted from each axis; the density is the root of the mean of the periodogram ``2 |X_k|^2 /
    (n f_s)`` over the band. The rms of samples would include the drift, and lack the noise that the filter removes. A
    bin is chi-squared with 2 degrees of freedom, so ``b`` bins of ``k`` axes leave an uncertainty of ``1 / (2 sqrt(b
    k))`` of the density.
    """
    values = np.asarray(samples, dtype=np.float64)
    n = len(values)
    frequencies = np.fft.rfftfreq(n, 1.0 / rate_hz)
    band = (frequencies >= LOWEST_HZ) & (frequencies <= HIGHEST_SHARE * rate_hz)
    bins = int(band.sum())
    if bins < _FEWEST_BINS:
        raise CalibrationError(
            f"{n} samples at {rate_hz:g} Hz have {bins} frequencies from {LOWEST_HZ:g} to "
            f"{HIGHEST_SHARE * rate_hz:g} Hz; a noise density needs {_FEWEST_BINS}: take a longer log, or a faster one"
        )
    times = np.arange(n) - 0.5 * (n - 1)
    level = values - values.mean(axis=0)
    level -= np.outer(times, times @ level / (times @ times))
    spectrum = 2.0 * np.abs(np.fft.rfft(level, axis=0)[band]) ** 2 / (n * rate_hz)
    power = spectrum.mean(axis=0)
    return NoiseDensity(np.sqrt(power), float(np.sqrt(power.mean())), float(0.5 / np.sqrt(bins * values.shape[1])))
