"""Magnetometer samples from a file."""

from __future__ import annotations

import math
from array import array
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from hiltest.errors import ConfigError
from hiltest.recordings.columns import (
    ACCELEROMETER_STEM,
    MICROTESLA,
    Unit,
    axis_triples,
    guessed_columns,
    named_columns,
    seconds_of,
    unit_in_headers,
    unit_of,
)
from hiltest.recordings.table import (
    LARGEST_READING,
    TableRow,
    check_width,
    number_in,
    number_or_nan,
    read_rows,
    split_header,
)
from hiltest.units import ACCELERATION_WORDS, AccelerationUnit

Reals = NDArray[np.float64]

# 24 MB of numbers, and three hours of a sensor at 80 Hz.
MAX_ROWS = 1_000_000
_AXES = 3
# Nanoseconds of 3000 years: the largest time that a clock gives.
_LATEST = 1e20


@dataclass(frozen=True, slots=True, eq=False)
class Samples:
    """Samples of one magnetometer.

    Attributes
    ----------
    path : Path
    points : ndarray, shape (n, 3)
        In `unit`, sensor frame, in the order of the file.
    unit : Unit
    unit_from : str
        ``option``, ``header``, or ``assumed`` when neither names it.
    columns : tuple of str
        Names of the three columns, or their numbers from 1.
    skipped : int
        Rows without three finite numbers.
    lines : ndarray, shape (n,), or None
        Line of the file of each sample. None: not from a file.
    time_s : ndarray, shape (n,), or None
        Time of each sample, not decreasing [s]. None where no column is one of time, or its times go back.
    acceleration : ndarray, shape (n, 3), or None
        What the accelerometer read in the same rows, in `acceleration_unit`, its own axes; NaN in a row without three
        numbers of it. None where the file has none.
    acceleration_unit : AccelerationUnit
    preamble : int
        Lines before the table that are no part of it.
    start : float
        Of a part of a log: how long after the log's first reading it begins [s], or after how many without times.
    """

    path: Path
    points: Reals
    unit: Unit
    unit_from: str
    columns: tuple[str, str, str]
    skipped: int
    lines: NDArray[np.int64] | None = None
    time_s: Reals | None = None
    acceleration: Reals | None = None
    acceleration_unit: AccelerationUnit = AccelerationUnit.COUNTS
    preamble: int = 0
    start: float = 0.0

    @property
    def microtesla(self) -> float | None:
        """Size of one `unit` [uT], None when it is unknown."""
        return MICROTESLA[self.unit]


@dataclass(frozen=True, slots=True)
class _Layout:
    """Which columns are what.

    Attributes
    ----------
    width : int
    places, names : of the magnetometer's columns
    accelerometer : places of the accelerometer's columns, empty without one
    strict : bool
        Whether a cell of the accelerometer that is no number is refused: where an option names its columns.
    time : place of the column of time, and what one of it is in seconds; None without one
    """

    width: int
    places: tuple[int, int, int]
    names: tuple[str, str, str]
    accelerometer: tuple[int, ...]
    accelerometer_names: tuple[str, ...]
    strict: bool
    time: tuple[int, float] | None


def read_samples(
    path: Path, *, columns: str | None = None, unit: Unit | None = None, accelerometer_columns: str | None = None
) -> Samples:
    """Read magnetometer samples from a text table.

    Parameters
    ----------
    path : Path
        Comma, semicolon, tab or blanks between cells; decimal points; with or without a header.
    columns : str, optional
        ``a,b,c``, names or numbers from 1; by default those that the header calls a magnetometer's.
    unit : Unit, optional
        By default what the header says, else counts.
    accelerometer_columns : str, optional
        As `columns`; by default those that the header calls an accelerometer's, where these are three.

    Raises
    ------
    ConfigError
        When there is no such table in the file; names file, line and column.
    """
    rows = read_rows(path)
    first = next(rows, None)
    if first is None:
        raise ConfigError(f"{path}: the file is empty")
    headers, data = split_header(first, rows)
    width = len(headers or first.cells)
    try:
        layout = _layout(headers, width, columns, accelerometer_columns)
        unit_found = unit or unit_of(layout.names if headers else ())
        acceleration_unit = _acceleration_unit(layout) if headers else AccelerationUnit.COUNTS
    except ConfigError as error:
        raise ConfigError(f"{path}: {error}") from error
    numbers, lines, skipped = _numbers(path, data, layout)
    acceleration = numbers[:, _AXES : 2 * _AXES] if layout.accelerometer else None
    return Samples(
        path, numbers[:, :_AXES].copy(), unit_found or Unit.COUNTS,
        "option" if unit else "header" if unit_found else "assumed", layout.names, skipped,
        lines=lines, time_s=_rising(numbers[:, -1], layout.time),
        acceleration=None if acceleration is None or np.isnan(acceleration).any(axis=1).all() else acceleration.copy(),
        acceleration_unit=acceleration_unit,
    )  # fmt: skip


def _layout(headers: Sequence[str], width: int, columns: str | None, accelerometer_columns: str | None) -> _Layout:
    def called(places: Sequence[int]) -> tuple[str, ...]:
        return tuple(headers[place] if headers else str(place + 1) for place in places)

    places = named_columns(columns, headers, width) if columns is not None else guessed_columns(headers, width)
    accelerometer: tuple[int, ...] = ()
    if accelerometer_columns is not None:
        accelerometer = named_columns(accelerometer_columns, headers, width, option="--accelerometer-columns")
    else:
        triples = [each for stem, each in axis_triples(headers).items()
                   if ACCELEROMETER_STEM.search(stem) and not set(each) & set(places)]
        accelerometer = triples[0] if len(triples) == 1 else ()
    times = [(place, scale_s) for place, header in enumerate(headers)
             if (scale_s := seconds_of(header)) is not None and place not in places]
    x, y, z = called(places)
    return _Layout(width, places, (x, y, z), accelerometer, called(accelerometer), accelerometer_columns is not None,
                   times[0] if len(times) == 1 else None)


def _acceleration_unit(layout: _Layout) -> AccelerationUnit:
    """Return the unit that the header names; only its ratio to itself matters, so an unknown one is as good."""
    try:
        found = unit_in_headers(layout.accelerometer_names, ACCELERATION_WORDS, "--accelerometer-columns")
    except ConfigError:
        return AccelerationUnit.COUNTS
    return found or AccelerationUnit.COUNTS


def _numbers(path: Path, rows: Iterator[TableRow], layout: _Layout) -> tuple[Reals, NDArray[np.int64], int]:
    """Return a row a sample: x, y, z, the accelerometer's where there is one, the time; their lines; rows skipped."""
    values, lines, skipped = array("d"), array("q"), 0
    for row in rows:
        check_width(path, row, layout.width)
        reading = [
            number_in(path, row, place, name, what="magnetometer reading")
            for place, name in zip(layout.places, layout.names, strict=True)
        ]
        if not all(map(math.isfinite, reading)):
            skipped += 1
            continue
        values.extend(reading)
        values.extend(_acceleration(path, row, layout))
        values.append(math.nan if layout.time is None else number_or_nan(row.cells[layout.time[0]], _LATEST))
        lines.append(row.line)
        if len(lines) > MAX_ROWS:
            raise ConfigError(f"{path}: more than {MAX_ROWS} readings; keep every tenth line, or cut the file")
    if not lines:
        raise ConfigError(f"{path}: no row has three numbers in the columns {', '.join(layout.names)}")
    count = _AXES + len(layout.accelerometer) + 1
    return (np.frombuffer(values, dtype=np.float64).reshape(-1, count), np.frombuffer(lines, dtype=np.int64), skipped)


def _acceleration(path: Path, row: TableRow, layout: _Layout) -> list[float]:
    if layout.strict:
        return [number_in(path, row, place, name, what="accelerometer reading")
                for place, name in zip(layout.accelerometer, layout.accelerometer_names, strict=True)]
    return [number_or_nan(row.cells[place], LARGEST_READING) for place in layout.accelerometer]


def _rising(times: Reals, column: tuple[int, float] | None) -> Reals | None:
    """Return times in seconds; None where one is missing or before the one before it."""
    if column is None or not bool((np.diff(times, prepend=times[0]) >= 0.0).all()):
        return None
    return times * column[1]
