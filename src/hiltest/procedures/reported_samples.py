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
from itertools import combinations, permutations, product
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
_MOVES = 50.0  # range of samples that move, as a multiple of a gross deviation
_ROUNDING = 0.6  # deviation by rounding, in units of the last digit
_HOLDS = 0.6  # share of lines for which a relation must hold
_BETTER = 0.02  # share of lines by which a relation must be better than a simpler one
_CLIPPED = 0.02  # samples beyond an end at which they are clipped, as a share of their range
_STILL = 0.05  # range of an axis that does not move, as a share of that of the samples
_FEWEST_AT_A_LIMIT, _SHARE_AT_A_LIMIT = 4, 0.02
_MOST_ISOLATED = 0.3
_SHARE_OF_RIGHT = 0.1  # share of exact readings that shows how many samples a reading is the mean of
_MOST_WRONG = 40
_MOST_COMBINED = 12
_STICKS_OUT = 10.0  # deviation of an outlier from its neighbours, as a multiple of the median deviation
_RETURNS = 0.3  # difference of the neighbours of an outlier, as a share of its deviation
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
    """A fault of the samples of a sensor."""

    words: str
    place: str
    """Part of the firmware to check."""


def _fault(sensor: str, words: str, place: str) -> SampleFault:
    return SampleFault(words.format(sensor), place.format(sensor))


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
        faults = best.faults() if best else []
    return tuple(faults)


def merge_faults(first: Sequence[SampleFault], second: Sequence[SampleFault] = ()) -> tuple[SampleFault, ...]:
    """Return the faults of a magnetometer and those of an accelerometer, one of both if they have the same."""
    names = "magnetometer", "accelerometer"
    second_by_words = {fault.words.replace(names[1], names[0]): fault for fault in second}
    merged = []
    for fault in first:
        other = second_by_words.pop(fault.words, None)
        words = fault.words.replace(names[0], " and the ".join(names)) if other else fault.words
        merged.append(SampleFault(words, fault.place))
    return (*merged, *second_by_words.values())


# Relations of an axis: a name with a place, and the samples as the firmware has them.
_Relation: TypeAlias = tuple[str, str, Array]


def _exchange_bytes(counts: Array, shift: int) -> Array:
    words = np.asarray(counts / 2**shift, dtype=np.int64).astype(np.int16)
    return np.asarray(words.byteswap().astype(np.float64) * 2**shift)


def _relations(counts: Array, readings: Array, unit: tuple[float, str]) -> Iterator[_Relation]:
    """Return the relations that are tried for an axis, the simplest first."""
    per_unit, name = unit
    for low, high in ((readings.min(), readings.max()), (-np.abs(readings).max(), np.abs(readings).max())):
        is_beyond = counts.min() < low - _CLIPPED * np.ptp(counts), counts.max() > high + _CLIPPED * np.ptp(counts)
        ends = [f"{end / per_unit:.4g}" for end, beyond in zip((low, high), is_beyond, strict=True) if beyond]
        words = f"+-{ends[1]}" if low == -high and len(ends) == 2 else " and ".join(ends)
        yield f"is clipped at {words} {name}", _RANGE, np.clip(counts, low, high)
    for bits in range(17, 5, -1):
        period = 2.0**bits
        half = period / 2.0
        yield f"overflows at +-{half / per_unit:.4g} {name}, {period:g} counts", _TYPE, (counts + half) % period - half
        words = f"is read as unsigned, negative values are {period / per_unit:.4g} {name} more"
        yield from ((words, _TYPE, wrapped) for wrapped in (counts % period, -(-counts % period)))
    for shift in range(3):
        for one in (_exchange_bytes(counts, shift), -_exchange_bytes(-counts, shift)):
            yield "has its two bytes exchanged", _BYTES, one
    yield "has lost its sign", _TYPE, np.abs(counts)
    for bits in range(4, 13):
        step = 2.0**bits
        words = f"has lost its low bits, steps of {step / per_unit:.4g} {name}"
        yield from ((words, _TYPE, step * cut(counts / step)) for cut in (np.floor, np.ceil, np.trunc))


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


# Corrupt single samples: a name with a place, and the values that an axis may hold in place of the right sample.
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
        samples_per_line = int(np.median(np.diff(np.unique(ends)))) if len(np.unique(ends)) > 1 else 1
        self._most = min(_MOST_IN_A_MEAN, samples_per_line + samples_per_line // 4 + 1)
        places = ends[:, None] - lags
        is_last = np.append(np.diff(lines.time_s) > 0.0, True)  # others of the same reading may have waited
        used = np.flatnonzero(is_last & (places[:, -1] >= self._most))
        used = used[:: 1 + len(used) // _MOST_LINES]
        first = max(int(places[used].min(initial=len(samples))) - self._most - 1, 0)  # those before are of no use
        self.places, self.readings, self.time_s = places[used] - first, lines.counts[used], lines.time_s[used]
        self.counts = samples[first:, 1:]
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

    def faults(self) -> list[SampleFault]:
        """Return the faults, those of whole axes first."""
        if not len(self.readings):
            return []
        sample_ranges = np.ptp(self._means(self.counts, 1), axis=(0, 1))
        if sample_ranges.max() <= _MOVES * self.gross:
            return []
        if frozen := self._frozen():
            return frozen
        ranges = np.ptp(self.readings, axis=0) / min(
            1.0, float(np.ptp(self.readings, axis=0).max() / sample_ranges.max())
        )
        moves = sample_ranges > _MOVES * self.gross
        still = [axis for axis in range(3) if moves[axis] and ranges[axis] <= _STILL * sample_ranges[axis]]
        if any(
            relation[0].startswith("is clipped") for axis, (*_, relation) in enumerate(self.axes) if axis not in still
        ):
            still = []  # it stays at the same end
        faults = [_still_axis(self.sensor, self.unit, self.readings, axis) for axis in still]
        moving_axes = [self.axes[axis] for axis in range(3) if axis not in still]
        holds = all(share >= _HOLDS for share, *_ in moving_axes)
        is_plain = holds and not any(relation[0] for *_, relation in moving_axes)
        if not is_plain and not still and (scaled := self._scale()):
            return scaled
        if still or not is_plain:
            return faults + (self._axis_faults(still) if holds else [] if still else self._corrupt())
        sources = [(source, sign) for _, source, sign, _ in moving_axes]
        if sources == [(0, 1.0), (1, 1.0), (2, 1.0)]:
            return self._corrupt()
        words = f"axes of the {{}} (x, y and z are {_axes_in_words(*zip(*sources, strict=True))})"
        return [_fault(self.sensor, words, _DRIVER)]

    def _axis_faults(self, still: Sequence[int]) -> list[SampleFault]:
        """Return the relations of the axes that move, one fault for those with the same."""
        by_words: dict[tuple[str, str], list[str]] = {}
        for axis, (_, _, _, (words, place, _)) in zip("xyz", self.axes, strict=True):
            if words and "xyz".index(axis) not in still:
                by_words.setdefault((words, place), []).append(axis)
        faults = []
        for (words, place), names in by_words.items():
            which = "" if len(names) == 3 else f"{' and '.join(names)} {'axes' if len(names) > 1 else 'axis'} of the "
            verb, _, rest = words.partition(" ")
            if len(names) == 2:
                verb = {"is": "are", "has": "have", "overflows": "overflow"}[verb]
                rest = f" {rest}".replace(" its ", " their ")[1:]
            faults.append(_fault(self.sensor, f"the {which}{{}} {verb} {rest}", place))
        return faults

    def _frozen(self) -> list[SampleFault]:
        """Return the fault of readings that stay the same at the end while the samples change."""
        changed = np.flatnonzero(np.any(self.readings != self.readings[-1], axis=1))
        first = int(changed[-1]) + 1 if len(changed) else 0
        if len(self.readings) - first < FEWEST_LINES:
            return []
        samples = self.counts[self.places[first, -1] : self.places[-1, 0]]
        if np.ptp(self._means(self.counts, 1)[first:], axis=(0, 1)).max() <= _MOVES * self.gross:
            return []
        since = f" after {self.time_s[first]:.0f} s" if first else ""
        words = f"frozen samples of the {{}}{since}: one value, while {len(samples)} others were delivered"
        return [_fault(self.sensor, words, _FRESH)]

    def _scale(self) -> list[SampleFault]:
        """Return the fault of readings that are multiples of the samples, or that have an offset."""
        readings, best = self.readings[:, None], (0.0, "")
        for size, is_factor in product(range(1, self._most + 1), (True, False)):
            means = self._means(self.counts, size)
            nearest, value, away = means, np.zeros(3), np.zeros(())
            for step in range(4):
                if is_factor:
                    value = (nearest * readings).sum(axis=0) / (nearest**2).sum(axis=0)
                else:
                    value = (readings - nearest).mean(axis=0)
                away = np.abs((value * means if is_factor else means + value) - readings)
                if not step:  # the lag that is the best one for all
                    value = value[away.sum(axis=(0, 2)).argmin()]
                    away = np.abs((value * means if is_factor else means + value) - readings)
                nearest = means[np.arange(len(means)), away.max(axis=2).argmin(axis=1)][:, None]
                value = value.reshape(3)
            gross = self.gross * (float(np.abs(value).max()) if is_factor else 1.0)
            share = float((away.max(axis=2).min(axis=1) <= max(self.exact, gross)).mean())
            if share <= best[0] or share < 1.0 - _BETTER or (is_factor and value.min() <= 0.0):
                continue
            if is_factor and np.ptp(value) <= 0.01 * value[0]:
                best = share, f"the {{}} is {value.mean():.3g} times what was delivered"
                continue
            parts = value if is_factor else value / self.unit[0]
            sizes = ", ".join(f"{name} {part:.2f}" for name, part in zip("xyz", parts.round(2) + 0.0, strict=True))
            sizes_in_words = f"multiples ({sizes})" if is_factor else f"an offset ({sizes} {self.unit[1]})"
            best = share, f"the axes of the {{}} have {sizes_in_words} beside what was delivered"
        return [_fault(self.sensor, best[1], _UNIT)] if best[1] else []

    def _corrupt(self) -> list[SampleFault]:
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
            rest = size * (self.readings[chosen, None] - self._means(self.counts, size)[chosen])
            for words, place, corrupt in _CORRUPT:
                options = corrupt(counts, before)
                sets = [[one] for one in range(size)]
                if len(options) == 1 and size <= _MOST_COMBINED:  # several samples of a mean may be corrupt
                    sets = [list(some) for number in (1, 2, 3) for some in combinations(range(size), number)]
                differences = [option - counts for option in options]
                remainders = np.stack(
                    [
                        np.min([np.abs(rest - one[:, :, some].sum(axis=2)) for one in differences], axis=0).max(axis=2)
                        for some in sets
                    ],
                    axis=-1,
                ).min(axis=1)  # (lines, sets)
                explained = float((remainders.min(axis=1) <= size * self.exact).mean())
                if explained > best[0] + _BETTER:
                    in_line = np.mean([len(sets[index]) for index in remainders.argmin(axis=1)])
                    best = explained, words, place, float(in_line) * len(wrong) / len(self.readings) / size
        explained, words, place, share = best
        if explained >= _HOLDS:
            return [_fault(self.sensor, f"corrupt samples: about {_percent(share)} of the {{}}'s {words}", place)]
        share, largest = (away[self.size] > _FAR * self.gross).mean(), away[self.size].max() / self.unit[0]
        if not share:
            return []
        words = f"{_percent(share)} of the {{}}'s readings are not as delivered, by up to {largest:.3g} {self.unit[1]}"
        is_isolated = share <= _MOST_ISOLATED
        words = f"corrupt samples: {words}" if is_isolated else f"{words} (a filter or another conversion)"
        return [_fault(self.sensor, words, _WHOLE if is_isolated else _UNIT)]


def _still_axis(sensor: str, unit: tuple[float, str], readings: Array, axis: int) -> SampleFault:
    value = f"{np.median(readings[:, axis]) / unit[0]:.3g} {unit[1]}"
    return _fault(sensor, f"the {'xyz'[axis]} axis of the {{}} does not move: it stays at {value}", _DRIVER)


def _percent(share: float | np.floating) -> str:
    return f"{100.0 * share:.2g} %"


def _statistics(sensor: str, unit: tuple[float, str], lines: Lines, *, is_moving: bool) -> list[SampleFault]:
    """Return the faults that readings alone show."""
    readings, ranges = lines.counts, np.ptp(lines.counts, axis=0)
    if not ranges.any() and (is_moving or sensor == "magnetometer"):  # gravity stays at level poses
        words = f"frozen samples of the {{}}: one value in {len(readings)} readings"
        return [_fault(sensor, words, _FRESH)]
    still = np.flatnonzero(ranges <= _STILL * ranges.max()) if is_moving else ()
    faults = [_still_axis(sensor, unit, readings, int(axis)) for axis in still]
    if share := (~readings.any(axis=1)).mean():
        return [_fault(sensor, f"corrupt samples: {_percent(share)} of the {{}}'s are 0, 0, 0", _WHOLE)]
    if not is_moving or faults:
        return faults
    limit = np.abs(readings).max()  # a board that rests in one position reaches one end of an axis often, not two
    at_ends = [(readings == end).sum(axis=0) for end in (limit, -limit)]
    if sum(int((count >= max(_FEWEST_AT_A_LIMIT, _SHARE_AT_A_LIMIT * len(readings))).sum()) for count in at_ends) > 1:
        words = f"the {{}} is clipped at {limit / unit[0]:.4g} {unit[1]}"
        return [_fault(sensor, words, _RANGE)]
    away = np.abs(readings[1:-1] - 0.5 * (readings[:-2] + readings[2:])).max(axis=1)
    returns = np.abs(readings[2:] - readings[:-2]).max(axis=1) < _RETURNS * away  # a turn does not
    share = (returns & (away > _STICKS_OUT * np.median(away))).mean()
    if not 0.0 < share <= _MOST_ISOLATED:
        return []
    words = f"corrupt samples: {_percent(share)} of the {{}}'s readings stick out from those beside them"
    return [_fault(sensor, words, _WHOLE)]
