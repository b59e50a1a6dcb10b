"""The 32-sample FIFO of the FXAS21002C and of the FXOS8700CQ's accelerometer.

Nothing happens at the sampling instants: an access first processes the samples since the previous one. A stored
sample is the number of its instant, so it has the same value as without a FIFO.

Sources: F_STATUS, F_SETUP and F_EVENT with the bit names of the two data sheets; if those are brief, the same registers
of NXP's MMA8451Q and MPL3115A2 (which flush on the way to active mode, raise no watermark of 0, and return zeros for
missing samples). Two interpretations: F_OVF stays until a sample is read, because only then is the FIFO no longer full;
a sample leaves the FIFO when the high byte of its x axis is read.
"""

from __future__ import annotations

from collections import deque
from enum import Enum

from hiltest.state import Restorable
from hiltest.world.sensors.sampling import Counts, SampledOutput

CAPACITY = 32
OVERFLOW, WATERMARK = 0x80, 0x40  # F_STATUS; below them the count
_WATERMARK_FIELD = 0x3F  # F_SETUP
_NOTHING: Counts = (0, 0, 0)


class FifoMode(Enum):
    """F_SETUP's F_MODE, with the FXOS8700CQ's numbers."""

    OFF = 0
    CIRCULAR = 1
    STOP = 2
    TRIGGER = 3


class SampleFifo(Restorable):
    """FIFO of a part, which stores its latest samples until they are read.

    Parameters
    ----------
    output
        Output to store.
    has_trigger
        True if F_MODE = 11 is the trigger mode; otherwise it is another code for the stop mode.

    Notes
    -----
    Circular mode drops the oldest sample for a new one, stop mode drops the new one. Trigger mode keeps the latest
    F_WMRK samples until an event of the part; no modelled part has such events, so it stays in this state, and dropped
    samples are not an overflow.
    """

    def __init__(self, output: SampledOutput, *, has_trigger: bool) -> None:
        self._output = output
        self._has_trigger = has_trigger
        self.setup = 0
        self.mode = FifoMode.OFF
        self._ticks: deque[int] = deque()
        self._converted: dict[int, Counts] = {}
        self._removed, self._removed_number = _NOTHING, -1
        self._latest = self._acknowledged = -1  # the latest sample offered so far, and when F_STATUS was last read
        self._marked_at: int | None = None  # the sample that raised the watermark, and the overflow
        self._overflowed_at: int | None = None

    @property
    def is_on(self) -> bool:
        """True if F_MODE is other than 00."""
        return self.mode is not FifoMode.OFF

    def reset(self) -> None:
        """Return to the state after power-on; the output has just been cleared."""
        self.configure(0, 0.0)

    def configure(self, setup: int, time_s: float) -> None:
        """Apply a write to F_SETUP in standby; another mode empties the FIFO."""
        before = self.mode
        self.setup = setup
        self.mode = FifoMode(setup >> 6)
        if self.mode is FifoMode.TRIGGER and not self._has_trigger:
            self.mode = FifoMode.STOP
        if self.mode is not before or not self.is_on:
            self._empty(time_s)

    def begin(self, time_s: float) -> None:
        """Start empty: the output begins to sample."""
        self._empty(time_s)

    def halt(self, time_s: float) -> None:
        """Keep the stored samples: the output stops."""
        self._take_in(time_s)
        # Scale and offsets may change in standby, but not the earlier samples.
        self._converted = {tick: self._output.counts(tick) for tick in self._ticks}

    def status(self, time_s: float) -> int:
        """Return F_STATUS: overflow, watermark and the number of samples."""
        self._take_in(time_s)
        overflow = 0 if self._overflowed_at is None else OVERFLOW
        watermark = 0 if self._marked_at is None else WATERMARK
        return overflow | watermark | len(self._ticks)

    def acknowledge(self) -> None:
        """Register a read of F_STATUS, which clears its pending events."""
        self._acknowledged = self._latest

    def pending(self, time_s: float) -> bool:
        """Return whether overflow or watermark has been raised since F_STATUS was last read, and still holds."""
        self._take_in(time_s)
        return any(tick > self._acknowledged for tick in self._raised_ticks())

    def event(self, time_s: float) -> int:
        """Return F_EVENT: b5 overflow or watermark, b4-b0 the output periods since, at most 31."""
        self._take_in(time_s)
        raised = self._raised_ticks()
        return 0x20 | min(31, self._latest - min(raised)) if raised else 0

    def read(self, index: int, time_s: float) -> int:
        """Return byte `index` (0 to 5) of the oldest sample; byte 0 takes the sample out.

        The other bytes follow it in the same transaction; read separately they are 0, like all bytes of an empty FIFO.
        """
        axis, low = divmod(index, 2)
        if index == 0:
            self._removed = self._take(time_s)
        if index == 5 and self._removed_number >= 0:
            self._output.deliver(self._removed_number, self._removed, time_s)
        return self._removed[axis] >> (0 if low else 8) & 0xFF

    def release(self) -> None:
        """End a burst, and drop the removed sample."""
        self._removed, self._removed_number = _NOTHING, -1

    def _empty(self, time_s: float) -> None:
        self._ticks = deque(maxlen=self._capacity)
        self._converted = {}
        self._removed, self._removed_number = _NOTHING, -1
        self._latest = self._acknowledged = self._output.latest(time_s)
        self._marked_at = self._overflowed_at = None

    @property
    def _watermark(self) -> int:
        return self.setup & _WATERMARK_FIELD

    @property
    def _capacity(self) -> int:
        return min(CAPACITY, self._watermark) if self.mode is FifoMode.TRIGGER else CAPACITY

    def _raised_ticks(self) -> list[int]:
        return [tick for tick in (self._marked_at, self._overflowed_at) if tick is not None]

    def _take_in(self, time_s: float) -> None:
        latest = self._output.latest(time_s)
        if not self.is_on or latest <= self._latest:
            return
        arrived = range(self._latest + 1, latest + 1)
        stored = len(self._ticks)
        room = self._capacity - stored
        # A deque of limited length drops from its other end.
        self._ticks.extend(arrived[:room] if self.mode is FifoMode.STOP else arrived[-CAPACITY:])
        if stored < self._watermark <= len(self._ticks):
            self._marked_at = self._latest + self._watermark - stored
        if len(arrived) > room and self._overflowed_at is None and self.mode is not FifoMode.TRIGGER:
            self._overflowed_at = self._latest + room + 1
        self._latest = latest

    def _take(self, time_s: float) -> Counts:
        self._take_in(time_s)
        if not self._ticks:
            self._removed_number = -1
            return _NOTHING
        tick = self._removed_number = self._ticks.popleft()
        self._overflowed_at = None
        if len(self._ticks) < self._watermark:
            self._marked_at = None
        return self._converted.get(tick) or self._output.counts(tick)
