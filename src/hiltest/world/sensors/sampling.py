"""Output registers of one measured quantity: sampling instants and flags.

Sampling instants are multiples of the period since power-on, whenever the part was made active: firmware that
configures a part one cycle later sees the very same samples. Nothing is computed at those instants; a bus access
evaluates the latest one.
"""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Callable
from copy import copy
from typing import NamedTuple, Protocol, TypeAlias

from hiltest.state import Restorable
from hiltest.world import Vector, World
from hiltest.world.recorded_motion import Sensed

Counts: TypeAlias = tuple[int, int, int]
#: Function from the instant [s] and a standard normal triple to three words of the part.
Measure: TypeAlias = Callable[[float, Vector], Counts]

# Tolerance: virtual times are float multiples of a core cycle (8.3 ns), so an instant that should have come may be
# missed by an ulp. A billionth of a period is 1/700 of a cycle at 80 Hz.
_TOLERANCE_TICKS = 1e-9

_NO_SAMPLE: Counts = (0, 0, 0)
_NEVER = (math.inf, math.inf)
_DELIVERIES_AT_MOST = 65_536  # more than the longest series of one request, 60 000 samples


class Delivery(NamedTuple):
    """A sample that a part has delivered over its bus."""

    time_s: float
    """Time of its last byte, since power-on."""
    instant_s: float
    """Sampling instant."""
    number: int
    """Number of the sample at its rate."""
    words: Counts
    """Output words as they were transferred, in the axes of the part."""


class SampleNoise(Protocol):
    """Noise of each sample of one quantity."""

    def sample(self, epoch: int, number: int) -> Vector:
        """Return the triple of sample `number`, counted from the start of `epoch`."""


class SampledOutput(Restorable):
    """Three output words on an absolute time grid, with data-ready and overwrite flags.

    Parameters
    ----------
    world
        World that defines the noise epoch of an instant.
    noise
        Noise of this quantity.
    measure
        The part's conversion.
    full_scale
        Largest word of the output.
    quantity
        Measured quantity.
    body_axes
        Axes of the part along x, y and z of the body: 1, 2 or 3, negative if opposite.

    Attributes
    ----------
    deliveries : deque of Delivery
        Samples that were read, in order; only the latest are kept.
    delivered : list of int
        Number of all samples that were read, and the sums of their words, each multiplied by `weight`.
    weight : float
        Weight of a count at the present range, so that words of different ranges can be added.
    """

    def __init__(
        self,
        world: World,
        noise: SampleNoise,
        measure: Measure,
        *,
        full_scale: int,
        quantity: Sensed,
        body_axes: tuple[int, int, int],
    ) -> None:
        self.quantity = quantity
        self.body_axes = body_axes
        self.deliveries: deque[Delivery] = deque(maxlen=_DELIVERIES_AT_MOST)
        self.delivered: list[float] = [0, 0, 0, 0]
        self.weight: float = 1
        self._world = world
        self._noise = noise
        self._measure = measure
        self._rate_hz = 1.0
        self._first = 0
        self._last: int | None = -1  # None while it runs
        self._before: Counts = _NO_SAMPLE  # in the registers until the first sample
        self._read = [-1, -1, -1]  # sample that each axis was last read from
        self._held: int | None = None
        self._cached: tuple[int, Counts] = (-1, _NO_SAMPLE)
        self._full_scale = full_scale
        self._frozen = self._saturated = _NEVER

    def freeze(self, begin_s: float, end_s: float) -> None:
        """Repeat the sample of `begin_s` as new samples until `end_s`."""
        self._frozen = (begin_s, end_s)

    def saturate(self, begin_s: float, end_s: float) -> None:
        """Hold the first axis at the end of its range from `begin_s` to `end_s`."""
        self._saturated = (begin_s, end_s)

    def copy_with_conversion(self, measure: Measure) -> SampledOutput:
        """Return a copy of the output with its own conversion, which keeps its samples."""
        other = copy(self)
        other._measure, other._cached = measure, (-1, _NO_SAMPLE)
        return other

    @property
    def rate_hz(self) -> float:
        """Sampling rate of the present or last run [Hz]."""
        return self._rate_hz

    def begin(self, rate_hz: float, *, first_s: float, single: bool = False) -> float:
        """Start sampling: the first sample is on the first instant at or after `first_s`.

        Returns
        -------
        float
            The instant of the first sample [s]; the only one when `single`.
        """
        if self._last is not None and self._last >= self._first:
            self._before = self.counts(self._last)
        self._rate_hz = rate_hz
        self._first = math.ceil(first_s * rate_hz - _TOLERANCE_TICKS)
        self._last = self._first if single else None
        self._read = [self._first - 1] * 3
        self._cached = (-1, _NO_SAMPLE)
        return self._first / rate_hz

    def halt(self, time_s: float) -> None:
        """Stop sampling; the latest sample stays in the registers, regardless of later configuration."""
        self._last = self.latest(time_s)
        self.convert_latest(time_s)

    def convert_latest(self, time_s: float) -> None:
        """Convert the latest sample by the present settings, before they change."""
        latest = self.latest(time_s)
        if latest >= self._first:
            self.counts(latest)

    def clear(self) -> None:
        """Clear all state, like a reset."""
        self._first, self._last = 0, -1
        self._before = _NO_SAMPLE
        self._read = [-1, -1, -1]
        self._held = None

    def next_sample_s(self, time_s: float) -> float:
        """Return the time of the next sample [s]; infinity if there is none."""
        following = self.latest(time_s) + 1
        return following / self._rate_hz if self._last is None or following <= self._last else math.inf

    def next_instant(self, time_s: float) -> float:
        """Return the first sampling instant at or after a time [s]."""
        return math.ceil(time_s * self._rate_hz - _TOLERANCE_TICKS) / self._rate_hz

    def status(self, time_s: float) -> int:
        """Return the status byte: b0-b2 new data on x, y, z, b3 on any; b4-b7 the same for overwritten.

        An axis is overwritten when a sample arrived while the one before had not been
        read; reading the axis's high byte clears both of its flags.
        """
        latest = self.latest(time_s)
        value = 0
        for axis, read in enumerate(self._read):
            if latest > read:
                value |= 0x08 | 1 << axis
            if latest > read + 1:
                value |= 0x80 | 0x10 << axis
        return value

    def read(self, index: int, time_s: float, *, low_first: bool = False) -> int:
        """Return byte `index` (0 to 5) of the three words; a high byte clears its axis's flags."""
        axis = index >> 1
        held = self._held
        if held is None:
            held = self._held = self.latest(time_s)
        word = (self.counts(held) if held >= self._first else self._before)[axis]
        is_high = (index & 1) == low_first
        if is_high and held > self._read[axis]:
            self._read[axis] = held
        if index == 5:
            self.deliver_read(time_s)
        return word >> 8 & 0xFF if is_high else word & 0xFF

    def clear_flags(self, axis: int) -> None:
        """Clear the flags of an axis, whose word was read in this burst."""
        if self._held is not None:
            self._read[axis] = max(self._read[axis], self._held)

    def deliver_read(self, time_s: float) -> None:
        """Note the delivery of the latest words; if each was read in its own transaction, their samples may differ."""
        x, y, z = self._read
        if min(x, y, z) >= self._first:
            words = self.counts(z)
            if x != z or y != z:
                words = (self.counts(x)[0], self.counts(y)[1], words[2])
            self.deliver(z, words, time_s)

    def deliver(self, number: int, words: Counts, time_s: float) -> None:
        """Note that a sample was read completely."""
        delivered = self.delivered
        delivered[0] += 1
        for axis, word in enumerate(words, 1):
            delivered[axis] += word * self.weight
        self.deliveries.append(Delivery(time_s, number / self._rate_hz, number, words))

    def latest(self, time_s: float) -> int:
        """Return the number of the latest sample at a time; below that of the first if there is none."""
        tick = math.floor(time_s * self._rate_hz + _TOLERANCE_TICKS)
        if self._last is not None:
            tick = min(tick, self._last)
        return max(tick, self._first - 1)

    def counts(self, tick: int) -> Counts:
        """Return the three words of a sample by its number."""
        if self._cached[0] != tick:
            self._cached = (tick, self._convert(tick))
        return self._cached[1]

    def word_at(self, instant_s: float, axis: int) -> int:
        """Return an axis's word [counts] at a sampling instant, flags and hold untouched."""
        tick = math.floor(instant_s * self._rate_hz + _TOLERANCE_TICKS)
        return (self.counts(tick) if tick >= self._first else self._before)[axis]

    def held_instant(self, time_s: float) -> float | None:
        """Return the instant of the sample a burst holds, or would hold now [s]; None before any."""
        tick = self.latest(time_s) if self._held is None else self._held
        return tick / self._rate_hz if tick >= self._first else None

    def release(self) -> None:
        """End a burst: the next read takes the latest sample."""
        self._held = None

    def word(self, axis: int, time_s: float) -> int:
        """Return the word of an axis [counts], and hold its sample until the end of the burst."""
        if self._held is None:
            self._held = self.latest(time_s)
        return (self.counts(self._held) if self._held >= self._first else self._before)[axis]

    def _convert(self, tick: int) -> Counts:
        instant_s = tick / self._rate_hz
        begin_s, end_s = self._frozen
        if begin_s <= instant_s < end_s:
            tick = max(self._first, math.floor(begin_s * self._rate_hz))
            instant_s = tick / self._rate_hz
        epoch, start_s = self._world.noise_epoch(instant_s)
        number = tick - math.ceil(start_s * self._rate_hz - _TOLERANCE_TICKS)
        x, y, z = self._measure(instant_s, self._noise.sample(epoch, number))
        begin_s, end_s = self._saturated
        return (self._full_scale if begin_s <= instant_s < end_s else x, y, z)


def along_part(body_axes: tuple[int, int, int], body: Vector) -> Vector:
    """Return a vector of the body along the axes of a part, which are given as in `SampledOutput`."""
    along = [0.0, 0.0, 0.0]
    for axis, value in zip(body_axes, body, strict=True):
        along[abs(axis) - 1] = value if axis > 0 else -value
    return along[0], along[1], along[2]


def limited(value: float, limit: int) -> int:
    """Return a number rounded to the nearest integer and kept within +-limit."""
    return max(-limit, min(limit, round(value)))


def saturated_word(value: float) -> int:
    """Return a number rounded to the nearest integer and kept within a signed 16-bit word."""
    return max(-32_768, min(32_767, round(value)))
