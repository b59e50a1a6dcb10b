"""Part of a log in time: chosen by hand, or the longest in which the field does not change."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from hiltest.calibration.change import find_change, find_growth
from hiltest.calibration.robust import repeats
from hiltest.errors import ConfigError
from hiltest.log_fitting.samples import Samples

# Limit of the median distance of neighbours relative to that of any two readings. Without order the ratio is 1, within
# 0.2 for 40 readings; a sensor that turns by 45 degrees between readings has 0.55.
_CLOSER, _FEWEST_ORDERED = 0.75, 40
# Largest ball of noise, in parts of the reading, and the least spread of distances from its middle: 0.42 if it is
# normal in space, 0.76 on a line; on a sphere about any middle the distances are more equal.
_SMALL_PART, _BALL = 0.1, 0.3


@dataclass(frozen=True, slots=True)
class FieldChange:
    """A step of the hard iron in the middle of a log."""

    at: float
    """Instant: seconds from the first reading of the file, or without times the number of the reading, from 1."""
    at_unit: str
    """``s`` or ``reading``."""
    percent: float
    """Length of the step relative to the radius."""

    @property
    def when(self) -> str:
        """The instant in words."""
        return f"at {self.at:.4g} s" if self.at_unit == "s" else f"at reading {self.at:.0f}"


def instants(samples: Samples) -> tuple[NDArray[np.float64], str]:
    """Return the instant of each reading, shape (n,): seconds from the log's first, or numbers from 1 without times."""
    times = samples.time_s
    if times is None or not times[-1] > times[0]:
        return samples.start + np.arange(1.0, len(samples.points) + 1.0), "reading"
    return samples.start + times - times[0], "s"


def between(samples: Samples, first: float | None, last: float | None) -> Samples:
    """Return the readings from `first` up to but excluding `last`; both as in `instants`.

    Raises
    ------
    ConfigError
        When there are none.
    """
    at, unit = instants(samples)
    low, high = at[0] if first is None else first, np.inf if last is None else last
    selected = np.flatnonzero((at >= low) & (at < high))
    if not len(selected):
        raise ConfigError(
            f"{samples.path}: no reading from {low:g} to {high:g}; there are some from {at[0]:g} to {at[-1]:g} "
            f"({'seconds from the first' if unit == 's' else 'numbers of the readings, as no column has their time'})"
        )
    start = float(at[selected[0]]) - (0.0 if unit == "s" else 1.0)
    return replace(rows(samples, selected), start=start)


def rows(samples: Samples, selected: NDArray[np.intp] | NDArray[np.bool_]) -> Samples:
    """Return some of the readings with all their attributes."""
    of_rows = {
        name: value[selected]
        for name in ("points", "lines", "time_s", "acceleration")
        if (value := getattr(samples, name)) is not None
    }
    return replace(samples, **of_rows)


def is_in_order_of_time(samples: Samples) -> bool:
    """Return whether a reading is closer to the next than to any other, as in a log of a sensor that turns."""
    points = samples.points
    steps = np.linalg.norm(np.diff(points, axis=0), axis=1)
    # Any other reading, because at a fixed distance in time a periodic turn would repeat.
    others = np.linalg.norm(points - np.random.default_rng(0).permutation(points), axis=1)
    return len(points) < _FEWEST_ORDERED or float(np.median(steps)) < _CLOSER * float(np.median(others))


def field_change(samples: Samples) -> FieldChange | None:
    """Return the step of the hard iron that explains the samples best; None if none does."""
    row = _change(samples.points)
    if row is None:
        return None
    at, unit = instants(samples)
    return FieldChange(float(at[row[0]]), unit, row[1])


def field_growth(samples: Samples) -> float | None:
    """Return the growth of the field's strength over the samples, relative to its middle [%]; None without one."""
    return find_growth(samples.points[~repeats(samples.points)])


def is_at_rest(samples: Samples) -> bool:
    """Return whether the readings are a small ball of noise: a sensor that lies still."""
    off = np.linalg.norm(samples.points - samples.points.mean(axis=0), axis=1)
    size, spread = float(off.mean()), float(off.std())
    is_small = size < _SMALL_PART * float(np.linalg.norm(samples.points, axis=1).mean())
    return is_small and spread > _BALL * size and not is_in_order_of_time(samples)


def steady(samples: Samples) -> tuple[float, float]:
    """Return the longest part without a change: its first instant, and the first one after it."""
    at, _ = instants(samples)
    parts, changes = [(0, len(samples.points))], [(0, 0)]
    while parts:
        start, end = parts.pop()
        change = _change(samples.points[start:end])
        if change is None:
            changes.append((start, end))
        else:
            parts += [(start, start + change[0]), (start + change[0], end)]
    start, end = max(changes, key=lambda part: part[1] - part[0])
    return float(at[start]), float(at[end]) if end < len(at) else np.inf


def _change(points: NDArray[np.float64]) -> tuple[int, float] | None:
    distinct = np.flatnonzero(~repeats(points))
    change = find_change(points[distinct])
    return None if change is None else (int(distinct[change.row]), change.percent)
