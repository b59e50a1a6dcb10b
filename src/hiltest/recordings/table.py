"""Tables of readings, from any file."""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from itertools import chain, islice
from pathlib import Path

import numpy as np

from hiltest.errors import ConfigError
from hiltest.recordings.cells import Reals, TableRow, TableRows, is_number
from hiltest.recordings.forms import Form, Separated, counts, form_of
from hiltest.recordings.lines import Line, Lines

# In so many lines a table must have begun. An index is one that counts in all of them, three at least.
_LOOKED_AT = 100
_COUNTED = 3
_EVERYTHING = bytes(range(256))
# What makes other cells of a line than its separators say, or a number for Python that is none in a log.
_READ_ALONE = (b'"', b"\r", b"_")


class Table:
    """A table whose header is read; its rows can be read once, one by one or, where they are plain, many at once.

    Attributes
    ----------
    path : Path
    headers : tuple of str
        Names of the columns, empty without any.
    width : int
        Number of columns.
    places : tuple of int
        Columns that have something in them: a separator at the end of every row of a table without header makes none.
    index : int or None
        The column that counts the rows, or that pandas has no name for.
    comment : str
        The comment line just above the table.
    preamble : int
        Lines above the table that are no part of it.
    """

    def __init__(self, path: Path, lines: Lines, others: Iterator[Line], looked_at: Sequence[Line], form: Form) -> None:
        self.path, self._form = path, form
        self.headers, self.width, self.preamble = form.headers, form.width, form.preamble
        first = looked_at[form.preamble]
        self.comment, self._stamped = first.comment, not math.isnan(first.arrived_s)
        rows = [cells for line in looked_at[form.first :] if len(cells := self._cells(line.text)) == self.width]
        separator = not self.headers and bool(rows) and not any(row[-1] for row in rows)
        self.places = tuple(range(self.width - separator))
        self.index = 0 if _is_index(self.headers, [row[0] for row in rows]) else None
        self._ends_in_number = bool(rows) and is_number(rows[0][-1])
        self._lines = chain(looked_at[form.first :], others)
        self._behind, self._looked_to = lines, looked_at[-1].number
        self._others = 0
        self._cut: int | None = None

    def names(self, places: Sequence[int]) -> tuple[str, ...]:
        """Return what columns are called: their names, or their numbers from 1 where there are none."""
        return tuple(self.headers[place] if self.headers else str(place + 1) for place in places)

    @property
    def notes(self) -> tuple[str, ...]:
        """What was skipped, recognised or assumed, a sentence each; complete when the rows are read."""
        notes = list(self._form.notes)
        if self._stamped:
            notes.insert(0, "The time before each line was taken as that at which a serial monitor got the line.")
        if self._others:
            notes.append(f"{self._others} lines that do not begin with {self._form.begins} were skipped.")
        if self._cut is not None:
            notes.append(f"The last line, {self._cut}, is cut off and was skipped.")
        return tuple(notes)

    def rows(self) -> Iterator[TableRow]:
        """Yield the rows, each with a cell for every column.

        Raises
        ------
        ConfigError
            At a row that has not; names file and line.
        """
        split, width, begins = self._form.split, self.width, self._form.begins
        for number, text, _, arrived_s in self._lines:
            if begins and not text.startswith(begins):
                self._others += 1
                continue
            try:
                cells = split(text)
            except ValueError as error:
                if text.endswith("\n"):
                    raise ConfigError(f"{self.path}:{number}: {error}") from error
                cells = ()
            if len(cells) != width:
                cells = self._fitted(cells)
            if text[-1] != "\n" and self._is_cut(cells):
                self._cut = number
                return
            if len(cells) != width:
                raise ConfigError(f"{self.path}:{number}: {len(cells)} cells where the table has {width} columns; "
                                  "correct or delete the line")
            yield TableRow(number, cells, arrived_s)

    def rows_of_numbers(self, places: Sequence[int], largest: Sequence[float]) -> Iterator[TableRow | TableRows]:
        """Yield what `rows` does, and in the place of many plain rows their numbers.

        Parameters
        ----------
        places
            Columns that are read.
        largest
            For each of them, what no number is beyond. A row with a number beyond it, or with a cell that is none,
            comes by itself.
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
        """Return the numbers in columns of plain lines, None where one of the lines may be anything but such a row."""
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
            # Behind the last delimiter is no cell.
            return np.column_stack([np.fromiter(map(float, cells[place : -1 : self.width]), float) for place in places])
        except ValueError:
            return None

    def _cells(self, text: str) -> tuple[str, ...]:
        try:
            return self._form.split(text)
        except ValueError:
            return ()

    def _fitted(self, cells: tuple[str, ...]) -> tuple[str, ...]:
        """Return a row with, or without, a separator at its end, as the header has it."""
        if len(cells) == self.width + 1 and not cells[-1]:
            return cells[:-1]
        if len(cells) == self.width - 1 and self.headers and not self.headers[-1]:
            return (*cells, "")
        return cells

    def _is_cut(self, cells: tuple[str, ...]) -> bool:
        """Say whether a line without an end is a part of a row, as a logger that was stopped leaves it."""
        return len(cells) < self.width or (self._ends_in_number and bool(cells[-1]) and not is_number(cells[-1]))


def open_table(path: Path, *, fewest: int = 3) -> Table:
    """Open the table of a file: comma, semicolon, tab or blanks between cells, MotionCal's lines, or lines of JSON.

    Parameters
    ----------
    path
        As `hiltest.recordings.lines.read_lines` takes it. A text may be above the table.
    fewest
        Numbers that a row of readings has at least, where a header may be above it.

    Raises
    ------
    ConfigError
        When the file cannot be read or has no table; names file and line.
    """
    lines = Lines(path)
    each = iter(lines)
    looked_at = list(islice(each, _LOOKED_AT))
    if not looked_at:
        raise ConfigError(f"{path}: the file is empty")
    return Table(path, lines, each, looked_at, form_of(path, looked_at, fewest))


def _is_index(headers: Sequence[str], cells: Sequence[str]) -> bool:
    if headers and headers[0] in ("", "Unnamed: 0"):
        return True
    return len(cells) >= _COUNTED and counts(cells)
