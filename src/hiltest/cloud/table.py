"""Rows of cells of a text table, from a file that may be anything."""

from __future__ import annotations

import csv
import gzip
import zlib
from collections.abc import Iterator
from dataclasses import dataclass
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
class Row:
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


def read_rows(path: Path) -> Iterator[Row]:
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


def _rows(path: Path, file: BinaryIO) -> Iterator[Row]:
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
            yield Row(line, cells, before)
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
