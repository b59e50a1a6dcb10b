"""Rows of cells of a text table, from any file."""

from __future__ import annotations

import csv
import gzip
import math
import zlib
from collections.abc import Iterator
from dataclasses import dataclass
from itertools import chain
from pathlib import Path
from typing import BinaryIO, cast

from hiltest.errors import ConfigError

# A table line is shorter by far; what is not must not fill the memory.
_LONGEST_LINE = 65_536
# Hours of any sensor. A small compressed file could otherwise go on for ever.
_MOST_BYTES = 512 << 20
_BYTE_ORDER_MARKS = {b"\xff\xfe": "UTF-16", b"\xfe\xff": "UTF-16"}
_COMMENTS = ("#", "%", "//")
# What separates cells, tried in this order on the first line that is no comment.
_DELIMITERS = ("\t", ";", ",")


@dataclass(frozen=True, slots=True)
class TableRow:
    """One line of a table that is neither empty nor a comment.

    Attributes
    ----------
    line : int
        From 1.
    cells : tuple of str
        Without quotes and surrounding blanks.
    comment : tuple of str
        Cells of the comment line just before, where a header may stand.
    """

    line: int
    cells: tuple[str, ...]
    comment: tuple[str, ...] = ()


def read_rows(path: Path) -> Iterator[TableRow]:
    """Yield the rows of a file: comma, semicolon, tab or blanks between cells, UTF-8, `#`, `%` or `//` comments.

    A file whose name ends in .gz is unpacked as it is read.

    Raises
    ------
    ConfigError
        When the file cannot be read or is no text table; names file and line.
    """
    try:
        with path.open("rb") as file:
            yield from _rows(path, _unpacked(path, file))
    except (OSError, EOFError, zlib.error) as error:
        raise ConfigError(f"{path}: {getattr(error, 'strerror', None) or error}") from error


def _unpacked(path: Path, file: BinaryIO) -> BinaryIO:
    return cast(BinaryIO, gzip.open(file)) if path.suffix == ".gz" else file


def _rows(path: Path, file: BinaryIO) -> Iterator[TableRow]:
    delimiter: str | None = None
    chosen = False
    comment = ""
    for line, text in _lines(path, file):
        stripped = text.strip()
        mark = next((mark for mark in _COMMENTS if stripped.startswith(mark)), None)
        if mark is not None:
            comment = stripped.removeprefix(mark)
        elif stripped:
            if not chosen:
                delimiter = next((each for each in _DELIMITERS if each in stripped), None)
                chosen = True
            before = _cells(comment, delimiter) if comment else ()
            if before is None:
                before = ()
            cells = _cells(text, delimiter)
            if cells is None and "\r" in text.strip("\r\n"):
                raise ConfigError(f"{path}:{line}: carriage returns within the line; save with line ends LF or CR LF")
            if cells is None:
                raise ConfigError(f"{path}:{line}: a quote is opened and not closed on the line")
            yield TableRow(line, cells, before)
            comment = ""


def _lines(path: Path, file: BinaryIO) -> Iterator[tuple[int, str]]:
    line, size = 0, 0
    while raw := file.readline(_LONGEST_LINE + 1):
        line += 1
        size += len(raw)
        if size > _MOST_BYTES:
            raise ConfigError(f"{path}:{line}: more than {_MOST_BYTES >> 20} MB of text; cut the file")
        if line == 1:
            encoding = _BYTE_ORDER_MARKS.get(raw[:2])
            if encoding:
                raise ConfigError(f"{path}: the file is {encoding}; save it as UTF-8")
            raw = raw.removeprefix(b"\xef\xbb\xbf")
        if b"\0" in raw:
            raise ConfigError(f"{path}:{line}: a zero byte: this is a binary file, not a text table")
        if len(raw) > _LONGEST_LINE:
            raise ConfigError(f"{path}:{line}: the line is longer than {_LONGEST_LINE} bytes: not a table of readings")
        try:
            yield line, raw.decode("utf-8")
        except UnicodeDecodeError as error:
            bad = raw[error.start]
            raise ConfigError(f"{path}:{line}: byte 0x{bad:02x} is not UTF-8; save the file as UTF-8") from error


def _cells(text: str, delimiter: str | None) -> tuple[str, ...] | None:
    """Return the cells of a line, None when a quote is left open."""
    if delimiter is None:
        return tuple(cell.strip('"') for cell in text.split())
    try:
        (cells,) = csv.reader([text.strip("\r\n")], delimiter=delimiter, skipinitialspace=True, strict=True)
    except (csv.Error, ValueError):
        return None
    return tuple(cell.strip() for cell in cells)


_AXES = 3
# Beyond 32 bits of any sensor: not a reading, and squares of squares would leave float64.
LARGEST_READING = 2.0**32


def split_header(first: TableRow, rest: Iterator[TableRow]) -> tuple[tuple[str, ...], Iterator[TableRow]]:
    """Return the names of the columns, empty when there are none, and the rows of data."""
    if sum(is_number(cell) for cell in first.cells) < _AXES:
        return first.cells, rest
    as_comment = len(first.comment) == len(first.cells) and not any(map(is_number, first.comment))
    return (first.comment if as_comment else ()), chain([first], rest)


def check_width(path: Path, row: TableRow, width: int) -> None:
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
