"""A gyroscope's noise with declared figures, made in the frequency domain."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

Reals = NDArray[np.float64]


def white(rng: np.random.Generator, n: int, *, rate_hz: float, angle_random_walk: float) -> Reals:
    """White rate noise whose two-sided density is the angle random walk squared."""
    return angle_random_walk * np.sqrt(rate_hz) * rng.normal(size=n)


def flicker(rng: np.random.Generator, n: int, *, rate_hz: float, bias_instability: float) -> Reals:
    """1/f noise of the two-sided density ``B^2 / (2 pi f)``, IEEE Std 952's.

    Random phases and normal amplitudes with that spectrum over twice the time, of which one half is taken: so it
    does not end where it began. Below one over twice the time there is nothing.
    """
    frequencies = np.fft.rfftfreq(2 * n, 1.0 / rate_hz)
    density = np.zeros_like(frequencies)
    density[1:] = bias_instability**2 / (2.0 * np.pi * frequencies[1:])
    amplitudes = rng.normal(size=len(density)) + 1j * rng.normal(size=len(density))
    return np.fft.irfft(amplitudes * np.sqrt(density * 2 * n * rate_hz / 2.0), 2 * n)[:n]


def random_walk(rng: np.random.Generator, n: int, *, rate_hz: float, rate_random_walk: float) -> Reals:
    """The sum of white steps: a rate that wanders by K sqrt(t)."""
    return np.cumsum(rate_random_walk / np.sqrt(rate_hz) * rng.normal(size=n))
