"""Numbers out of a table of the record, and as text into one of the page."""

from __future__ import annotations

import math
from collections.abc import Iterable

from hiltest.measurement import Measurement
from hiltest.record.run import Cell, Table
from hiltest.text import readable


def numbers(table: Table, column: str) -> list[float]:
    """Return a column as floats; what is no number is NaN and is not drawn."""
    return [_number(cell) for cell in table.column_if_any(column)]


def names_after(table: Table, prefix: str) -> list[str]:
    """Return what stands behind a prefix in the names of a table's columns."""
    return [each.name.removeprefix(prefix) for each in table.columns if each.name.startswith(prefix)]


def upper_limit(measurement: Measurement | None) -> float | None:
    """Return how large a measurement may be, None without a limit."""
    return None if measurement is None or measurement.limit is None else measurement.limit.max


def written(cells: Iterable[Cell], digits: int = 4) -> list[str]:
    """Return cells as people read them; a hole is empty."""
    return [_written(cell, digits) for cell in cells]


def _number(cell: Cell) -> float:
    return float(cell) if isinstance(cell, int | float) and not isinstance(cell, bool) else math.nan


def _written(cell: Cell, digits: int) -> str:
    if cell is None or isinstance(cell, str):
        return cell or ""
    if isinstance(cell, bool):
        return "yes" if cell else "no"
    return readable(cell, digits) if math.isfinite(cell) else ""
