"""Sensor noise as a function of (seed, sensor, epoch, sample number).

There is no state that depends on earlier calls: firmware that reads one cycle later, or skips a sample, has the same
noise on the samples that it shares with other firmware. Bits come from Philox 4x64-10 (Salmon et al., SC'11), addressed
by counter. Sixteen of them choose one of 65 536 quantiles of the normal distribution from a table whose entries are
rounded to 2**-20: `statistics.NormalDist.inv_cdf` is good to about 1e-15, and no entry lies within 1e-13 of a rounding
boundary (tests check it), so the table is equal on every host. The grid is 1e-6 sigma; the coarsest use, the MAG3110,
has sigma = 4 counts. The tails end at 4.3 sigma.
"""

from __future__ import annotations

from functools import lru_cache
from statistics import NormalDist
from zlib import crc32

import numpy as np
from numpy.typing import NDArray

from hiltest.world.earth_field import Vector

_LEVELS = 1 << 16
_GRID = 1 << 20
_BLOCK = 64  # samples made at once, in 20 us; at a known angle few more are read
_BLOCKS_KEPT = 2
_WORDS_PER_BLOCK = _BLOCK * 3 // 4  # four 16-bit draws to a 64-bit word
_WORD_MASK = (1 << 64) - 1


@lru_cache(maxsize=1)
def normal_quantiles() -> NDArray[np.float64]:
    """Return the 65 536 mid-interval quantiles of the standard normal distribution, rounded."""
    inverse = NormalDist().inv_cdf
    upper = [round(inverse(0.5 + (k + 0.5) / _LEVELS) * _GRID) / _GRID for k in range(_LEVELS // 2)]
    return np.array([-value for value in reversed(upper)] + upper)


class NoiseSource:
    """Standard normal triples of one sensor.

    Parameters
    ----------
    seed
        Noise seed.
    sensor
        Name of the sensor and its quantity, such as ``"mag3110@0e"``; two names have
        independent noise.
    """

    def __init__(self, seed: int, sensor: str) -> None:
        self._key = np.array([seed & _WORD_MASK, crc32(sensor.encode())], dtype=np.uint64)
        # Blocks by epoch and number. Samples are read in order, with their neighbours by a filter, so two blocks are
        # cached.
        self._blocks: dict[tuple[int, int], list[Vector]] = {}

    def sample(self, epoch: int, number: int) -> Vector:
        """Return the noise of sample `number` (counted from the start of `epoch`), in sigmas."""
        block, index = divmod(number, _BLOCK)
        samples = self._blocks.get((epoch, block))
        if samples is None:
            if len(self._blocks) == _BLOCKS_KEPT:
                del self._blocks[next(iter(self._blocks))]
            samples = self._blocks[epoch, block] = self._generate(epoch, block)
        return samples[index]

    def _generate(self, epoch: int, block: int) -> list[Vector]:
        # Counter words: 0 counts within the block, 1 is the block, 2 the epoch.
        counter = np.array([0, block & _WORD_MASK, epoch & _WORD_MASK, 0], dtype=np.uint64)
        words = np.random.Philox(counter=counter, key=self._key).random_raw(_WORDS_PER_BLOCK)
        shifts = np.array([0, 16, 32, 48], dtype=np.uint64)
        draws = (words[:, None] >> shifts) & np.uint64(0xFFFF)
        table = normal_quantiles()[draws.astype(np.intp).reshape(_BLOCK, 3)]
        return [(x, y, z) for x, y, z in table.tolist()]
