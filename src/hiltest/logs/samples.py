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
from hiltest.recordings.columns import MICROTESLA, Unit, guessed_columns, named_columns, unit_of
from hiltest.recordings.table import TableRow, check_width, number_in, read_rows, split_header

# 24 MB of numbers, and three hours of a sensor at 80 Hz.
MAX_ROWS = 1_000_000
_AXES = 3


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
    """

    path: Path
    points: NDArray[np.float64]
    unit: Unit
    unit_from: str
    columns: tuple[str, str, str]
    skipped: int

    @property
    def microtesla(self) -> float | None:
        """Size of one `unit` [uT], None when it is unknown."""
        return MICROTESLA[self.unit]

    @property
    def repeated(self) -> int:
        """Readings equal to the one before: the log was faster than the sensor, or the sensor lay still."""
        return int((np.diff(self.points, axis=0) == 0.0).all(axis=1).sum())


def read_samples(path: Path, *, columns: str | None = None, unit: Unit | None = None) -> Samples:
    """Read magnetometer samples from a text table.

    Parameters
    ----------
    path : Path
        Comma, semicolon, tab or blanks between cells; decimal points; with or without a header.
    columns : str, optional
        ``a,b,c``, names or numbers from 1; by default those that the header calls a magnetometer's.
    unit : Unit, optional
        By default what the header says, else counts.

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
        places = named_columns(columns, headers, width) if columns is not None else guessed_columns(headers, width)
        named = tuple(headers[place] for place in places) if headers else ()
        unit_found = unit or unit_of(named)
    except ConfigError as error:
        raise ConfigError(f"{path}: {error}") from error
    names = named or tuple(str(place + 1) for place in places)
    points, skipped = _points(path, data, places, names, width)
    return Samples(
        path, points, unit_found or Unit.COUNTS, "option" if unit else "header" if unit_found else "assumed",
        (names[0], names[1], names[2]), skipped,
    )


def _points(
    path: Path, rows: Iterator[TableRow], places: tuple[int, int, int], names: Sequence[str], width: int
) -> tuple[NDArray[np.float64], int]:
    values, skipped = array("d"), 0
    for row in rows:
        check_width(path, row, width)
        reading = [
            number_in(path, row, place, name, what="magnetometer reading")
            for place, name in zip(places, names, strict=True)
        ]
        if not all(map(math.isfinite, reading)):
            skipped += 1
            continue
        values.extend(reading)
        if len(values) > _AXES * MAX_ROWS:
            raise ConfigError(f"{path}: more than {MAX_ROWS} readings; keep every tenth line, or cut the file")
    if not values:
        raise ConfigError(f"{path}: no row has three numbers in the columns {', '.join(names)}")
    return np.frombuffer(values, dtype=np.float64).reshape(-1, _AXES), skipped
