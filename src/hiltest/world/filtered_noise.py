"""Sensor noise after a part's low-pass filter: still a function of (seed, sensor, epoch, sample number).

A rate sensor's white noise has a density, and its output filter removes frequencies above the bandwidth. So
neighbouring samples are correlated, and the mean of n samples is noisier than the rms of one over the root of n:
independent samples with the right rms would have a density that is too low by the root of twice the bandwidth over the
rate.
"""

from __future__ import annotations

import math
from functools import lru_cache

from hiltest.state import Restorable
from hiltest.world.earth_field import Vector
from hiltest.world.noise import NoiseSource

_GRID = 1 << 20  # rounding grid, because exponentials may differ in the last bit between hosts
_LEAST_TAP = 1e-3


@lru_cache(maxsize=8)
def low_pass_taps(bandwidth: float) -> tuple[float, ...]:
    """Return one half, the middle first, of a symmetric filter of gain 1 for slow changes.

    Parameters
    ----------
    bandwidth
        Bandwidth of the noise, in sampling rates: above 0 and below 0.5.

    Notes
    -----
    The filter is a Gaussian whose squares sum to twice the bandwidth: white noise of one-sided density d, sampled at f,
    has the variance d^2 f/2, of which d^2 f bandwidth remains. At 0.32 it has three taps, and an attenuation of 3.2 dB.
    """
    narrow, wide = 0.05, 10.0
    for _ in range(60):
        width = 0.5 * (narrow + wide)
        if _power(_gaussian(width)) > 2.0 * bandwidth:
            narrow = width
        else:
            wide = width
    sides = [round(tap * _GRID) / _GRID for tap in _gaussian(wide)[1:] if tap > _LEAST_TAP]
    return (1.0 - 2.0 * sum(sides), *sides)


def _gaussian(width: float) -> list[float]:
    half = [math.exp(-0.5 * (k / width) ** 2) for k in range(41)]
    total = half[0] + 2.0 * sum(half[1:])
    return [tap / total for tap in half]


def _power(half: list[float]) -> float:
    return half[0] ** 2 + 2.0 * sum(tap**2 for tap in half[1:])


class LowPassedNoise(Restorable):
    """Noise triples whose spectrum is flat with density 1 up to a filter's bandwidth.

    Attributes
    ----------
    taps : tuple of float
        Taps from `low_pass_taps`; initially for white noise.
    """

    def __init__(self, white: NoiseSource) -> None:
        self._white = white
        self.taps: tuple[float, ...] = (1.0,)

    def sample(self, epoch: int, number: int) -> Vector:
        """Return the noise of a sample, in sigmas of the white noise before the filter."""
        middle, *sides = self.taps
        x, y, z = (middle * component for component in self._white.sample(epoch, number))
        for distance, tap in enumerate(sides, start=1):
            before, after = self._white.sample(epoch, number - distance), self._white.sample(epoch, number + distance)
            x += tap * (before[0] + after[0])
            y += tap * (before[1] + after[1])
            z += tap * (before[2] + after[2])
        return (x, y, z)
