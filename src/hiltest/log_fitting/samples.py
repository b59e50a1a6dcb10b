"""Magnetometer samples from a file."""

from __future__ import annotations

import math
import re
from array import array
from collections.abc import Sized
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from hiltest.errors import ConfigError
from hiltest.interfaces.sensor_files.cells import LARGEST_READING, TableRow, TableRows, number_in, number_or_nan
from hiltest.interfaces.sensor_files.columns import (
    ACCELEROMETER_STEM,
    MAGNETOMETER_STEM,
    NoMagnetometerError,
    axis_triples,
    guessed_columns,
    is_sensor,
    named_columns,
    some_columns,
    stem_and_axis,
    unit_in_headers,
    unit_in_text,
    unit_of,
)
from hiltest.interfaces.sensor_files.table import Table, open_table
from hiltest.interfaces.sensor_files.times import LATEST, TimeColumn, time_columns, time_or_nan, unwrap_midnights
from hiltest.log_fitting.asked_units import asked_of_gravity
from hiltest.log_fitting.imu_log import LogColumns, interpolate_readings, read_imu_log
from hiltest.measurement.units import ACCELERATION_WORDS, MICROTESLA, AccelerationUnit, FieldUnit

Reals = NDArray[np.float64]

# 24 MB of numbers, and three hours of a sensor at 80 Hz.
MAX_ROWS = 1_000_000
_AXES = 3


@dataclass(frozen=True, slots=True, eq=False)
class Samples:
    """Samples of one magnetometer."""

    path: Path
    points: Reals
    """Shape (n, 3). Readings in `unit`, sensor frame, in the order of the file."""
    unit: FieldUnit
    unit_from: str
    """Source of the unit: ``option``, ``header``, or ``assumed``."""
    columns: tuple[str, ...]
    """Names of the three columns, or their numbers from 1; two for a compass with two axes, whose third reads 0."""
    skipped: int
    """Number of rows without three finite numbers."""
    lines: NDArray[np.int64] | None = None
    """Shape (n,), or None. Line of each sample in the file; None without a file."""
    time_s: Reals | None = None
    """Shape (n,), or None. Time of each sample, not decreasing [s]; None without a column of time, or if it
    decreases."""
    acceleration: Reals | None = None
    """Shape (n, 3), or None. Accelerometer readings of the same rows, in `acceleration_unit`, its own axes; NaN in a
    row without three numbers. None without an accelerometer."""
    acceleration_unit: AccelerationUnit = AccelerationUnit.COUNTS
    preamble: int = 0
    """Number of lines before the table."""
    start: float = 0.0
    """Start of a part after the log's first reading [s], or as a number of readings without times."""
    notes: tuple[str, ...] = ()
    """Remarks on skipped, recognised or assumed content of the file, one sentence each."""

    @property
    def microtesla(self) -> float | None:
        """Size of one `unit` [uT]; None if unknown."""
        return MICROTESLA[self.unit]


@dataclass(frozen=True, slots=True)
class _Layout:
    """Columns of a table and their meaning."""

    places: tuple[int, ...]
    names: tuple[str, ...]
    accelerometer: tuple[int, ...]
    accelerometer_names: tuple[str, ...]
    strict: bool
    """True to refuse accelerometer cells that are not numbers, because an option names the columns."""
    time: TimeColumn | None
    notes: tuple[str, ...]


def read_samples(
    path: Path, *, columns: str | None = None, unit: FieldUnit | None = None, accelerometer_columns: str | None = None
) -> Samples:
    """Read magnetometer samples from a text table.

    Parameters
    ----------
    path
        File, see `hiltest.interfaces.sensor_files.table.open_table`.
    columns
        ``a,b,c``, names or numbers from 1; by default the header's magnetometer columns.
    unit
        Unit, by default from the header, otherwise counts.
    accelerometer_columns
        Like `columns`; by default the header's accelerometer columns, if there are three.

    Raises
    ------
    ConfigError
        When there is no such table in the file; the message has file, line and column.
    NoMagnetometerError
        When no columns of the table are a magnetometer's.
    """
    table = open_table(path)
    try:
        layout = _layout(table, columns, accelerometer_columns)
        unit_found = unit or unit_of(layout.names if table.headers else ()) or unit_in_text(table.text)
        acceleration_unit = _acceleration_unit(layout) if table.headers else AccelerationUnit.COUNTS
    except NoMagnetometerError as error:
        raise NoMagnetometerError(f"{path}: {error}", error.sensors) from error
    except ConfigError as error:
        raise ConfigError(f"{path}: {error}") from error
    numbers, others, lines, skipped = _numbers(table, layout)
    time_s = _rising(numbers[:, -1], layout.time)
    acceleration = numbers[:, _AXES : 2 * _AXES] if layout.accelerometer else None
    notes = [*table.notes, *layout.notes]
    if acceleration is not None and np.isnan(acceleration).all() and len(others):
        other_s = _rising(others[:, -1], layout.time)
        if time_s is not None and other_s is not None:
            acceleration = interpolate_readings(other_s, others[:, :-1], time_s)
            count = int(np.isfinite(acceleration[:, 0]).sum())
            notes.append(
                f"The acceleration at {count} of {len(numbers)} readings was interpolated between its own rows."
            )
    if acceleration is not None and acceleration_unit is not AccelerationUnit.COUNTS:
        notes += asked_of_gravity(acceleration, acceleration_unit, "A header that says {} settles it")
    return Samples(
        path,
        numbers[:, :_AXES].copy(),
        unit_found or FieldUnit.COUNTS,
        "option" if unit else "header" if unit_found else "assumed",
        layout.names,
        skipped,
        lines=lines,
        time_s=time_s,
        acceleration=None if acceleration is None or np.isnan(acceleration).any(axis=1).all() else acceleration.copy(),
        acceleration_unit=acceleration_unit,
        preamble=table.preamble,
        notes=tuple(notes),
    )


def join_accelerometer(samples: Samples, path: Path, columns: str | None = None) -> Samples:
    """Return samples with the readings of an accelerometer's own log, linearly interpolated at their times.

    Raises
    ------
    ConfigError
        When one of the logs has no times, or they have no time in common; see `read_imu_log`.
    """
    log = read_imu_log(path, columns=LogColumns(accelerometer=columns))
    if samples.time_s is None:
        raise ConfigError(f"{samples.path}: no column of rising times, by which {path} could be joined")
    acceleration = interpolate_readings(log.time_s, log.acceleration, samples.time_s)
    if np.isnan(acceleration).all():
        raise ConfigError(f"{samples.path} and {path} have no time in common")
    count = int(np.isfinite(acceleration[:, 0]).sum())
    note = f"{path} was joined by time: it has the acceleration of {count} of {len(acceleration)} readings."
    notes = (*samples.notes, *log.notes, note)
    return replace(samples, acceleration=acceleration, acceleration_unit=log.acceleration_unit, notes=notes)


def _layout(table: Table, columns: str | None, accelerometer_columns: str | None) -> _Layout:
    headers, width, notes = table.headers, table.width, []
    if columns is not None:
        places = some_columns(columns, headers, width, (3, 2))
    else:
        places = guessed_columns(headers, table.places, table.index, table.first_rows)
        file, parts = table.path.stem.lower(), filter(None, map(stem_and_axis, table.names(places)))
        if is_sensor(f"{file} ") and not MAGNETOMETER_STEM.search(file) and not any(stem for stem, _ in parts):
            raise ConfigError("the file has the name of another sensor; if it is wrong, name the columns: --columns")
        if table.index is not None and places == table.places[1:]:
            notes.append(f"Column {table.names([table.index])[0] or '1'} was taken as an index, not as readings.")
    if len(places) < _AXES:
        notes.append(f"The log has only {' and '.join(table.names(places))}: it is read as a compass with two axes.")
    accelerometer: tuple[int, ...] = ()
    if accelerometer_columns is not None:
        accelerometer = named_columns(accelerometer_columns, headers, width, option="--accelerometer-columns")
    else:
        triples = [
            triple
            for stem, triple in axis_triples(headers).items()
            if ACCELEROMETER_STEM.search(stem) and not set(triple) & set(places)
        ]
        kinds = {re.sub(r"\d", "", headers[triple[0]]): triple for triple in reversed(triples)}
        accelerometer = next(iter(kinds.values())) if len(kinds) == 1 else ()  # the first of an autopilot's
    times = time_columns(headers, table.first_rows, (*places, *accelerometer))
    if times and times[0].note:
        notes.append(times[0].note)
    return _Layout(
        places,
        table.names(places),
        accelerometer,
        table.names(accelerometer),
        accelerometer_columns is not None,
        times[0] if times else None,
        tuple(notes),
    )


def _acceleration_unit(layout: _Layout) -> AccelerationUnit:
    """Return the unit in the header; only ratios matter, so an unknown unit is sufficient."""
    try:
        unit = unit_in_headers(layout.accelerometer_names, ACCELERATION_WORDS, "--accelerometer-columns")
    except ConfigError:
        return AccelerationUnit.COUNTS
    return unit or AccelerationUnit.COUNTS


def _numbers(table: Table, layout: _Layout) -> tuple[Reals, Reals, NDArray[np.int64], int]:
    """Return one row per sample: x, y, z, the accelerometer's if present, the time; rows of an accelerometer alone.

    The last two are the lines of the samples, and the number of other rows.
    """
    path, values, others, lines, skipped = table.path, array("d"), array("d"), array("q"), 0
    flat = _AXES - len(layout.places)
    places = [*layout.places, *layout.accelerometer]
    largest = [LARGEST_READING] * len(places)
    if layout.time is not None:
        places, largest = [*places, layout.time.place], [*largest, LATEST]
    for row in table.rows_of_numbers(places, largest):
        if isinstance(row, TableRows):
            without_time = np.full((len(row.numbers), int(layout.time is None)), math.nan)
            numbers = np.insert(row.numbers, [len(layout.places)] * flat, 0.0, axis=1)
            values.frombytes(np.column_stack([numbers, without_time]).tobytes())
            lines.extend(range(row.line, row.line + len(row.numbers)))
            _refuse_too_many(path, lines)
            continue
        reading = [
            number_in(path, row, place, name, quantity="magnetometer reading")
            for place, name in zip(layout.places, layout.names, strict=True)
        ]
        acceleration = _acceleration(path, row, layout)
        time = row.arrived_s if layout.time is None else time_or_nan(row.cells[layout.time.place])
        if not all(map(math.isfinite, reading)):
            if acceleration and all(map(math.isfinite, acceleration)):
                others.extend((*acceleration, time))
            else:
                skipped += 1
            continue
        values.extend((*reading, *[0.0] * flat, *acceleration, time))
        lines.append(row.line)
        _refuse_too_many(path, lines)
    if not lines:
        raise ConfigError(f"{path}: no row has three numbers in the columns {', '.join(layout.names)}")
    count = _AXES + len(layout.accelerometer) + 1
    rows, other_rows = np.frombuffer(values).reshape(-1, count), np.frombuffer(others).reshape(-1, _AXES + 1)
    return rows, other_rows, np.frombuffer(lines, dtype=np.int64), skipped


def _refuse_too_many(path: Path, lines: Sized) -> None:
    if len(lines) > MAX_ROWS:
        raise ConfigError(f"{path}: more than {MAX_ROWS} readings; keep every tenth line, or cut the file")


def _acceleration(path: Path, row: TableRow, layout: _Layout) -> list[float]:
    if layout.strict:
        return [
            number_in(path, row, place, name, quantity="accelerometer reading")
            for place, name in zip(layout.accelerometer, layout.accelerometer_names, strict=True)
        ]
    return [number_or_nan(row.cells[place], LARGEST_READING) for place in layout.accelerometer]


def _rising(times: Reals, column: TimeColumn | None) -> Reals | None:
    """Return times in seconds, of arrival without a column; None if one is missing or they decrease."""
    if column is None or column.is_clock:
        times = unwrap_midnights(times)
    if not bool((np.diff(times, prepend=times[0]) >= 0.0).all()):
        return None
    return times if column is None else times * column.unit_s
