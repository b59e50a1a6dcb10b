"""Raw samples that firmware reports, beside those that its sensor delivered: the first link from sensor to heading.

A line of firmware shows a sample, or the mean of the latest ones, in counts. On a virtual board every sample on the bus
is known, so a line that follows from them is right to its last digit, and one that does not shows the reason: a
relation that holds for all samples of an axis, or single samples that are corrupt. A real board leaves the statistics
of the lines.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from functools import partial
from itertools import permutations, product
from typing import TypeAlias

import numpy as np
from numpy.typing import NDArray

Array: TypeAlias = NDArray[np.float64]

FEWEST_LINES = 20
"""Fewest readings whose samples are described."""

_MOST_LINES = 400
_LONGEST_WAIT_S = 0.13  # from the last sample of a line until the line is read: its transfer, and a slice of listening
_MOST_IN_A_MEAN = 32
_GROSS = 1e-3  # deviation that counts, as a share of the samples' range
_FAR = 10.0  # deviation that counts without an explanation, as a multiple of a gross one
_ROUNDING = 0.6  # deviation by rounding, in units of the last digit
_HOLDS = 0.6  # share of lines for which a relation must hold
_BETTER = 0.02  # share of lines by which a relation must be better than a simpler one
_STILL = 0.05  # range of an axis that does not move, as a share of that of the samples
_FEWEST_AT_A_LIMIT, _SHARE_AT_A_LIMIT = 4, 0.02
_MOST_ISOLATED = 0.3
_SHARE_OF_RIGHT = 0.1  # share of exact readings that shows how many samples a reading is the mean of
_MOST_WRONG = 40
_STICKS_OUT = 10.0  # deviation of an outlier from its neighbours, as a multiple of the median deviation
_DRIVER = "registers, order of the axes and signs in the driver of the {}, beside the data sheet"
_BYTES = "order of the bytes in the driver of the {}: big or little endian"
_TYPE = "type of the {}'s counts, from the driver to the sum: two's complement, int16_t or wider"
_RANGE = "range and limits of the {}'s counts"
_FRESH = "the loop that reads the {}: the start of each measurement, the flag of new samples, an error of the bus"
_WHOLE = "reading of the {}: all bytes in one transfer, after the flag of new samples"
_ALIGN = "the line that turns the {}'s axes: once for each new sample"
_UNIT = "unit and scale of the {}'s counts"


def _axes_in_words(order: Sequence[int], signs: Sequence[float]) -> str:
    x, y, z = ("-" * (sign < 0.0) + "xyz"[axis] for axis, sign in zip(order, signs, strict=True))
    return f"{x}, {y} and {z}"


_SIGNED_AXES = [
    (list(order), np.array(signs), _axes_in_words(order, signs))
    for order in permutations(range(3))
    for signs in product((1.0, -1.0), repeat=3)
]


@dataclass(frozen=True, slots=True)
class SampleFault:
    """What is wrong with the samples of a sensor."""

    words: str
    place: str
    """Part of the firmware to check."""


@dataclass(frozen=True, slots=True, eq=False)
class Lines:
    """Raw readings that firmware reported."""

    time_s: Array
    """Shape (n,). Time at which each was read."""
    counts: Array
    """Shape (n, 3). In hiltest's axes."""
    delivered: Sequence[Array] | None = None
    """Samples of each sensor of this kind, shape (m, 4): time [s] and counts; None if they are unknown."""

    @property
    def last_digit(self) -> float:
        """Smallest difference of two readings [counts]."""
        axes = [np.unique(self.counts[:, axis].round(4)) for axis in range(3)]
        return min((float(np.diff(axis).min()) for axis in axes if len(axis) >= FEWEST_LINES), default=0.0)


def describe_samples(sensor: str, unit: tuple[float, str], lines: Lines, *, is_moving: bool) -> tuple[SampleFault, ...]:
    """Return the faults of a sensor's reported samples; empty if they are right.

    Parameters
    ----------
    unit
        Counts of a unit, and its name.
    is_moving
        True if the board is turned through all directions meanwhile.
    """
    if lines.delivered is None:
        faults = _statistics(sensor, unit, lines, is_moving=is_moving)
    else:
        compared = [_Comparison(sensor, unit, lines, samples) for samples in lines.delivered if len(samples) > 1]
        best = min(compared, key=lambda comparison: -comparison.share, default=None)
        faults = best.faults(is_moving=is_moving) if best else []
    return tuple(faults)


def merge_faults(first: Sequence[SampleFault], second: Sequence[SampleFault] = ()) -> tuple[SampleFault, ...]:
    """Return the faults of a magnetometer and those of an accelerometer, one of both if they have the same."""
    names = "magnetometer", "accelerometer"
    of_second = {fault.words.replace(names[1], names[0]): fault for fault in second}
    merged = []
    for fault in first:
        other = of_second.pop(fault.words, None)
        words = fault.words.replace(names[0], " and the ".join(names)) if other else fault.words
        merged.append(SampleFault(words, fault.place))
    return (*merged, *of_second.values())


# Relations of an axis: a name with a place, and the samples as the firmware has them.
_Relation: TypeAlias = tuple[str, str, Array]


def _exchange_bytes(counts: Array, shift: int) -> Array:
    words = np.asarray(counts / 2**shift, dtype=np.int64).astype(np.int16)
    return np.asarray(words.byteswap().astype(np.float64) * 2**shift)


def _relations(counts: Array, readings: Array, unit: tuple[float, str]) -> Iterator[_Relation]:
    """Return the relations that are tried for an axis, the simplest first."""
    per_unit, name = unit
    for low, high in ((readings.min(), readings.max()), (-np.abs(readings).max(), np.abs(readings).max())):
        ends = high / per_unit if -low == high else (low / per_unit, high / per_unit)
        words = f"+-{ends:.4g} {name}" if isinstance(ends, float) else f"{ends[0]:.4g} and {ends[1]:.4g} {name}"
        yield f"is clipped at {words}", _RANGE, np.clip(counts, low, high)
    for bits in range(17, 5, -1):
        period = 2.0**bits
        yield (
            f"overflows at +-{period / 2.0 / per_unit:.4g} {name}, {period:g} counts",
            _TYPE,
            (counts + period / 2.0) % period - period / 2.0,
        )
        wrapped = (counts % period, -(-counts % period))
        yield from (
            (f"is read as unsigned, negative values are {period / per_unit:.4g} {name} more", _TYPE, one)
            for one in wrapped
        )
    for shift in range(3):
        for one in (_exchange_bytes(counts, shift), -_exchange_bytes(-counts, shift)):
            yield "has its two bytes exchanged", _BYTES, one
    yield "has lost its sign", _TYPE, np.abs(counts)
    for bits in range(4, 13):
        step = 2.0**bits
        for one in (np.floor(counts / step) * step, np.ceil(counts / step) * step, np.trunc(counts / step) * step):
            yield f"has lost its low bits, steps of {step / per_unit:.4g} {name}", _TYPE, one


_Corrupt: TypeAlias = Callable[[Array, Array], Sequence[Array]]


def _torn(counts: Array, before: Array) -> list[Array]:
    """Return samples whose axes or bytes are partly those of the sample before, with either sign of the register."""
    bytes_ = [
        sign * (256.0 * (sign * one // 256.0) + sign * other % 256.0)
        for sign in (1.0, -1.0)
        for one, other in ((counts, before), (before, counts))
    ]
    return [counts, before, *bytes_]


def _turn_again(counts: Array, before: Array, *, order: list[int], signs: Array, of_before: bool) -> list[Array]:
    return [(before if of_before else counts)[..., order] * signs]


# Corrupt single samples: a name with a place, and what an axis may hold in place of the right sample.
_CORRUPT: tuple[tuple[str, str, _Corrupt], ...] = (
    ("are 0, 0, 0", _WHOLE, lambda counts, before: [0.0 * counts]),
    ("have all bits set, as on a bus without an answer", _WHOLE, lambda counts, before: [0.0 * counts - 1.0]),
    ("are the one before once more", _FRESH, lambda counts, before: [before]),
    ("are torn: bytes of two samples", _WHOLE, _torn),
    (
        "have a flipped bit",
        _WHOLE,
        lambda counts, before: [counts, *(counts + sign * 2.0**bit for bit in range(3, 16) for sign in (1.0, -1.0))],
    ),
    *(
        (
            f"have their axes turned once more (x, y and z are {axes}{of})",
            _ALIGN,
            partial(_turn_again, order=order, signs=signs, of_before=bool(of)),
        )
        for order, signs, axes in _SIGNED_AXES[1:]
        for of in ("", " of the sample before")
    ),
)


class _Comparison:
    """Readings beside the samples of one sensor.

    Attributes
    ----------
    share : float
        Share of the readings for which the relations of all axes hold, in the mean.
    """

    def __init__(self, sensor: str, unit: tuple[float, str], lines: Lines, samples: Array) -> None:
        self.sensor, self.unit = sensor, unit
        ends = np.searchsorted(samples[:, 0], lines.time_s, side="right")
        period_s = float(np.median(np.diff(samples[:, 0])))
        lags = np.arange(int(_LONGEST_WAIT_S / period_s) + 3)
        a_line = int(np.median(np.diff(np.unique(ends)))) if len(np.unique(ends)) > 1 else 1
        self._most = min(_MOST_IN_A_MEAN, a_line + a_line // 4 + 1)
        places = ends[:, None] - lags
        is_last = np.append(np.diff(lines.time_s) > 0.0, True)  # others of the same reading may have waited
        used = np.flatnonzero(is_last & (places[:, -1] >= self._most))
        used = used[:: 1 + len(used) // _MOST_LINES]
        self.places, self.readings, self.time_s = places[used], lines.counts[used], lines.time_s[used]
        self.counts = samples[:, 1:]
        self.exact = _ROUNDING * lines.last_digit + 1e-3
        self.gross = max(self.exact, _GROSS * float(np.ptp(self.counts, axis=0).max()))
        tried = {size: self._relations_of_axes(size) for size in range(1, self._most + 1)} if len(used) else {}
        sums = {size: sum(share for share, *_ in rows) for size, rows in tried.items()}
        likely = [size for size in sums if sums[size] >= max(sums.values()) - _BETTER]
        self.size = max(likely, key=lambda size: (self._away(size) <= self.exact).mean(), default=1)
        self.axes = tried.get(self.size, [])
        self.share = sums.get(self.size, 0.0) / 3.0

    def _means(self, counts: Array, size: int) -> Array:
        """Return the means of the latest samples for each reading and each possible last one, shape (n, lags, ...)."""
        sums = np.concatenate([np.zeros((1, *counts.shape[1:])), np.cumsum(counts, axis=0)])
        return np.asarray((sums[self.places] - sums[self.places - size]) / size)

    def _away(self, size: int) -> Array:
        """Return the largest deviation along an axis of each reading from the nearest means, shape (n,)."""
        return np.asarray(np.abs(self._means(self.counts, size) - self.readings[:, None]).max(axis=2).min(axis=1))

    def _share(self, axis: int, counts: Array, size: int) -> float:
        away = np.abs(self._means(counts, size) - self.readings[:, axis, None]).min(axis=1)
        return float((away <= self.gross).mean())

    def _relations_of_axes(self, size: int) -> list[tuple[float, int, float, _Relation]]:
        """Return share, source, sign and relation of each axis for means of some samples."""
        rows = []
        for axis in range(3):
            sources = [(axis, 1.0), *(pair for pair in product(range(3), (1.0, -1.0)) if pair != (axis, 1.0))]
            tried = [
                (self._share(axis, sign * self.counts[:, source], size), source, sign, ("", "", self.counts[:, source]))
                for source, sign in sources
            ]
            if max(share for share, *_ in tried) < 1.0 - _BETTER:
                tried += [
                    (self._share(axis, relation[2], size), axis, 1.0, relation)
                    for relation in _relations(self.counts[:, axis], self.readings[:, axis], self.unit)
                ]
            most = max(share for share, *_ in tried)
            rows.append(next(row for row in tried if row[0] >= most - _BETTER))
        return rows

    def faults(self, *, is_moving: bool) -> list[SampleFault]:
        """Return the faults, those of whole axes first."""
        if not len(self.readings) or np.ptp(self.counts, axis=0).max() <= 8.0 * self.gross:
            return []
        ranges, of_samples = np.ptp(self.readings, axis=0), np.ptp(self.counts, axis=0)
        scale = min(1.0, float(ranges.max() / of_samples.max()))
        still = [axis for axis in range(3) if ranges[axis] <= _STILL * scale * of_samples[axis]]
        if (frozen := self._frozen()) is not None:
            return [frozen]
        faults = [
            SampleFault(
                f"the {'xyz'[axis]} axis of the {self.sensor} does not move: it stays at "
                f"{np.median(self.readings[:, axis]) / self.unit[0]:.3g} {self.unit[1]}",
                _DRIVER.format(self.sensor),
            )
            for axis in still
        ]
        moving = [axis for axis in range(3) if axis not in still]
        of_axes = [self.axes[axis] for axis in moving]
        holds = all(share >= _HOLDS for share, *_ in of_axes)
        is_plain = holds and not any(relation[0] for *_, relation in of_axes)
        if not is_plain and not still and (scaled := self._scale()) is not None:
            return [scaled]
        if holds and not is_plain:
            return faults + self._of_axes(moving)
        if still:
            return faults
        sources = [(source, sign) for _, source, sign, _ in of_axes]
        if holds and sources != [(0, 1.0), (1, 1.0), (2, 1.0)]:
            words = f"axes of the {self.sensor} (x, y and z are {_axes_in_words(*zip(*sources, strict=True))})"
            return [SampleFault(words, _DRIVER.format(self.sensor))]
        return self._corrupt(is_moving=is_moving)

    def _of_axes(self, axes: Sequence[int]) -> list[SampleFault]:
        """Return the relations of axes, one fault for those with the same."""
        by_words: dict[tuple[str, str], list[str]] = {}
        for axis in axes:
            _, _, _, (words, place, _) = self.axes[axis]
            if words:
                by_words.setdefault((words, place), []).append("xyz"[axis])
        faults = []
        for (words, place), names in by_words.items():
            which = "" if len(names) == 3 else f"{' and '.join(names)} {'axes' if len(names) > 1 else 'axis'} of the "
            verb, _, rest = words.partition(" ")
            verb = {"is": "are", "has": "have", "overflows": "overflow"}[verb] if len(names) == 2 else verb
            faults.append(SampleFault(f"the {which}{self.sensor} {verb} {rest}", place.format(self.sensor)))
        return faults

    def _frozen(self) -> SampleFault | None:
        """Return the fault of readings that stay the same at the end while the samples change."""
        changed = np.flatnonzero(np.any(self.readings != self.readings[-1], axis=1))
        first = int(changed[-1]) + 1 if len(changed) else 0
        if len(self.readings) - first < FEWEST_LINES:
            return None
        samples = self.counts[self.places[first, -1] : self.places[-1, 0]]
        if len(samples) < 2 or np.ptp(samples, axis=0).max() <= 8.0 * self.gross:
            return None
        since = f" after {self.time_s[first]:.0f} s" if first else ""
        return SampleFault(
            f"frozen samples of the {self.sensor}{since}: one value, while {len(samples)} others were delivered",
            _FRESH.format(self.sensor),
        )

    def _scale(self) -> SampleFault | None:
        """Return the fault of readings that are samples by another scale, the same or another one for each axis."""
        best: tuple[float, Array] = (0.0, np.ones(3))
        for size in range(1, self._most + 1):
            means = self._means(self.counts, size)
            factors = (means * self.readings[:, None]).sum(axis=0) / (means**2).sum(axis=0)  # (lags, 3)
            factor = factors[np.abs(factors * means - self.readings[:, None]).sum(axis=(0, 2)).argmin()]
            for _ in range(3):
                away = np.abs(factor * means - self.readings[:, None]).max(axis=2)
                nearest = means[np.arange(len(means)), away.argmin(axis=1)]
                factor = (nearest * self.readings).sum(axis=0) / (nearest**2).sum(axis=0)
            tolerance = max(self.exact, float(np.abs(factor).max()) * self.gross)
            best = max(best, (float((away.min(axis=1) <= tolerance).mean()), factor), key=lambda pair: pair[0])
        share, factor = best
        if share < 1.0 - _BETTER or factor.min() <= 0.0:
            return None
        if np.ptp(factor) <= 0.01 * abs(factor[0]):
            words = f"the {self.sensor} is {factor.mean():.3g} times what was delivered"
        else:
            parts = ", ".join(f"{name} {one:.3g}" for name, one in zip("xyz", factor, strict=True))
            words = f"the axes of the {self.sensor} are multiples of what was delivered ({parts})"
        return SampleFault(words, _UNIT.format(self.sensor))

    def _corrupt(self, *, is_moving: bool) -> list[SampleFault]:
        """Return the fault of single samples that are corrupt in the readings."""
        away = {size: self._away(size) for size in range(1, self._most + 1)}
        if away[self.size].max() <= self.gross:
            return []
        right = {size: float((away[size] <= self.exact).mean()) for size in away}
        likely = max(right, key=lambda size: right[size])
        best: tuple[float, str, str, float] = (0.0, "", "", 0.0)
        for size in [likely] if right[likely] >= _SHARE_OF_RIGHT else away:
            wrong = np.flatnonzero(away[size] > self.exact)
            chosen = wrong[:: 1 + len(wrong) // _MOST_WRONG]
            last = self.places[chosen][:, :, None] - 1 - np.arange(size)  # (lines, lags, samples of a mean)
            counts, before = self.counts[last], self.counts[np.maximum(last - 1, 0)]
            rest = size * (self.readings[chosen, None] - self._means(self.counts, size)[chosen])[:, :, None]
            for words, place, corrupt in _CORRUPT:
                left = np.min([np.abs(rest - (sample - counts)) for sample in corrupt(counts, before)], axis=0)
                explained = float((left.max(axis=3).min(axis=(1, 2)) <= size * self.exact).mean())
                if explained > best[0] + _BETTER:
                    best = explained, words, place, len(wrong) / len(self.readings) / size
        explained, words, place, share = best
        if explained >= _HOLDS:
            return [
                SampleFault(
                    f"corrupt samples: about {_percent(share)} of the {self.sensor}'s {words}",
                    place.format(self.sensor),
                )
            ]
        is_far, largest = away[self.size] > _FAR * self.gross, float(away[self.size].max()) / self.unit[0]
        if is_moving or not 0.0 < is_far.mean() <= _MOST_ISOLATED:  # a filter of the readings may make the difference
            return []
        words = f"corrupt samples: {_percent(is_far.mean())} of the {self.sensor}'s readings are not as delivered"
        return [SampleFault(f"{words}, by up to {largest:.3g} {self.unit[1]}", _WHOLE.format(self.sensor))]


def _percent(share: float) -> str:
    return f"{100.0 * share:.2g} %"


def _statistics(sensor: str, unit: tuple[float, str], lines: Lines, *, is_moving: bool) -> list[SampleFault]:
    """Return the faults that readings alone show."""
    readings, (per_unit, name) = lines.counts, unit
    ranges = np.ptp(readings, axis=0)
    if not ranges.any():
        words = f"frozen samples of the {sensor}: one value in {len(readings)} readings"
        return [SampleFault(words, _FRESH.format(sensor))]
    faults = [
        SampleFault(
            f"the {'xyz'[axis]} axis of the {sensor} does not move: it stays at "
            f"{np.median(readings[:, axis]) / per_unit:.3g} {name}",
            _DRIVER.format(sensor),
        )
        for axis in np.flatnonzero(ranges <= _STILL * ranges.max())
        if is_moving
    ]
    zeros = ~readings.any(axis=1)
    if zeros.any():
        words = f"corrupt samples: {_percent(zeros.mean())} of the {sensor}'s are 0, 0, 0"
        return [*faults, SampleFault(words, _WHOLE.format(sensor))]
    if not is_moving or faults:
        return faults
    limits = [
        (readings[:, axis] == end).mean()
        for axis in range(3)
        for end in (readings[:, axis].min(), readings[:, axis].max())
        if (readings[:, axis] == end).sum() >= _FEWEST_AT_A_LIMIT
    ]
    if max(limits, default=0.0) >= _SHARE_AT_A_LIMIT:
        words = f"the {sensor} is clipped at {np.abs(readings).max() / per_unit:.4g} {name}"
        return [SampleFault(words, _RANGE.format(sensor))]
    away = np.abs(readings[1:-1] - 0.5 * (readings[:-2] + readings[2:])).max(axis=1)
    share = float((away > _STICKS_OUT * np.median(away)).mean())
    if 0.0 < share <= _MOST_ISOLATED:
        words = f"corrupt samples: {_percent(share)} of the {sensor}'s readings stick out from those beside them"
        return [SampleFault(words, _WHOLE.format(sensor))]
    return []
