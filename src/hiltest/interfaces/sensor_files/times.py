"""Columns of time: their names, clocks in their cells, and their unit, which their steps show if no name has it."""

from __future__ import annotations

import math
import re
from collections.abc import Sequence
from contextlib import suppress
from datetime import datetime
from pathlib import Path
from typing import NamedTuple

import numpy as np

from hiltest.errors import ConfigError
from hiltest.interfaces.sensor_files.cells import Reals, TableRow, is_number, number_in
from hiltest.interfaces.sensor_files.columns import column_index, seconds_of

#: Largest time: 3000 years in nanoseconds.
LATEST = 1e20
_NAMES_S = {"seconds": 1.0, "milliseconds": 1e-3, "microseconds": 1e-6, "nanoseconds": 1e-9}
_DAY_S = 86_400.0
_EPOCH = datetime(1970, 1, 1)
_DATES = ("%Y-%m-%d", "%d-%b-%Y", "%d/%m/%Y", "%Y/%m/%d", "%d.%m.%Y")
_CLOCK = re.compile(
    r"(?:(?P<date>[\w./-]{8,11})[T ,]\s*)?(?P<h>\d{1,2}):(?P<m>\d\d):(?P<s>\d\d(?:[.,]\d{1,9})?)\s?"
    r"(?:Z|[+-]\d\d:?\d\d)?$"
)
# Longest and shortest usual step: a logger writes once or twice a second to 1600 times, mostly about 50 times.
_USUAL_STEP_S = 0.02
_LONGEST_STEP_S = 2.5


class TimeColumn(NamedTuple):
    """A column of time."""

    place: int
    unit_s: float
    """Unit of its numbers [s]."""
    note: str = ""
    """Sentence about the unit if it was inferred from the steps."""
    is_clock: bool = False
    """True for hours, minutes and seconds."""


def clock_s(cell: str) -> float:
    """Return the time of a cell like 2024-03-05T10:00:00.02Z or 10:00:00.02 [s]; NaN for another text."""
    matched = _CLOCK.match(cell)
    if matched is None:
        return math.nan
    seconds_s = 3600.0 * int(matched["h"]) + 60.0 * int(matched["m"]) + float(matched["s"].replace(",", "."))
    for form in _DATES if matched["date"] else ():
        with suppress(ValueError):
            return _DAY_S * (datetime.strptime(matched["date"], form) - _EPOCH).days + seconds_s
    return seconds_s


def time_or_nan(cell: str) -> float:
    """Return the number of a cell, or the seconds of its clock; NaN for another text."""
    value = float(cell) if is_number(cell) else clock_s(cell)
    return value if abs(value) <= LATEST else math.nan


class RowTimes:
    """Times of a table's rows, which are read in turn."""

    def __init__(self, path: Path, column: TimeColumn, name: str) -> None:
        self.place, self._path, self._name, self._is_clock = column.place, path, name, column.is_clock
        self._last, self._days_s = -math.inf, 0.0

    def read(self, row: TableRow) -> float:
        """Return the number of a row, or the seconds of its clock, with a day added behind each midnight.

        Raises
        ------
        ConfigError
            When it is something else; the message has file, line and column.
        """
        value = clock_s(row.cells[self.place]) if ":" in row.cells[self.place] else math.nan
        if math.isnan(value):
            value = number_in(self._path, row, self.place, self._name, quantity="time", largest=LATEST)
        if not math.isfinite(value):
            raise ConfigError(f"{self._path}:{row.line}: column {self._name}: no number: every row needs its time")
        if self._is_clock and value < self._last - 0.5 * _DAY_S:
            self._days_s += _DAY_S
        elif self._is_clock and self._days_s and value > self._last + 0.5 * _DAY_S:  # a late row of the day before
            self._days_s -= _DAY_S
        self._last = value
        return value + self._days_s


def time_columns(headers: Sequence[str], rows: Sequence[Sequence[str]], but: Sequence[int] = ()) -> list[TimeColumn]:
    """Return the columns that a header calls times: only those with a unit, if there are any.

    Parameters
    ----------
    rows
        First rows of cells.
    but
        Columns that have another meaning.
    """
    units = {place: unit for place, name in enumerate(headers) if (unit := seconds_of(name)) and place not in but}
    places = [place for place, unit in units.items() if not math.isnan(unit)] or list(units)
    return [time_column(headers, rows, place) for place in places]


def the_time(
    headers: Sequence[str], rows: Sequence[Sequence[str]], named: str | None, option: str, otherwise: str
) -> TimeColumn:
    """Return the column of time that an option names, or else the only one of the header.

    Raises
    ------
    ConfigError
        When there is not exactly one; the message ends with `otherwise`.
    """
    if named is not None:
        return time_column(
            headers, rows, column_index(named, headers, len(rows[0]) if rows else len(headers), option=option)
        )
    columns = time_columns(headers, rows)
    if len(columns) != 1:
        raise ConfigError(f"{len(columns) or 'no'} columns of time; {otherwise}")
    return columns[0]


def time_column(headers: Sequence[str], rows: Sequence[Sequence[str]], place: int) -> TimeColumn:
    """Return a column of time with its unit, from its name or from the steps of the first rows."""
    cells = [row[place] for row in rows if row[place]]
    if cells and not any(map(is_number, cells)):
        return TimeColumn(place, 1.0, is_clock=True)
    unit_s = seconds_of(headers[place]) if headers else None
    if unit_s is not None and not math.isnan(unit_s):
        return TimeColumn(place, unit_s)
    times = np.array([time_or_nan(cell) for cell in cells])
    steps = np.diff(times)
    steps = steps[np.isfinite(steps) & (steps > 0.0)]
    if not len(steps):
        return TimeColumn(place, 1.0)
    step = float(np.median(steps))
    if step <= _LONGEST_STEP_S and bool((times % 1.0 != 0.0).any()):
        return TimeColumn(place, 1.0)
    unit, unit_s = min(_NAMES_S.items(), key=lambda item: abs(math.log(step * item[1] / _USUAL_STEP_S)))
    name = headers[place] if headers else str(place + 1)
    return TimeColumn(place, unit_s, f"Times in column {name} were taken as {unit}: their usual step is {step:.6g}.")


def unwrap_midnights(times_s: Reals) -> Reals:
    """Return times of a clock without a date, with a day added behind each midnight."""
    return times_s + _DAY_S * np.cumsum(np.diff(times_s, prepend=times_s[:1]) < -0.5 * _DAY_S)
