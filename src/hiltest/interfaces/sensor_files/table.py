"""Tables of readings, from any file."""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from contextlib import suppress
from itertools import chain, islice
from pathlib import Path

import numpy as np

from hiltest.errors import ConfigError
from hiltest.interfaces.sensor_files.binary_logs import read_binary
from hiltest.interfaces.sensor_files.cells import Reals, TableRow, TableRows, is_number
from hiltest.interfaces.sensor_files.columns import add_ros_units
from hiltest.interfaces.sensor_files.forms import Form, Separated, counts, form_of, form_of_rows
from hiltest.interfaces.sensor_files.named_lines import NamedLines
from hiltest.interfaces.sensor_files.parsed_lines import Line, Lines

# Number of lines within which a table must begin. An index column counts in all of them, at least three.
_LOOKED_AT = 100
_COUNTED = 3
_EVERYTHING = bytes(range(256))
# Characters that change the cells of a line besides its separators, or that only Python accepts in numbers.
_READ_ALONE = (b'"', b"\r", b"_")


class Table:
    """A table with its header read; its rows can be read once, one by one or, if plain, many at once.

    Attributes
    ----------
    path : Path
    headers : tuple of str
        Names of the columns; empty without a header.
    width : int
        Number of columns.
    places : tuple of int
        Columns with content: a trailing separator in every row of a table without header adds none.
    index : int or None
        Column that counts the rows, or pandas' unnamed one.
    comment : str
        Comment line just above the table.
    preamble : int
        Number of lines above the table.
    first_rows : list of tuple of str
        Cells of the first rows that fit the table.
    text : str
        Lines above the table.
    """

    def __init__(self, path: Path, lines: Lines, others: Iterator[Line], looked_at: Sequence[Line], form: Form) -> None:
        self.path, self._form = path, form
        self.headers, self.width, self.preamble = add_ros_units(form.headers), form.width, form.preamble
        first = looked_at[form.preamble]
        self.comment, self._stamped = first.comment, not math.isnan(first.arrived_s)
        rows = self._first_rows(looked_at[form.first :])
        self.first_rows = rows
        self.text = "\n".join(line.text for line in looked_at[: form.preamble])
        separator = not self.headers and bool(rows) and not any(row[-1] for row in rows)
        self.places = tuple(range(self.width - separator))
        self.index = 0 if _is_index(self.headers, [row[0] for row in rows]) else None
        self._ends_in_number = bool(rows) and is_number(rows[0][-1])
        self._lines = chain(looked_at[form.first :], others)
        self._behind, self._looked_to = lines, looked_at[-1].number
        self._cut: int | None = None

    def names(self, places: Sequence[int]) -> tuple[str, ...]:
        """Return the names of columns, or their numbers from 1 without a header."""
        return tuple(self.headers[place] if self.headers else str(place + 1) for place in places)

    @property
    def notes(self) -> tuple[str, ...]:
        """Remarks on skipped, recognised or assumed content, one sentence each; complete after the rows are read."""
        notes = list(self._form.notes)
        if self._stamped:
            notes.insert(0, "The time before each line was taken as that of its reading.")
        if self._cut is not None:
            notes.append(f"The last line, {self._cut}, is cut off and was skipped.")
        return tuple(notes)

    def rows(self) -> Iterator[TableRow]:
        """Yield the rows, each with a cell for every column.

        Raises
        ------
        ConfigError
            At a row without; the message has file and line.
        """
        width, text = self.width, "\n"

        def lines() -> Iterator[Line]:
            nonlocal text
            for line in self._lines:
                text = line.text
                yield line

        for row in self._form.rows(lines()):
            number, cells, arrived_s = row
            if len(cells) != width:
                cells = self._fit_separator(cells)
            if text[-1] != "\n" and self._is_cut(cells):
                self._cut = number
                return
            if len(cells) != width:
                raise ConfigError(
                    f"{self.path}:{number}: {len(cells)} cells where the table has {width} columns; "
                    "correct or delete the line"
                )
            yield TableRow(number, cells, arrived_s)

    def rows_of_numbers(self, places: Sequence[int], largest: Sequence[float]) -> Iterator[TableRow | TableRows]:
        """Yield the rows of `rows`, with many plain rows replaced by their numbers.

        Parameters
        ----------
        places
            Columns that are read.
        largest
            Largest number in each of them. A row with a larger number, or with a cell that is not a number, is yielded
            separately.
        """
        separated = self._form.separated
        for row in self.rows():
            yield row
            while separated and row.line >= self._looked_to and (lines := self._behind.ahead()):
                numbers = self._numbers(lines, separated, places)
                if numbers is None or not bool((np.abs(numbers) <= largest).all()):
                    self._behind.refuse(lines)
                else:
                    yield TableRows(self._behind.take(lines), numbers)

    def _numbers(self, lines: bytes, separated: Separated, places: Sequence[int]) -> Reals | None:
        """Return the numbers in columns of plain lines; None if one of the lines may not be such a row."""
        lines = lines.replace(b"\r\n", b"\n")
        if any(mark in lines for mark in _READ_ALONE):
            return None
        delimiter, decimal = separated
        if delimiter is None:
            delimiter, lines = b" ", b"\n".join([b" ".join(line.split()) for line in lines.split(b"\n")])
        if decimal != b".":
            lines = lines.replace(decimal, b".")
        ends = delimiter + b"\n"
        row = ends[:1] * (self.width - 1) + ends[1:]
        count = lines.count(b"\n")
        if lines.translate(None, _EVERYTHING.translate(None, ends)) != row * count:
            return None
        cells = lines.replace(b"\n", delimiter).split(delimiter)
        try:
            # There is no cell after the last delimiter.
            return np.column_stack([np.fromiter(map(float, cells[place : -1 : self.width]), float) for place in places])
        except ValueError:
            return None

    def _first_rows(self, lines: Sequence[Line]) -> list[tuple[str, ...]]:
        """Return the rows of the first lines that fit the table."""
        rows: list[tuple[str, ...]] = []
        notes = list(self._form.notes)
        with suppress(ConfigError):  # reading the rows reports it
            rows.extend(row.cells for row in self._form.rows(lines) if len(row.cells) == self.width)
        self._form.notes[:] = notes
        return rows

    def _fit_separator(self, cells: tuple[str, ...]) -> tuple[str, ...]:
        """Return a row with or without a trailing separator, like the header."""
        if len(cells) == self.width + 1 and not cells[-1]:
            return cells[:-1]
        if len(cells) == self.width - 1 and self.headers and not self.headers[-1]:
            return (*cells, "")
        return cells

    def _is_cut(self, cells: tuple[str, ...]) -> bool:
        """Return whether a line without an end is an incomplete row, as a stopped logger leaves it."""
        return len(cells) < self.width or (self._ends_in_number and bool(cells[-1]) and not is_number(cells[-1]))


def open_table(path: Path, *, fewest: int = 3) -> Table:
    """Open the table of a file: separated cells, lines that name their numbers, JSON, or a binary log.

    Parameters
    ----------
    path
        File, see `hiltest.interfaces.sensor_files.parsed_lines.read_lines`. It may have text above the table.
    fewest
        Minimum count of numbers in a row of readings that may have a header above it.

    Raises
    ------
    ConfigError
        When the file cannot be read or has no table; the message has file and line.
    """
    lines = Lines(path)
    if (rows := read_binary(path)) is not None:
        if (form := form_of_rows(rows, len(rows))) is None:
            raise ConfigError(f"{path}: no message of a magnetometer, an accelerometer or a gyroscope")
        return Table(path, lines, iter(()), [Line(1, "\n", "", math.nan)], form)
    remaining_lines = iter(lines)
    looked_at = list(islice(remaining_lines, _LOOKED_AT))
    if not looked_at:  # as from the Razor IMU, whose lines all begin with #
        lines = Lines(path, comments=())
        remaining_lines = iter(lines)
        looked_at = list(islice(remaining_lines, _LOOKED_AT))
        if not NamedLines(looked_at).columns:
            raise ConfigError(f"{path}: the file is empty")
    return Table(path, lines, remaining_lines, looked_at, form_of(path, looked_at, remaining_lines, fewest))


def _is_index(headers: Sequence[str], cells: Sequence[str]) -> bool:
    if headers and headers[0] in ("", "Unnamed: 0"):
        return True
    return len(cells) >= _COUNTED and counts(cells)
