"""Rows of cells of a table, and the numbers in them."""

from __future__ import annotations

import math
from pathlib import Path
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from hiltest.errors import ConfigError

Reals = NDArray[np.float64]

# Largest reading, beyond 32 bits of any sensor; fourth powers of larger ones would overflow float64.
LARGEST_READING = 2.0**32


class TableRow(NamedTuple):
    """One row of readings."""

    line: int
    """Line in the file, from 1."""
    cells: tuple[str, ...]
    """Cells without quotes and surrounding blanks."""
    arrived_s: float = math.nan
    """Time of day from a serial monitor [s]; NaN without one."""


class TableRows(NamedTuple):
    """Rows of readings on consecutive lines."""

    line: int
    """Line of the first row."""
    numbers: Reals
    """Shape (rows, columns)."""


def number_in(
    path: Path, row: TableRow, place: int, name: str, *, quantity: str, largest: float = LARGEST_READING
) -> float:
    """Return a cell's number; NaN for an empty cell, which loggers leave without a measurement.

    Raises
    ------
    ConfigError
        When it is something else, or too large for its quantity; the message has file, line and column.
    """
    cell = row.cells[place]
    if not cell:
        return math.nan
    where = f"{path}:{row.line}: column {name}"
    if not is_number(cell):
        decimal_comma = "; decimals need a point, not a comma" if is_number(cell.replace(",", ".")) else ""
        raise ConfigError(f"{where}: {shown(cell)} is not a number{decimal_comma}")
    value = float(cell)
    if math.isfinite(value) and abs(value) > largest:
        raise ConfigError(f"{where}: {shown(cell)} is no {quantity}")
    return value


def number_or_nan(cell: str, largest: float) -> float:
    """Return a cell's number; NaN if it is not a number, or larger than `largest`."""
    value = float(cell) if is_number(cell) else math.nan
    return value if abs(value) <= largest else math.nan


def is_number(cell: str) -> bool:
    """Return whether a cell is a number in a logger's format."""
    try:
        float(cell)
    except ValueError:
        return False
    return "_" not in cell  # float() accepts 1_000


def shown(cell: str) -> str:
    """Return a cell for a message."""
    return repr(cell if len(cell) <= 40 else f"{cell[:40]}...")
