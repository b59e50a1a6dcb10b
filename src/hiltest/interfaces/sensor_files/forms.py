"""Forms of tables of readings: rows of cells below a text, MotionCal's lines, lines of JSON."""

from __future__ import annotations

import csv
import re
from collections.abc import Callable, Iterator, Sequence
from contextlib import suppress
from dataclasses import dataclass, field
from itertools import pairwise
from pathlib import Path
from typing import NamedTuple

from hiltest.errors import ConfigError
from hiltest.interfaces.sensor_files.cells import is_number, shown
from hiltest.interfaces.sensor_files.columns import axis_triples
from hiltest.interfaces.sensor_files.parsed_lines import Line
from hiltest.json_files import parse_json

_AXES = 3
# Separators of cells in the order of trial; blanks if a line has none of them.
_DELIMITERS = ("\t", ";", ",")
_MOTION_CAL = re.compile(r"Raw:(?:\s*-?\d{1,9}\s*,){8}\s*-?\d{1,9}\s*$")
# Counts per unit in the output of PJRC's and Adafruit's sketches for MotionCal.
_MOTION_CAL_COLUMNS = {
    **dict.fromkeys(("ax_g", "ay_g", "az_g"), 8192.0),
    **dict.fromkeys(("gx_dps", "gy_dps", "gz_dps"), 16.0),
    **dict.fromkeys(("mx_uT", "my_uT", "mz_uT"), 10.0),
}
_LIST_OF_THREE = re.compile(r"\[[^][,]*,[^][,]*,[^][,]*\]")
_LIST_OF_ROWS = re.compile(r"\[\s*[\[{]")
# More digits than any number of a column or row has, and few enough to be read at once.
_DIGITS = 10
# "1,234" is ambiguous: 1234 or 1.234.
_THOUSANDS = re.compile(r"[+-]?\d{1,3},\d{3}$")


class Separated(NamedTuple):
    """Cells with a delimiter between them, or blanks if it is None; and the decimal sign."""

    delimiter: bytes | None
    decimal: bytes


@dataclass(frozen=True, slots=True)
class Form:
    """Form of a file's lines as rows of a table."""

    headers: tuple[str, ...]
    """Names of the columns; empty without a header."""
    width: int
    first: int
    """Index of the first line of readings."""
    split: Callable[[str], tuple[str, ...]]
    """Returns the cells of a line, or raises a ValueError with the reason."""
    preamble: int = 0
    """Number of lines before the table."""
    begins: str = ""
    """Prefix of the table's lines; others are not part of it."""
    notes: list[str] = field(default_factory=list)
    """Remarks on recognised or assumed properties, one sentence each; `split` may add to them."""
    separated: Separated | None = None
    """Separators of `split`; None if the lines are not separated text."""


def form_of(path: Path, lines: Sequence[Line], fewest: int) -> Form:
    """Return the form of the table that begins in the first lines of a file.

    Parameters
    ----------
    lines
        Lines, at least one.
    fewest
        Minimum count of numbers in a row of readings that may have a header above it.

    Raises
    ------
    ConfigError
        When the start of the table is unclear; the message has the line.
    """
    return _motion_cal(lines) or _json_lines(lines) or _delimited_form(path, lines, fewest)


def _motion_cal(lines: Sequence[Line]) -> Form | None:
    if not any(_MOTION_CAL.match(line.text) for line in lines):
        return None
    note = (
        "Lines that begin with Raw: were read as MotionCal's: acceleration at 8192 counts for 1 g, rates at 16 for "
        "1 deg/s, field at 10 for 1 uT."
    )
    return Form(tuple(_MOTION_CAL_COLUMNS), len(_MOTION_CAL_COLUMNS), 0, _motion_cal_cells, begins="Raw:", notes=[note])


def _motion_cal_cells(text: str) -> tuple[str, ...]:
    if not _MOTION_CAL.match(text):
        raise ValueError("not nine whole numbers behind Raw:")
    counts = text.removeprefix("Raw:").split(",")
    return tuple(str(int(cell) / scale) for cell, scale in zip(counts, _MOTION_CAL_COLUMNS.values(), strict=True))


def _json_lines(lines: Sequence[Line]) -> Form | None:
    first = next((place for place, line in enumerate(lines) if line.text.lstrip().startswith("{")), None)
    if first is None or not all(line.text.lstrip().startswith("{") for line in lines[first : first + 2]):
        return None
    if len(lines) == first + 1 and _LIST_OF_ROWS.search(lines[first].text):
        return None  # one JSON document that contains its rows
    names: dict[str, None] = {}
    for line in lines[first:]:
        with suppress(ValueError):  # the row parser reports the error
            names |= dict.fromkeys(_values(line.text))
    if not names:
        return None
    notes = _skipped_notes(lines[:first])
    if any(_LIST_OF_THREE.search(line.text) for line in lines[first:]):
        notes.append("Lists of three numbers in JSON were taken as x, y and z.")
    unread: set[str] = set()

    def cells(text: str) -> tuple[str, ...]:
        values = _values(text)
        if not unread and (others := values.keys() - names):
            unread.update(others)
            notes.append(
                f"Keys of JSON that are not in the first {len(lines)} lines, such as {shown(min(others))}, "
                "were not read."
            )
        return tuple([values.get(name, "") for name in names])

    return Form(tuple(names), len(names), first, cells, first, notes=notes)


def _values(text: str) -> dict[str, str]:
    """Return the values of a JSON object, by keys with dots between the levels; raise a ValueError for other text."""
    content = parse_json(text)
    if not isinstance(content, dict):
        raise ValueError("not an object")
    pairs = list(_flat(content, ""))
    values = dict(pairs)
    if len(values) < len(pairs):
        raise ValueError("two keys are the same when levels are joined by points")
    return values


def _flat(value: object, name: str) -> Iterator[tuple[str, str]]:
    if isinstance(value, dict):
        inner = list(value.items())
    elif isinstance(value, list):
        inner = list(zip("xyz" if len(value) == _AXES else map(str, range(len(value))), value, strict=True))
    else:
        yield name, "" if value is None else str(value).strip()
        return
    for key, inner_value in inner:
        yield from _flat(inner_value, f"{name}.{key}" if name else key)


def _delimited_form(path: Path, lines: Sequence[Line], fewest: int) -> Form:
    """Return the form of rows of cells, which may have text above them.

    A table is only searched further down if the first line does not fit the lines below it.
    """
    own = _delimiter(lines[0].text)
    for decimal in (".", ","):
        look = _Look(path, lines, own, decimal)
        place = look.fitting(fewest)
        if place is not None:
            begin, has_header = look.begin(place, fewest)
            return look.form(begin, has_header=has_header)
        looks = {delimiter: _Look(path, lines, delimiter, decimal) for delimiter in (*_DELIMITERS, None)}
        for place, line in enumerate(lines):
            look = looks[_delimiter(line.text)]
            if look.may_begin(place, max(fewest, _AXES)):
                has_header = look.has_header_above(place)
                if not has_header:
                    look.refuse_lost(place)
                return look.form(place - has_header, has_header=has_header)
    if lines[0].text.lstrip().startswith(("{", "[{", "[[")) or lines[0].text.strip() == "[":
        raise ConfigError(f"{path}: JSON, but not an object on each line; jq -c writes it so")
    # There are no readings, which the reader reports.
    look = _Look(path, lines, own, ".")
    try:
        look.cells(lines[0].text)
    except ValueError as error:
        raise ConfigError(f"{path}:{lines[0].number}: {error}") from error
    return look.form(0, has_header=look.numbers(0) < fewest)


class _Look:
    """The first lines of a file, as rows of cells with one delimiter and one decimal sign."""

    def __init__(self, path: Path, lines: Sequence[Line], delimiter: str | None, decimal: str) -> None:
        self.path, self.lines, self.delimiter, self.decimal = path, lines, delimiter, decimal
        self.rows: list[tuple[str, ...]] = []
        for line in lines:
            try:
                self.rows.append(self.cells(line.text))
            except ValueError:
                self.rows.append(())

    def cells(self, text: str) -> tuple[str, ...]:
        cells = _cells(text, self.delimiter)
        # If a comma separates cells, it is not a decimal sign.
        return cells if self.decimal == "." or self.delimiter == "," else tuple([c.replace(",", ".") for c in cells])

    def numbers(self, place: int) -> int:
        return sum(map(is_number, self.rows[place]))

    def may_begin(self, place: int, fewest: int) -> bool:
        """Return whether a table may begin at a row: one with numbers only, or with as many cells as the next."""
        row = self.rows[place]
        alone = all(not cell or is_number(cell) for cell in row)
        return self.numbers(place) >= fewest and (alone or [len(row)] == [*map(len, self.rows[place + 1 : place + 2])])

    def fitting(self, fewest: int) -> int | None:
        """Return the first row of readings that the first row fits, which is then its header or a reading too."""
        places = range(len(self.rows) if any(self.rows[0]) else 0)
        return next(
            (place for place in places if self.may_begin(place, fewest) and _fits(self.rows[0], self.rows[place])), None
        )

    def begin(self, place: int, fewest: int) -> tuple[int, bool]:
        """Return the first row of a table whose first row fits its first readings, and whether it is a header."""
        if self.numbers(0) >= fewest:
            return 0, False
        named = self.has_header_above(place) and axis_triples(self.rows[place - 1]) and not axis_triples(self.rows[0])
        return place - 1 if named else 0, True

    def has_header_above(self, place: int) -> bool:
        """Return whether the row just above one of readings has a name for each of its cells."""
        above = self.rows[place - 1] if place else ()
        return any(above) and not self.numbers(place - 1) and _fits(above, self.rows[place])

    def refuse_lost(self, place: int) -> None:
        """Refuse to skip possible readings, or a header that does not fit them."""
        for line, row in zip(self.lines[:place], self.rows, strict=False):
            delimiter = _delimiter(line.text)
            own = _cells_or_nothing(line.text, delimiter)
            numbers = sum(map(is_number, own))
            readings = numbers >= _AXES and (numbers == len(own) or delimiter == self.delimiter)
            names = (
                self.delimiter is not None
                and len(row) >= _AXES
                and not any(not cell or is_number(cell) or " " in cell for cell in row)
            )
            if readings or names or axis_triples(own):
                raise ConfigError(
                    f"{self.path}:{line.number}: {len(own)} cells, and {len(self.rows[place])} in line "
                    f"{self.lines[place].number}, where readings begin; correct or delete the line"
                )

    def form(self, begin: int, *, has_header: bool) -> Form:
        """Return the form of a table that begins at a row."""
        headers, first = (self.rows[begin], begin + 1) if has_header else (self._comment(begin), begin)
        notes = _skipped_notes(self.lines[:begin])
        if not headers and _is_numbered(self.rows[first : first + 2]):
            notes.append(
                f"Line {self.lines[first].number}, {shown(','.join(self.rows[first]))}, was taken as pandas' "
                "numbers of the columns, not as a reading."
            )
            first += 1
        if self.decimal == ",":
            self._refuse_thousands(first)
            notes.append("Commas within numbers were taken as decimal points.")
        separated = Separated(
            self.delimiter.encode() if self.delimiter else None,
            b"." if self.delimiter == "," else self.decimal.encode(),
        )
        return Form(
            headers, len(headers or self.rows[begin]), first, self.cells, begin, notes=notes, separated=separated
        )

    def _comment(self, place: int) -> tuple[str, ...]:
        """Return the header in a comment above a row."""
        try:
            cells = _cells(self.lines[place].comment, self.delimiter)
        except ValueError:
            return ()
        return cells if len(cells) == len(self.rows[place]) and not any(map(is_number, cells)) else ()

    def _refuse_thousands(self, first: int) -> None:
        rows = [_cells_or_nothing(line.text, self.delimiter) for line in self.lines[first:]]
        cells = [cell for row in rows for cell in row if "," in cell]
        if all(map(_THOUSANDS.match, cells)):
            raise ConfigError(
                f"{self.path}:{self.lines[first].number}: is {shown(cells[0])} above one thousand, or "
                "below? Save the file with decimal points"
            )


def _is_numbered(rows: Sequence[tuple[str, ...]]) -> bool:
    """Return whether the first of two rows, and only this one, numbers the columns as pandas does."""
    if len(rows) < 2:
        return False
    cells, after = (row[1:] if row and row[0] in ("", "Unnamed: 0") else row for row in rows)
    return len(cells) >= _AXES and cells == (*map(str, range(len(cells))),) and not counts(after)


def counts(cells: Sequence[str]) -> bool:
    """Return whether cells are whole numbers, each one more than the one before."""
    if not all(cell.isascii() and cell.isdigit() and len(cell) < _DIGITS for cell in cells):
        return False
    return all(int(after) == int(before) + 1 for before, after in pairwise(cells))


def _fits(header: Sequence[str], row: Sequence[str]) -> bool:
    """Return whether a row has a cell for each name; a trailing separator in only one of them is ignored."""
    longer = max(header, row, key=len)
    return len(header) == len(row) or (abs(len(header) - len(row)) == 1 and not longer[-1])


def _skipped_notes(lines: Sequence[Line]) -> list[str]:
    if not lines:
        return []
    which = f"Line {lines[0].number}" if len(lines) == 1 else f"Lines {lines[0].number} to {lines[-1].number}"
    text = shown(lines[0].text.strip())
    return [f"{which}, above the table and no part of it, {'was' if len(lines) == 1 else 'were'} skipped: {text}."]


def _delimiter(text: str) -> str | None:
    return next((delimiter for delimiter in _DELIMITERS if delimiter in text.strip()), None)


def _cells_or_nothing(text: str, delimiter: str | None) -> tuple[str, ...]:
    try:
        return _cells(text, delimiter)
    except ValueError:
        return ()


def _cells(text: str, delimiter: str | None) -> tuple[str, ...]:
    """Return the cells of a line, or raise a ValueError with the reason."""
    if delimiter is None:
        return tuple([cell.strip('"') for cell in text.split()])
    text = text.strip("\r\n")
    if '"' not in text and "\r" not in text:
        return tuple([cell.strip() for cell in text.split(delimiter)])
    try:
        (cells,) = csv.reader([text], delimiter=delimiter, skipinitialspace=True, strict=True)
    except (csv.Error, ValueError) as error:
        if "\r" in text:
            raise ValueError("carriage returns within the line; save with line ends LF or CR LF") from error
        raise ValueError("a quote is opened and not closed on the line") from error
    return tuple([cell.strip() for cell in cells])
