"""Largest and smallest field of each axis, and their middle: MAX, MIN and M_OFF of the FXOS8700CQ's magnetometer."""

from __future__ import annotations

from bisect import bisect_right
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
        self._middles: list[tuple[int, Counts]] = []
        self.skip(time_s)

    def skip(self, time_s: float) -> None:
        """Skip the samples until now, because sampling has just begun, or comparison was off."""
        self._latest = self._output.latest(time_s)

    def take_in(self, time_s: float) -> None:
        """Register the samples since the last call; they are compared when the registers are read."""
        self._take_in(self._output.latest(time_s))

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
                if self._middles and self._middles[-1][1] != (middle := self._middle):
                    self._middles.append((tick + 1, middle))
        self._waiting.clear()

    def follow_middle(self, time_s: float) -> None:
        """Remember the middles from now on: sampling has just begun."""
        self.compare()
        self.skip(time_s)
        self._middles = [(self._latest + 1, self._middle)]

    def middle_before(self, tick: int, *, compares: bool) -> Counts:
        """Return the middles of the extremes at the end of the sample before `tick` [counts], rounded down.

        Parameters
        ----------
        compares
            True if the samples of this run are compared.
        """
        if compares:
            self._take_in(tick - 1)
        self.compare()
        place = bisect_right(self._middles, tick, key=lambda row: row[0])
        return self._middles[max(0, place - 1)][1] if self._middles else self._middle

    def _take_in(self, latest: int) -> None:
        if latest > self._latest:
            self._waiting.append((self._output.copy_with_conversion(self._conversion()), self._latest + 1, latest))
            self._latest = latest
        if len(self._waiting) > _MOST_WAITING:
            self.compare()

    @property
    def _middle(self) -> Counts:
        large, small = self._largest or _NO_SAMPLE, self._smallest or _NO_SAMPLE
        return (large[0] + small[0] >> 1, large[1] + small[1] >> 1, large[2] + small[2] >> 1)

    def _compare(self, counts: Counts) -> None:
        x, y, z = counts
        large, small = self._largest or counts, self._smallest or counts
        self._largest = (max(x, large[0]), max(y, large[1]), max(z, large[2]))
        self._smallest = (min(x, small[0]), min(y, small[1]), min(z, small[2]))
