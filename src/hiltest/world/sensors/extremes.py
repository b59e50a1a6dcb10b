"""Largest and smallest output of each axis: the FXOS8700CQ magnetometer's MAX and MIN registers."""

from __future__ import annotations

from collections.abc import Callable

from hiltest.state import Restorable
from hiltest.world.sensors.sampling import Counts, Measure, SampledOutput

_NO_SAMPLE: Counts = (0, 0, 0)
_MOST_WAITING = 100  # runs of the output; firmware may start any number and never read the registers


class Extremes(Restorable):
    """Running maxima and minima of an output, computed when they are read.

    Parameters
    ----------
    output
        Output to compare.
    conversion
        Returns the part's conversion with its present configuration, independent of later changes.

    Notes
    -----
    Before the first sample the registers read 0, which the data sheet does not specify.
    """

    def __init__(self, output: SampledOutput, conversion: Callable[[], Measure]) -> None:
        self._output = output
        self._conversion = conversion
        self.restart(0.0)

    def restart(self, time_s: float) -> None:
        """Discard all samples until now."""
        self._largest: Counts | None = None
        self._smallest: Counts | None = None
        self._waiting: list[tuple[SampledOutput, int, int]] = []  # numbers of the first and the last sample
        self.skip(time_s)

    def skip(self, time_s: float) -> None:
        """Skip the samples until now, because sampling has just begun, or comparison was off."""
        self._latest = self._output.latest(time_s)

    def take_in(self, time_s: float) -> None:
        """Register the samples since the last call; they are compared when the registers are read."""
        latest = self._output.latest(time_s)
        if latest > self._latest:
            self._waiting.append((self._output.copy_with_conversion(self._conversion()), self._latest + 1, latest))
        if len(self._waiting) > _MOST_WAITING:
            self.compare()
        self._latest = latest

    def read(self, index: int) -> int:
        """Return byte `index` of the six words: maxima of x, y, z, then minima."""
        self.compare()
        which, low = divmod(index, 2)
        word = (*(self._largest or _NO_SAMPLE), *(self._smallest or _NO_SAMPLE))[which]
        return word >> (0 if low else 8) & 0xFF

    def compare(self) -> None:
        """Compare the registered samples."""
        for output, first, last in self._waiting:
            for tick in range(first, last + 1):
                self._compare(output.counts(tick))
        self._waiting.clear()

    def _compare(self, counts: Counts) -> None:
        x, y, z = counts
        large, small = self._largest or counts, self._smallest or counts
        self._largest = (max(x, large[0]), max(y, large[1]), max(z, large[2]))
        self._smallest = (min(x, small[0]), min(y, small[1]), min(z, small[2]))
