"""Tracks of magnetometer, accelerometer and gyroscope from one text table."""

from __future__ import annotations

import math
import re
from array import array
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from hiltest.errors import ConfigError
from hiltest.interfaces.sensor_files.cells import LARGEST_READING, TableRow, number_in
from hiltest.interfaces.sensor_files.columns import (
    ACCELEROMETER_STEM,
    GYROSCOPE_STEM,
    MAGNETOMETER_STEM,
    axis_triples,
    incomplete_triples,
    name_and_unit,
    named_columns,
)
from hiltest.interfaces.sensor_files.table import Table, open_table
from hiltest.interfaces.sensor_files.times import RowTimes, TimeColumn, the_time
from hiltest.orientation.motion_recording import MotionRecording
from hiltest.rig.recorded_motion import UNITS, PlaybackFile, PlayedSensor, factor_of
from hiltest.world.recorded_motion import Reals, Sensed, Track

# Five hours at 100 Hz.
MAX_ROWS = 2_000_000
_STEMS = {
    Sensed.MAGNETOMETER: MAGNETOMETER_STEM,
    Sensed.ACCELEROMETER: ACCELEROMETER_STEM,
    Sensed.GYROSCOPE: GYROSCOPE_STEM,
}
# Comment that `hiltest log` writes about a virtual board.
_CLOCK_BEGAN = re.compile(r"hiltest log: .*clock began (?P<began>[0-9.]+) s after power-on")


@dataclass(frozen=True, slots=True, eq=False)
class Recorded:
    """Contents of a recording."""

    tracks: dict[Sensed, Track]
    """Tracks by the recording's own clock, body frame."""
    clock_began_s: float | None = None
    """Virtual time at which that clock started, if the recording has it."""
    notes: tuple[str, ...] = ()
    """Remarks on skipped, recognised or assumed content of the file, one sentence each."""
    motion: MotionRecording | None = None
    """The same with true attitudes, if the recording has any."""


@dataclass(frozen=True, slots=True)
class _Columns:
    """Columns of a sensor, and the conversion of their numbers to readings in the body's axes."""

    places: tuple[int, int, int]
    names: tuple[str, str, str]
    factor: float
    axes: tuple[tuple[int, int], ...]


def read_table(path: Path, settings: PlaybackFile) -> Recorded:
    """Read a table: each row is a sample of all sensors, or of one, with only its columns filled.

    Raises
    ------
    ConfigError
        When a cell is not a number, times do not increase, or a column is ambiguous; the message has file and line.
    """
    table = open_table(path)
    headers, width = table.headers, table.width
    if headers[:3] == ("time_s", "type", "number"):
        raise ConfigError(
            f"{path}: a table by hiltest decode, whose field is the firmware's calibrated one; play the "
            "recording of the packets itself, which says so"
        )
    by_sensor = {
        sensed: columns
        for sensed in Sensed
        if (columns := _columns(path, sensed, settings.sensor(sensed.key), headers, width)) is not None
    }
    if not by_sensor:
        raise ConfigError(
            f"{path}: no columns of a magnetometer, an accelerometer or a gyroscope among "
            f"{', '.join(headers) or f'{width} columns without a header'}; name them under "
            '[world.playback.magnetometer] and so on: columns = ["mx", "my", "mz"]'
        )
    time = _time(path, settings, table)
    row_times = None if time is None else RowTimes(path, time, *table.names([time.place]))
    times: dict[Sensed, array[float]] = {sensed: array("d") for sensed in by_sensor}
    readings: dict[Sensed, array[float]] = {sensed: array("d") for sensed in by_sensor}
    for number, row in enumerate(table.rows()):
        if number == MAX_ROWS:
            raise ConfigError(f"{path}: more than {MAX_ROWS} rows; cut the file")
        without_s = number / (settings.rate_hz or 1.0)
        row_s = without_s if time is None or row_times is None else time.unit_s * row_times.read(row)
        for sensed, columns in by_sensor.items():
            _take(path, row, row_s, columns, times[sensed], readings[sensed])
    tracks = {
        sensed: _track(times[sensed], readings[sensed], by_sensor[sensed]) for sensed in by_sensor if times[sensed]
    }
    if not tracks:
        raise ConfigError(f"{path}: no row has a reading")
    notes = (*table.notes, *([time.note] if time is not None and time.note else []))
    began = _CLOCK_BEGAN.search(table.comment)
    return Recorded(tracks, float(began["began"]) if began else None, notes)


def _columns(path: Path, sensed: Sensed, settings: PlayedSensor, headers: Sequence[str], width: int) -> _Columns | None:
    option = f"world.playback.{sensed.key}.columns"
    if settings.columns is not None:
        # Quoted, because a name may have a comma.
        places = named_columns(",".join(f'"{column}"' for column in settings.columns), headers, width, option=option)
    else:
        stems = {stem: triple for stem, triple in axis_triples(headers).items() if _STEMS[sensed].search(stem)}
        _refuse_incomplete(path, sensed, headers)
        if not stems:
            return None
        if len(stems) > 1:
            choices = " or ".join(str([headers[place] for place in triple]) for triple in stems.values())
            raise ConfigError(f"{path}: more than one {sensed.key}: choose with {option} = {choices}")
        (places,) = stems.values()
    x, y, z = (headers[place] if headers else str(place + 1) for place in places)
    return _Columns(places, (x, y, z), _factor(path, sensed, settings, (x, y, z)), settings.signed_axes)


def _refuse_incomplete(path: Path, sensed: Sensed, headers: Sequence[str]) -> None:
    """Refuse two axes of three, because the sensor would otherwise count as not recorded."""
    for stem, places in incomplete_triples(headers).items():
        if _STEMS[sensed].search(stem):
            raise ConfigError(
                f"{path}: columns {', '.join(headers[place] for place in places)} are not x, y and z of "
                f"one {sensed.key}: name three with world.playback.{sensed.key}.columns"
            )


def _factor(path: Path, sensed: Sensed, settings: PlayedSensor, names: Sequence[str]) -> float:
    words = {name_and_unit(name)[1] for name in names} - {""}
    word = settings.unit or (words.pop() if len(words) == 1 else "")
    factor = factor_of(word, UNITS[sensed.key]) if word else None
    if factor is None:
        are = f"are in {word}, which is no unit of a {sensed.key} that is known" if word else "do not say their unit"
        raise ConfigError(
            f"{path}: columns {', '.join(names)} {are}; say it with world.playback.{sensed.key}.unit, a "
            f'factor before it where they are counts: unit = "0.1 {sensed.unit}"'
        )
    return factor


def _time(path: Path, settings: PlaybackFile, table: Table) -> TimeColumn | None:
    if settings.rate_hz is not None:
        return None
    otherwise = "name one with world.playback.time, or give world.playback.rate_hz"
    try:
        return the_time(table.headers, table.first_rows, settings.time, "world.playback.time", otherwise)
    except ConfigError as error:
        raise ConfigError(f"{path}: {error}") from error


def _take(
    path: Path, row: TableRow, row_s: float, columns: _Columns, times: array[float], readings: array[float]
) -> None:
    """Read a sensor's reading from a row, if it has one."""
    if not any(row.cells[place] for place in columns.places):
        return
    if times and row_s <= times[-1]:
        raise ConfigError(f"{path}:{row.line}: time {row_s:g} s is not behind {times[-1]:g} s; cut the recording there")
    for place, name in zip(columns.places, columns.names, strict=True):
        value = number_in(path, row, place, name, quantity="reading of a sensor", largest=LARGEST_READING)
        if not math.isfinite(value):
            raise ConfigError(f"{path}:{row.line}: column {name}: no number; leave all three axes empty, or none")
        readings.append(value)
    times.append(row_s)


def _track(times: array[float], readings: array[float], columns: _Columns) -> Track:
    of_sensor = columns.factor * np.frombuffer(readings, dtype=np.float64).reshape(-1, 3)
    return Track(np.frombuffer(times, dtype=np.float64), rotate_to_body(of_sensor, columns.axes))


def rotate_to_body(readings: Reals, axes: Sequence[tuple[int, int]]) -> Reals:
    """Return readings, shape (n, 3), along the body's axes, each given as the sensor's axis and its sign."""
    return np.column_stack([sign * readings[:, axis] for axis, sign in axes])
