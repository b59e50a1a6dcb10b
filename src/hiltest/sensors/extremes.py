"""Largest and smallest output of each axis: the FXOS8700CQ magnetometer's MAX and MIN registers."""

from __future__ import annotations

from hiltest.sensors.sampling import Counts, SampledOutput

_NO_SAMPLE: Counts = (0, 0, 0)


class Extremes:
    """Running maxima and minima of an output, found when they are read.

    Parameters
    ----------
    output : SampledOutput
        Output that is compared.

    Notes
    -----
    Before the first sample the registers read 0; the data sheet's text on that could not be
    seen, nor can firmware learn anything from it.
    """

    def __init__(self, output: SampledOutput) -> None:
        self._output = output
        self.restart(0.0)

    def restart(self, time_s: float) -> None:
        """Forget all samples until now."""
        self._largest: Counts | None = None
        self._smallest: Counts | None = None
        self.skip(time_s)

    def skip(self, time_s: float) -> None:
        """Leave out the samples until now: sampling has just begun, or comparing was switched off."""
        self._seen = self._output.latest(time_s)

    def take_in(self, time_s: float) -> None:
        """Compare the samples that came since the last time."""
        latest = self._output.latest(time_s)
        for tick in range(self._seen + 1, latest + 1):
            self._compare(self._output.counts(tick))
        self._seen = latest

    def read(self, index: int) -> int:
        """Return byte `index` of the six words: maxima of x, y, z, then minima."""
        which, low = divmod(index, 2)
        word = (*(self._largest or _NO_SAMPLE), *(self._smallest or _NO_SAMPLE))[which]
        return word >> (0 if low else 8) & 0xFF

    def _compare(self, counts: Counts) -> None:
        x, y, z = counts
        large, small = self._largest or counts, self._smallest or counts
        self._largest = (max(x, large[0]), max(y, large[1]), max(z, large[2]))
        self._smallest = (min(x, small[0]), min(y, small[1]), min(z, small[2]))
