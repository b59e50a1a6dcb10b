"""Cells of a table as numbers, and which row is the header."""

from __future__ import annotations

import math
from collections.abc import Iterator
from itertools import chain
from pathlib import Path

from hiltest.cloud.table import Row
from hiltest.errors import ConfigError

_AXES = 3
# Beyond 32 bits of any sensor: not a reading, and squares of squares would leave float64.
LARGEST_READING = 2.0**32


def split_header(first: Row, rest: Iterator[Row]) -> tuple[tuple[str, ...], Iterator[Row]]:
    """Return the names of the columns, empty when there are none, and the rows of data."""
    if sum(is_number(cell) for cell in first.cells) < _AXES:
        return first.cells, rest
    as_comment = len(first.comment) == len(first.cells) and not any(map(is_number, first.comment))
    return (first.comment if as_comment else ()), chain([first], rest)


def check_width(path: Path, row: Row, width: int) -> None:
    """Refuse a row that has not as many cells as the table has columns.

    Raises
    ------
    ConfigError
    """
    if len(row.cells) != width:
        raise ConfigError(
            f"{path}:{row.line}: {len(row.cells)} cells where the table has {width} columns; "
            "correct or delete the line"
        )


def number_in(
    path: Path, row: Row, place: int, name: str, *, what: str, largest: float = LARGEST_READING
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
