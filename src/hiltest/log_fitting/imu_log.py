"""Readings of an accelerometer and a gyroscope from one table, or from one each."""

from __future__ import annotations

import math
import re
from array import array
from collections.abc import Collection, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from hiltest.errors import ConfigError
from hiltest.interfaces.sensor_files.cells import LARGEST_READING, TableRow, number_in
from hiltest.interfaces.sensor_files.columns import (
    ACCELEROMETER_STEM,
    GYROSCOPE_STEM,
    axis_triples,
    column_index,
    named_columns,
    unit_in_headers,
)
from hiltest.interfaces.sensor_files.table import open_table
from hiltest.interfaces.sensor_files.times import RowTimes, TimeColumn, the_time
from hiltest.log_fitting.asked_units import asked_of_gravity
from hiltest.measurement.units import ACCELERATION_WORDS, RATE_WORDS, AccelerationUnit, RateUnit

Reals = NDArray[np.float64]

# Five hours at 100 Hz.
MAX_ROWS = 2_000_000
# Longest period: a slower log does not show a turn, and its column of time is more likely in another unit.
_SLOWEST_HZ = 5.0
_FASTEST_HZ = 1e5


@dataclass(frozen=True, slots=True)
class LogColumns:
    """Columns that the header does not name clearly: names, or numbers from 1."""

    accelerometer: str | None = None
    gyroscope: str | None = None
    """``a,b,c``."""
    time: str | None = None
    labels: str | None = None
    """Column with a label for each row."""


@dataclass(frozen=True, slots=True, eq=False)
class ImuLog:
    """Readings, in the order of the file."""

    files: tuple[str, ...]
    time_s: Reals
    """Shape (n,). Increasing times [s]."""
    acceleration: Reals
    """Shape (n, 3). Readings in `acceleration_unit`, axes of the sensor; no rows without an accelerometer."""
    rate: Reals | None
    """Shape (n, 3), or None. Readings in `rate_unit`; None without a gyroscope."""
    acceleration_unit: AccelerationUnit
    rate_unit: RateUnit
    labels: tuple[str, ...] | None = None
    """Label of each row."""
    notes: tuple[str, ...] = ()
    """Remarks on skipped, recognised or assumed content of the files, one sentence each."""

    @property
    def period_s(self) -> float:
        """Median time between samples [s]."""
        return float(np.median(np.diff(self.time_s)))


def read_imu_log(
    path: Path,
    gyroscope_path: Path | None = None,
    *,
    columns: LogColumns = LogColumns(),
    rate_hz: float | None = None,
    acceleration_unit: AccelerationUnit | None = None,
    rate_unit: RateUnit | None = None,
    gyroscope_alone: bool = False,
) -> ImuLog:
    """Read a log.

    Parameters
    ----------
    path
        Log of both sensors, or of the accelerometer alone.
    gyroscope_path
        Log of the gyroscope. If its samples have other times, the acceleration is interpolated at them.
    columns
        Columns, by default from the headers; a table of three or four columns without a header is x, y, z, after an
        optional time.
    rate_hz
        Sampling rate; by default from the column of time.
    acceleration_unit, rate_unit
        Units, by default from the headers, otherwise counts.
    gyroscope_alone
        True if a log of only the gyroscope is accepted.

    Raises
    ------
    ConfigError
        When there is no such table, or a cell in it is not a number; the message has file, line and column.
    """
    first = _Table(path, columns.labels)
    place = first.axes(
        columns.accelerometer, ACCELEROMETER_STEM, "--accelerometer-columns", "accelerometer", alone=not gyroscope_alone
    )
    alone = place is None and gyroscope_alone and gyroscope_path is None
    if place is None and not alone:
        raise first.no_axes("accelerometer", "--accelerometer-columns")
    places: tuple[int, ...] = place or ()
    second = first if gyroscope_path is None else _Table(gyroscope_path, None)
    others = second.axes(
        columns.gyroscope, GYROSCOPE_STEM, "--gyroscope-columns", "gyroscope", alone=alone or second is not first
    )
    if (gyroscope_path is not None or alone) and others is None:
        raise second.no_axes("gyroscope", "--gyroscope-columns")
    names, other_names = first.names(places), second.names(others) if others else ()
    unit = acceleration_unit or unit_in_headers(
        names if first.headers else (), ACCELERATION_WORDS, "--accelerometer-unit"
    )
    other_unit = rate_unit or unit_in_headers(other_names if second.headers else (), RATE_WORDS, "--gyroscope-unit")
    time_s, readings = first.read(columns.time, rate_hz, [*places, *(others or () if second is first else ())])
    rate = readings[:, len(places) :] if readings.shape[1] > len(places) else None
    joined_notes: list[str] = []
    if second is not first and others is not None:
        other_time_s, rate = second.read(columns.time, rate_hz, list(others))
        if not _are_pairs(time_s, other_time_s):
            if rate_hz is not None:
                raise ConfigError(
                    f"{path} has {len(time_s)} rows and {second.path} {len(other_time_s)}; leave out --rate to join "
                    "them by their times"
                )
            readings = interpolate_readings(time_s, readings, other_time_s)
            inside = np.isfinite(readings[:, 0])
            if inside.sum() < 2:
                raise ConfigError(f"{path} and {second.path} have no time in common")
            joined_notes = [
                f"The logs were joined by time at {inside.sum()} of {len(inside)} samples of the gyroscope."
            ]
            if first.labels is not None:
                nearest = np.clip(np.searchsorted(time_s, other_time_s[inside]), 0, len(time_s) - 1)
                first.labels = tuple(first.labels[place] for place in nearest.tolist())
            time_s, readings, rate = other_time_s[inside], readings[inside], rate[inside]
    acceleration, unit = readings[: len(readings) if places else 0, :3], unit or AccelerationUnit.COUNTS
    notes = [*first.notes, *(second.notes if second is not first else ()), *joined_notes]
    if acceleration_unit is None and places:
        notes += asked_of_gravity(acceleration, unit, "use --accelerometer-unit {}")
    return ImuLog(
        tuple(str(name) for name in (path, gyroscope_path) if name),
        time_s,
        acceleration,
        rate,
        unit,
        other_unit or RateUnit.COUNTS,
        first.labels,
        tuple(notes),
    )


class _Table:
    """A table with its header read; its numbers can be read once."""

    def __init__(self, path: Path, labels: str | None) -> None:
        self.path, self._table = path, open_table(path)
        self.headers, self.width, self.names = self._table.headers, self._table.width, self._table.names
        self._label = None if labels is None else column_index(labels, self.headers, self.width, option="--intervals")
        self.labels: tuple[str, ...] | None = None
        self._notes: list[str] = []

    @property
    def notes(self) -> tuple[str, ...]:
        return (*self._table.notes, *self._notes)

    def axes(
        self, named: str | None, pattern: re.Pattern[str], option: str, sensor: str, *, alone: bool = True
    ) -> tuple[int, int, int] | None:
        """Return the places of x, y and z; for a table without a header, only if it has this sensor alone."""
        if named is not None:
            return named_columns(named, self.headers, self.width, option=option)
        triples = {stem: places for stem, places in axis_triples(self.headers).items() if pattern.search(stem)}
        if len(triples) > 1:
            choices = " or ".join(",".join(self.names(places)) for places in triples.values())
            raise ConfigError(f"{self.path}: more than one {sensor}: choose with {option} {choices}")
        if triples:
            return next(iter(triples.values()))
        if alone and not self.headers and len(self._table.places) in (3, 4):
            return (0, 1, 2) if len(self._table.places) == 3 else (1, 2, 3)
        return None

    def no_axes(self, sensor: str, option: str) -> ConfigError:
        columns = f"the columns are {', '.join(self.headers)}" if self.headers else f"no header, {self.width} columns"
        return ConfigError(
            f"{self.path}: cannot tell which columns are the {sensor}: {columns}; name them with {option}, by name "
            "or by number from 1"
        )

    def read(self, time: str | None, rate_hz: float | None, places: list[int]) -> tuple[Reals, Reals]:
        """Return the times [s] and the readings, one row per sample."""
        clock = None if rate_hz is not None else self._time(time)
        place = None if clock is None else clock.place
        columns = places if place is None else [place, *places]
        names = self.names(columns)
        row_times = None if clock is None else RowTimes(self.path, clock, names[0])
        values, labels = array("d"), []
        sensors = [places[first : first + 3] for first in range(0, len(places), 3)]
        one_a_row, written_twice = False, 0
        for row in self._table.rows():
            filled = filled_of(row.cells, sensors)
            one_a_row = one_a_row or (not len(values) and place is not None and filled.count(True) < len(sensors) > 1)
            if one_a_row and not any(filled):
                continue  # a row of another sensor
            if one_a_row and all(filled):
                raise ConfigError(f"{self.path}:{row.line}: both sensors in a row, and before rows of one each")
            absent = {at for at in places if one_a_row and not filled[places.index(at) // 3]}
            numbers = self._numbers(row, columns, names, row_times, absent)
            if place is not None and len(values):
                before = values[-len(columns)]
                if numbers == values[-len(columns) :].tolist():
                    written_twice += 1
                    continue
                if numbers[0] < before or (numbers[0] == before and not one_a_row):
                    raise ConfigError(
                        f"{self.path}:{row.line}: column {names[0]}: time {numbers[0]:g} is not after {before:g}; "
                        "cut the log there, or give --rate"
                    )
            values.extend(numbers)
            if self._label is not None:
                labels.append(row.cells[self._label])
            if len(values) > MAX_ROWS * len(columns):
                raise ConfigError(f"{self.path}: more than {MAX_ROWS} rows; cut the file")
        read = np.frombuffer(values, dtype=np.float64).reshape(-1, len(columns))
        if len(read) < 2:
            raise ConfigError(f"{self.path}: {len(read)} rows of numbers are too few for a log")
        if self._label is not None:
            self.labels = tuple(labels)
        if rate_hz is not None:
            return np.arange(len(read)) / rate_hz, read
        if one_a_row:
            read = self._join(read)
        if written_twice:
            self._notes.append(f"{written_twice} rows that repeat the one before, with its time, were skipped.")
        unit_s = 1.0 if clock is None else clock.unit_s
        time_s = unit_s * read[:, 0]
        step_s = float(np.median(np.diff(time_s)))
        if not 1.0 / _FASTEST_HZ <= step_s <= 1.0 / _SLOWEST_HZ:
            raise ConfigError(
                f"{self.path}: samples are {step_s:g} s apart by column {names[0]}; give --rate, or name "
                "the column with its unit, such as time_ms"
            )
        return time_s, read[:, 1:]

    def _numbers(
        self,
        row: TableRow,
        columns: Sequence[int],
        names: Sequence[str],
        row_times: RowTimes | None,
        absent: Collection[int],
    ) -> list[float]:
        """Return a row's time and readings; only cells of absent sensors may be empty."""
        numbers = []
        for at, name in zip(columns, names, strict=True):
            if row_times is not None and at == row_times.place:
                numbers.append(row_times.read(row))
                continue
            value = number_in(self.path, row, at, name, quantity="reading of an IMU", largest=LARGEST_READING)
            if not math.isfinite(value) and at not in absent:
                raise ConfigError(
                    f"{self.path}:{row.line}: column {name}: a number is missing, and a turn cannot be integrated "
                    "over a gap: cut the log there"
                )
            numbers.append(value)
        return numbers

    def _join(self, read: Reals) -> Reals:
        rows, joined = join_at_gyroscope(read[:, 0], read[:, 1:])
        time = read[rows, 0]
        if len(time) < 2 or not bool((np.diff(time) > 0.0).all()):
            raise ConfigError(
                f"{self.path}: rows of one sensor each, and of the gyroscope no two at different times "
                "among those of the accelerometer: no log of both"
            )
        if self.labels is not None:
            self.labels = tuple(label for label, is_used in zip(self.labels, rows.tolist(), strict=True) if is_used)
        return np.column_stack([time, joined])

    def _time(self, named: str | None) -> TimeColumn:
        if named is None and not self.headers and len(self._table.places) == 4:
            named = "1"
        try:
            otherwise = "give --rate in Hz, or --time"
            column = the_time(self.headers, self._table.first_rows, named, "--time", otherwise)
        except ConfigError as error:
            raise ConfigError(f"{self.path}: {error}") from error
        if column.note:
            self._notes.append(column.note)
        return column


def _are_pairs(time_s: Reals, other_time_s: Reals) -> bool:
    """Return whether two logs have their samples at the same times, within a step."""
    if len(time_s) != len(other_time_s):
        return False
    return bool((np.abs(time_s - other_time_s) <= np.median(np.diff(time_s))).all())


def interpolate_readings(time_s: Reals, readings: Reals, at_s: Reals) -> Reals:
    """Return readings, shape (n, axes), linearly interpolated at times; NaN outside their own times."""
    return np.column_stack([np.interp(at_s, time_s, axis, left=math.nan, right=math.nan) for axis in readings.T])


def filled_of(cells: Sequence[str], sensors: Sequence[Sequence[int]]) -> list[bool]:
    """Return for each sensor, given as the places of its columns, whether a row has values of it."""
    return [any(cells[place] for place in places) for places in sensors]


def join_at_gyroscope(time_s: Reals, readings: Reals) -> tuple[NDArray[np.bool_], Reals]:
    """Join both sensors at the times of the gyroscope, because a turn needs its every sample.

    Parameters
    ----------
    time_s : shape (n,)
        Times, not decreasing.
    readings : shape (n, 6)
        Readings of accelerometer and gyroscope; NaN for a sensor that is not in the row.

    Returns
    -------
    rows : ndarray of bool, shape (n,)
        Mask of gyroscope rows that are between two accelerometer rows.
    joined : ndarray, shape (sum(rows), 6)
        These rows, with linearly interpolated acceleration.
    """
    of_gyroscope = np.isfinite(readings[:, 3])
    others_s, others = time_s[~of_gyroscope], readings[~of_gyroscope, :3]
    if not len(others_s):
        return np.zeros(len(time_s), dtype=np.bool_), np.empty((0, 6))
    rows = of_gyroscope & (time_s >= others_s[0]) & (time_s <= others_s[-1])
    joined = readings[rows]
    joined[:, :3] = interpolate_readings(others_s, others, time_s[rows])
    return rows, joined
