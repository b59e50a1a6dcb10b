"""Readings of a log that are omitted for all calibrators: repetitions, and outliers of the ellipsoid."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from hiltest.calibration.robust import Mask, outliers, repeats
from hiltest.log_fitting.samples import Samples
from hiltest.log_fitting.span import rows


@dataclass(frozen=True, slots=True, eq=False)
class OmittedReadings:
    """Omitted readings of samples."""

    samples: Samples
    """All samples."""
    robust: bool
    """True if readings are omitted at all."""
    repeated: Mask
    """Shape (n,). Mask of readings that equal the previous one."""
    dropped: Mask
    """Shape (n,). Mask of outliers of the others' ellipsoid, and of their repetitions."""

    @property
    def rest(self) -> Samples:
        """Samples for the calibrators."""
        if not self.robust:
            return self.samples
        return rows(self.samples, ~(self.repeated | self.dropped))

    @property
    def n_dropped(self) -> int:
        """Number of outliers without repetitions."""
        return int((self.dropped & ~self.repeated).sum())

    @property
    def dropped_percent(self) -> float:
        """Outliers, relative to the readings that are not repetitions [%]."""
        return 100.0 * self.n_dropped / float((~self.repeated).sum())

    @property
    def dropped_lines(self) -> tuple[tuple[int, int], ...]:
        """First and last line of each run of dropped readings; without a file, numbers from 1."""
        places = np.flatnonzero(self.dropped)
        if not len(places):
            return ()
        lines = self.samples.lines
        numbers: NDArray[np.int64] = np.arange(1, len(self.dropped) + 1) if lines is None else lines
        ends = np.flatnonzero(np.diff(places) > 1)
        firsts, lasts = places[np.append(0, ends + 1)], places[np.append(ends, len(places) - 1)]
        return tuple(zip(numbers[firsts].tolist(), numbers[lasts].tolist(), strict=True))


def left_out(samples: Samples, *, robust: bool = True) -> OmittedReadings:
    """Determine the readings to omit from samples; none if not robust."""
    repeated = repeats(samples.points)
    dropped = outliers(samples.points) if robust else np.zeros_like(repeated)
    return OmittedReadings(samples, robust, repeated, dropped)
