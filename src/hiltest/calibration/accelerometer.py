"""Accelerometer calibration: counts to gravity."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

Reals = NDArray[np.float64]

#: By the data sheet of the part at its full scale of 4 g.
COUNTS_PER_G = 8192.0


@dataclass(frozen=True, slots=True, eq=False)
class AccelerometerFit:
    """A linear accelerometer calibration: ``gravity_g = gain @ (counts - offset)``.

    Body frame (x forward, y right, z down), gravity-positive: a level board has (0, 0, +1).

    Attributes
    ----------
    gain : ndarray, shape (3, 3)
        [g/count].
    offset : ndarray, shape (3,)
        [counts].
    """

    gain: Reals
    offset: Reals

    def gravity_g(self, counts: ArrayLike) -> Reals:
        """Return the gravity that counts mean.

        Parameters
        ----------
        counts : array_like, shape (..., 3)

        Returns
        -------
        ndarray, shape (..., 3)
            Of norm 1 where the board is still and the calibration good [g].
        """
        return (np.asarray(counts, dtype=np.float64) - self.offset) @ self.gain.T


#: What the part is by its data sheet: no offset, no gain error.
NOMINAL = AccelerometerFit(np.eye(3) / COUNTS_PER_G, np.zeros(3))
