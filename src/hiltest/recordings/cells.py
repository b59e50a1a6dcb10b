"""Rows of cells of a table, and the numbers in them."""

from __future__ import annotations

import math
from pathlib import Path
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from hiltest.errors import ConfigError

Reals = NDArray[np.float64]

# Beyond 32 bits of any sensor: not a reading, and squares of squares would leave float64.
LARGEST_READING = 2.0**32


class TableRow(NamedTuple):
    """One row of readings."""

    line: int
    """From 1."""
    cells: tuple[str, ...]
    """Without quotes and surrounding blanks."""
    arrived_s: float = math.nan
    """When a serial monitor says that the line came [s of the day]; NaN where none does."""


class TableRows(NamedTuple):
    """Rows of readings, each the line after the one before."""

    line: int
    """Of the first."""
    numbers: Reals
    """Shape (rows, columns)."""


def number_in(
    path: Path, row: TableRow, place: int, name: str, *, what: str, largest: float = LARGEST_READING
) -> float:
    """Return a cell's number; an empty cell is not a number, as loggers leave it where nothing was measured.

    Raises
    ------
    ConfigError
        When it is something else, or too large for what it is; names file, line and column.
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
        raise ConfigError(f"{where}: {shown(cell)} is no {what}")
    return value


def number_or_nan(cell: str, largest: float) -> float:
    """Return a cell's number; NaN where it is none, or too large for what it is."""
    value = float(cell) if is_number(cell) else math.nan
    return value if abs(value) <= largest else math.nan


def is_number(cell: str) -> bool:
    """Say whether a cell is a number as loggers write one."""
    try:
        float(cell)
    except ValueError:
        return False
    return "_" not in cell  # float() takes 1_000


def shown(cell: str) -> str:
    """Return a cell as a message shows it."""
    return repr(cell if len(cell) <= 40 else f"{cell[:40]}...")
