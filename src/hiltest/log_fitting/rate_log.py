"""A log of angular rates from a file: columns, unit, sampling rate, and the longest part without a long gap."""

from __future__ import annotations

import math
from array import array
from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from hiltest.calibration.rest import density_of_changes, first_motion
from hiltest.errors import CalibrationError, ConfigError
from hiltest.interfaces.sensor_files.cells import number_in, shown
from hiltest.interfaces.sensor_files.columns import (
    GYROSCOPE_STEM,
    axis_triples,
    column_hint,
    name_and_unit,
    some_columns,
)
from hiltest.interfaces.sensor_files.table import Table, open_table
from hiltest.interfaces.sensor_files.times import RowTimes, TimeColumn, the_time
from hiltest.log_fitting.time_stamps import even_stamps, gaps
from hiltest.measurement.units import DEGREES_PER_SECOND, RATE_WORDS, RateUnit

Reals = NDArray[np.float64]

# 160 MB a column, and 28 hours at 200 Hz.
MAX_ROWS = 20_000_000
_AXES = 3
_LARGEST = 1e9  # deg/s or counts: no sensor's reading
#: Largest noise density of a gyroscope at rest [mdps/rtHz]: data sheets state 3 to 30.
LARGEST_NOISE_MDPS = 100.0
# Longest pause that is passed over, and all pauses, relative to the log: noise changes less than by its uncertainty.
_LONGEST_PAUSE, _PAUSES = 0.01, 0.1
# Range of sampling rates: outside, the time must be in another unit.
_RATES_HZ = (1e-3, 1e6)


@dataclass(frozen=True, slots=True, eq=False)
class RateLog:
    """The longest part of a log without a long gap; short pauses are passed over, as if no time had gone by."""

    path: Path
    columns: tuple[str, ...]
    """Names of the columns, or numbers from 1."""
    rates: Reals
    """Shape (n, columns). Rates in deg/s, or in counts if that is the unit."""
    unit: RateUnit
    """Unit of the file."""
    rate_hz: float
    rows: int
    """Number of rows of the whole file, of which the part has `len(rates)`."""
    gaps: int
    """Number of gaps in the whole file."""
    start_s: float = 0.0
    """Time of the part's first sample after the file's first row."""
    jitter_s: float = 0.0
    """Largest deviation of the part's time stamps from an even rate."""
    notes: tuple[str, ...] = ()
    """Remarks on skipped, recognised or assumed content of the file, one sentence each."""
    paused_s: Reals | None = None
    """Shape (n,), or None. Sum of the pauses before each sample of the part; None without pauses."""

    def instant_s(self, place: int) -> float:
        """Return the time of a sample of the part after the file's first row."""
        paused_s = 0.0 if self.paused_s is None else float(self.paused_s[min(place, len(self.paused_s) - 1)])
        return self.start_s + place / self.rate_hz + paused_s

    @property
    def is_in_degrees(self) -> bool:
        """True if the rates are in deg/s."""
        return DEGREES_PER_SECOND[self.unit] is not None


@dataclass(frozen=True, slots=True)
class _Layout:
    places: tuple[int, ...]
    names: tuple[str, ...]
    time: TimeColumn | None


def read_rate_log(
    path: Path,
    *,
    columns: str | None = None,
    unit: RateUnit | None = None,
    otherwise: RateUnit | None = None,
    time: str | None = None,
    rate_hz: float | None = None,
    first_s: float = 0.0,
    last_s: float = math.inf,
) -> RateLog:
    """Read a log of rates at rest from a text table.

    Parameters
    ----------
    path
        File, see `hiltest.interfaces.sensor_files.table.open_table`.
    columns
        Up to three columns, ``a,b,c``: names or numbers from 1; by default the header's gyroscope columns.
    unit
        Unit, by default from the header.
    otherwise
        Unit for a header without one; by default an error.
    time
        Column of time; by default one called time, timestamp or t, in the unit at the end of its name, otherwise s.
    rate_hz
        Sampling rate of a file without time, whose rows are assumed to have no gap.
    first_s, last_s
        Start and end (exclusive) of the time to read, after the first row.

    Raises
    ------
    ConfigError
        When there is no such table in the file; the message has file, row and column.
    """
    table = open_table(path, fewest=1)
    headers = table.headers
    try:
        layout = _layout(table, columns, None if rate_hz else time, want_time=rate_hz is None)
        file_unit = unit or _header_unit(layout.names if headers else (), otherwise)
    except ConfigError as error:
        raise ConfigError(f"{path}: {error}") from error
    times, values = _numbers(table, layout)
    unit_s = 1.0 if layout.time is None else layout.time.unit_s
    time_s = np.arange(len(values)) / rate_hz if rate_hz else unit_s * (times - times[0])
    part, breaks, paused_s = _longest_part(time_s, first_s, last_s, even=rate_hz is not None)
    if part.stop - part.start < 2:
        raise CalibrationError(f"{path}: {part.stop - part.start} samples: too few for a noise log")
    if rate_hz is None:
        _check_steps(path, time_s[part])
    found_hz, jitter_s = (rate_hz, 0.0) if rate_hz else even_stamps(time_s[part] - paused_s)
    rates = values[part] * (DEGREES_PER_SECOND[file_unit] or 1.0)
    return RateLog(
        path,
        layout.names,
        rates,
        file_unit,
        found_hz,
        len(values),
        breaks,
        float(time_s[part.start]),
        jitter_s,
        (*table.notes, *([layout.time.note] if layout.time is not None and layout.time.note else [])),
        paused_s if paused_s.any() else None,
    )


def rest_bias(
    path: Path,
    unit: RateUnit,
    *,
    written: RateUnit | None = None,
    columns: str | None = None,
    time: str | None = None,
    rate_hz: float | None = None,
) -> Reals:
    """Return the bias of three axes in a unit: the mean of a log at rest.

    Parameters
    ----------
    unit
        Unit of the log that needs the bias.
    written
        Unit of the file; by default from its header, otherwise `unit`.
    columns, time, rate_hz
        See `read_rate_log`.

    Raises
    ------
    ConfigError
        When the file is not a log of three axes, or only one of both units is counts.
    CalibrationError
        When the sensor moved.
    """
    log = read_rate_log(path, columns=columns, unit=written, otherwise=unit, time=time, rate_hz=rate_hz)
    check_rest(log)
    if log.rates.shape[1] != _AXES:
        raise ConfigError(f"{path}: {log.rates.shape[1]} columns of rates; a bias needs three")
    per_unit = DEGREES_PER_SECOND[unit]
    if log.is_in_degrees != (per_unit is not None):
        raise ConfigError(f"{path} is in {log.unit} and the log in {unit}: both must be in counts, or neither")
    return np.asarray(log.rates.mean(axis=0) / (per_unit or 1.0))


def check_rest(log: RateLog, *, noise_mdps: float = LARGEST_NOISE_MDPS) -> None:
    """Refuse a log of a moved sensor.

    Parameters
    ----------
    noise_mdps
        Largest noise density of the sensor at rest [mdps/rtHz]; not applied to counts.

    Raises
    ------
    CalibrationError
        When the sensor moved; the message has the instant, and the part to use instead, unless it moved all the time.
    """
    motion = first_motion(log.rates, rate_hz=log.rate_hz)
    density_mdps = 1000.0 * density_of_changes(log.rates, rate_hz=log.rate_hz)
    if log.is_in_degrees and motion is None and density_mdps.max() > noise_mdps:
        axis = int(density_mdps.argmax())
        raise CalibrationError(
            f"{log.path}: {log.columns[axis]} changes from second to second like a noise of {density_mdps[axis]:.3g} "
            f"mdps/rtHz, above {noise_mdps:g}: the sensor moved from beginning to end. Log again with it at rest, "
            "or set the largest noise of its data sheet with --noise"
        )
    if motion is None:
        return
    at_s, first_s, last_s = map(log.instant_s, (motion.start, *motion.rest))
    unit = "deg/s" if log.is_in_degrees else "counts"
    raise CalibrationError(
        f"{log.path}: it moved {at_s:.1f} s after the first row: {log.columns[motion.axis]} changed by "
        f"{motion.change:+.3g} {unit} within {motion.samples / log.rate_hz:.3g} s, {motion.times:.0f} times the "
        f"noise. Log again without touching the sensor, or use the longest rest: --from {first_s:.1f} --to {last_s:.1f}"
    )


def _layout(table: Table, columns: str | None, time: str | None, *, want_time: bool) -> _Layout:
    headers, width = table.headers, table.width
    places = _guessed_columns(table) if columns is None else some_columns(columns, headers, width, (1, 2, 3))
    names = table.names(places)
    otherwise = "name it with --time, or set the sample rate with --rate HZ"
    clock = the_time(headers, table.first_rows, time, "--time", otherwise) if want_time else None
    if clock is not None and clock.place in places:
        raise ConfigError(f"column {table.names([clock.place])[0]} is given as time and as a rate")
    return _Layout(places, names, clock)


def _guessed_columns(table: Table) -> tuple[int, ...]:
    triples = [places for stem, places in axis_triples(table.headers).items() if GYROSCOPE_STEM.search(stem)]
    if len(triples) != 1:
        shown = ", ".join(table.headers) or "without a header"
        hint = column_hint(table.headers, table.places, table.first_rows, triples or None)
        raise ConfigError(f"cannot tell which columns are the gyroscope ({shown}); name them with --columns{hint}")
    return triples[0]


def _header_unit(names: Sequence[str], otherwise: RateUnit | None) -> RateUnit:
    units = {RATE_WORDS[word] for word in (name_and_unit(name)[1] for name in names) if word in RATE_WORDS}
    if not units and otherwise is not None:
        return otherwise
    if len(units) != 1:
        problem = "no unit" if not units else "different units"
        raise ConfigError(f"the columns {', '.join(names)} name {problem}; set it: --unit {' or '.join(RateUnit)}")
    return units.pop()


def _numbers(table: Table, layout: _Layout) -> tuple[Reals, Reals]:
    path, times, values = table.path, array("d"), array("d")
    last_s = -math.inf
    row_times = layout.time and RowTimes(path, layout.time, *table.names([layout.time.place]))
    for row in table.rows():
        cells = [row.cells[place] for place in layout.places]
        if not any(cells):
            continue  # a row of another sensor
        for place, name in zip(layout.places, layout.names, strict=True):
            values.append(number_in(path, row, place, name, quantity="reading of a gyroscope", largest=_LARGEST))
            if not math.isfinite(values[-1]):
                raise ConfigError(f"{path}:{row.line}: column {name}: {shown(row.cells[place])} is not a number")
        if row_times is not None:
            time = row_times.read(row)
            if time < last_s:
                raise ConfigError(f"{path}:{row.line}: the time {time:.9g} is before the one above it, {last_s:.9g}")
            times.append(time)
            last_s = time
        if len(values) > MAX_ROWS * len(cells):
            raise ConfigError(f"{path}: more than {MAX_ROWS} rows; cut the file")
    if not values:
        raise ConfigError(f"{path}: no row has numbers in the columns {', '.join(layout.names)}")
    count = len(layout.places)
    return np.frombuffer(times, dtype=np.float64), np.frombuffer(values, dtype=np.float64).reshape(-1, count)


def _check_steps(path: Path, time_s: Reals) -> None:
    step_s = float(time_s[-1] - time_s[0]) / (len(time_s) - 1)
    if not 1.0 / _RATES_HZ[1] <= step_s <= 1.0 / _RATES_HZ[0]:
        raise ConfigError(
            f"{path}: samples are {step_s:g} s apart by the column of time; give --rate, or name the "
            "column with its unit, such as time_ms"
        )


def _longest_part(time_s: Reals, first_s: float, last_s: float, *, even: bool) -> tuple[slice, int, Reals]:
    """Return the rows of the longest part without a long gap between two instants, the number of gaps, and the pauses.

    The pauses are those before each sample of the part [s]: how much later the stamps behind a gap are than even ones.
    """
    begin, end = np.searchsorted(time_s, [first_s, last_s]).tolist()
    breaks = begin + gaps(time_s[begin:end]) if not even and end - begin > 2 else np.zeros(0, dtype=np.int64)
    edges = np.array([begin, *breaks.tolist(), end])
    if not len(breaks):
        return slice(begin, end), 0, np.zeros(end - begin)
    span_s = time_s[end - 1] - time_s[begin]
    sizes = np.diff(edges)
    parts_s = [time_s[first:last] for first, last in pairwise(edges.tolist()) if last - first > 1]
    periods_s = [1.0 / even_stamps(part_s)[0] for part_s in parts_s]
    # The variance of a slope goes as 1 / n^3.
    period_s = float(np.average(periods_s, weights=sizes[sizes > 1].astype(float) ** 3))
    starts_s = np.add.reduceat((time_s - period_s * np.arange(len(time_s)))[:end], edges[:-1]) / sizes
    pauses_s = np.diff(starts_s)
    if pauses_s.sum() <= _PAUSES * span_s:
        edges = edges[[True, *(pauses_s > _LONGEST_PAUSE * span_s), True]]
    longest = int(np.argmax(np.diff(edges)))
    part = slice(int(edges[longest]), int(edges[longest + 1]))
    paused_s = np.zeros(end)
    paused_s[breaks] = pauses_s
    paused_s[part.start] = 0.0
    return part, len(breaks), np.cumsum(paused_s[part])
