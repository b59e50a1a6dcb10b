"""Forms of tables of readings: rows of cells below a text, lines that name their numbers, JSON."""

from __future__ import annotations

import csv
import math
import re
from collections.abc import Callable, Iterable, Iterator, Sequence
from contextlib import suppress
from dataclasses import dataclass, field, replace
from itertools import chain, pairwise, zip_longest
from pathlib import Path
from typing import NamedTuple

from hiltest.budgets import TABLE_DOCUMENT
from hiltest.errors import ConfigError
from hiltest.interfaces.sensor_files.cells import TableRow, is_number, shown
from hiltest.interfaces.sensor_files.columns import axis_triples, is_sensor, is_unit, seconds_of, stem_and_axis
from hiltest.interfaces.sensor_files.named_lines import MOTION_CAL_NOTE, ROS_TIME, NamedLines, ros_stamp
from hiltest.interfaces.sensor_files.parsed_lines import Line
from hiltest.json_files import parse_json

_AXES = 3
_FEWEST_TAGS = 2
# Separators of cells in the order of trial; blanks if a line has none of them.
_DELIMITERS = ("\t", ";", ",", "|")
_LIST_OF_THREE = re.compile(r"\[[^][,]*,[^][,]*,[^][,]*\]")
# A list of rows or of a column.
_LONG_LIST = re.compile(r"\[\s*[\[{]|\[[^][,]*(?:,[^][,]*){3}")
# A document of JSON, not a list of numbers or a word in brackets.
_JSON_START = re.compile(r"\s*(?:\[\s*(?:[\[{]|$)|\{\s*(?:\"|$))")
# Rows of a JSON document whose keys are its columns.
_FIRST_ROWS = 100
# Cells in a row below the names of sensors.
_PARTS_OF_NAMES = frozenset(("", "x", "y", "z", "cal", "raw", "uncal"))
_BRACKETED_UNIT = re.compile(r"\s*[(\[][^)\]]*[)\]]$")
_UNIT_KEYS = frozenset(("unit", "units"))
# The sensor of a row, in a cell of it.
_TAG = re.compile(r"(?:[\w./ -]*[\W_])?(?:un)?(?:cal)?(?:mag|acc|gyr)[a-z]*", re.IGNORECASE)
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
    rows: Callable[[Iterable[Line]], Iterator[TableRow]]
    """Yields the rows of lines, with cells that may not fit the width; raises a ConfigError for a line that is none."""
    preamble: int = 0
    """Number of lines before the table."""
    notes: list[str] = field(default_factory=list)
    """Remarks on recognised or assumed properties, one sentence each; `rows` may add to them."""
    separated: Separated | None = None
    """Separators of a table's cells; None if the lines are not separated text."""


def form_of(path: Path, lines: Sequence[Line], others: Iterator[Line], fewest: int) -> Form:
    """Return the form of the table that begins in the first lines of a file.

    Parameters
    ----------
    lines
        Lines, at least one.
    others
        Lines behind them, which only a document of JSON consumes.
    fewest
        Minimum count of numbers in a row of readings that may have a header above it.

    Raises
    ------
    ConfigError
        When the start of the table is unclear; the message has the line.
    """
    return (
        _json_lines(path, lines)
        or _json_document(path, lines, others)
        or _named_lines(lines)
        or _delimited_form(path, lines, fewest)
    )


def form_of_rows(rows: Sequence[dict[str, str]], count: int) -> Form | None:
    """Return the form of rows that are read already, with the columns of the first `count`; None without any."""

    def values(_: Iterable[Line]) -> Iterator[tuple[Line, dict[str, str]]]:
        return ((Line(number, "\n", "", math.nan), row) for number, row in enumerate(rows, 1))

    return _json_form(rows[:count], values, (), f"first {count} rows", ())


def _named_lines(lines: Sequence[Line]) -> Form | None:
    named = NamedLines(lines)
    headers = (_cells_or_nothing(line.text, _delimiter(line.text)) for line in lines if named.counters)
    if not named.columns or any(map(axis_triples, headers)):
        return None
    notes = [MOTION_CAL_NOTE] if named.word == "raw" else []

    def rows(lines: Iterable[Line]) -> Iterator[TableRow]:
        yield from named.rows(lines)
        if named.others:
            notes.append(f"{named.others} lines without a named reading were skipped.")

    return Form(named.columns, len(named.columns), 0, rows, notes=notes)


def _json_lines(path: Path, lines: Sequence[Line]) -> Form | None:
    first = next((place for place, line in enumerate(lines) if line.text.lstrip().startswith("{")), None)
    if first is None or not all(line.text.lstrip().startswith("{") for line in lines[first : first + 2]):
        return None
    is_document = len(lines) == first + 1 and _LONG_LIST.search(lines[first].text)
    if is_document or lines[0].text.startswith("["):
        return None  # one JSON document that contains its rows
    tables = []
    for line in lines[first:]:
        with suppress(ValueError):  # the row parser reports the error
            tables.append(_values(line.text))

    def values(lines: Iterable[Line]) -> Iterator[tuple[Line, dict[str, str]]]:
        for line in lines:
            try:
                yield line, _values(line.text)
            except ValueError as error:
                if line.text.endswith("\n"):
                    raise ConfigError(f"{path}:{line.number}: {error}") from error
                yield line, {}

    texts = [line.text for line in lines[first:]]
    return _json_form(tables, values, lines[:first], f"first {len(lines)} lines", texts)


def _json_document(path: Path, lines: Sequence[Line], others: Iterator[Line]) -> Form | None:
    """Return the form of one JSON document with its rows in lists of objects or lists, or its columns in lists."""
    if not _JSON_START.match(lines[0].text):
        return None
    with suppress(ValueError):  # a first line that is JSON by itself begins other forms
        parse_json(lines[0].text)
        if len(lines) > 1:
            return None
    text = "".join(line.text for line in chain(lines, others))
    try:
        rows = [_joined(dict(_flat(row, ""))) for row in _rows_of(parse_json(text, TABLE_DOCUMENT))]
    except ValueError as error:
        raise ConfigError(f"{path}: JSON, but no table of readings: {error}") from error

    return form_of_rows(rows, _FIRST_ROWS)


def _json_form(
    first_rows: Sequence[dict[str, str]],
    values: Callable[[Iterable[Line]], Iterator[tuple[Line, dict[str, str]]]],
    skipped: Sequence[Line],
    looked_at: str,
    texts: Sequence[str],
) -> Form | None:
    names = list(dict.fromkeys(name for row in first_rows for name in row))
    if not names:
        return None
    notes = _skipped_notes(skipped)
    if any(map(_LIST_OF_THREE.search, texts)):
        notes.append("Lists of three numbers in JSON were taken as x, y and z.")

    def rows(lines: Iterable[Line]) -> Iterator[TableRow]:
        unread: set[str] = set()
        for line, row in values(lines):
            if not unread and (late := row.keys() - names):
                unread.update(late)
                notes.append(
                    f"Keys of JSON that are not in the {looked_at}, such as {shown(min(late))}, were not read."
                )
            yield TableRow(line.number, tuple([row.get(name, "") for name in names]) if row else (), line.arrived_s)

    headers = () if all(map(str.isdigit, names)) else tuple(names)  # rows in lists
    return Form(headers, len(names), len(skipped), rows, len(skipped), notes)


def _values(text: str) -> dict[str, str]:
    """Return the values of a JSON object, by keys with dots between the levels; raise a ValueError for other text."""
    content = parse_json(text.strip().removesuffix(","))
    if not isinstance(content, dict):
        raise ValueError("not an object")
    pairs = list(_flat(content, ""))
    values = dict(pairs)
    if len(values) < len(pairs):
        raise ValueError("two keys are the same when levels are joined by points")
    return _joined(values)


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


def _joined(values: dict[str, str]) -> dict[str, str]:
    """Return values with ROS's time in one, and with the name of a row's sensor before the names of its values."""
    if stamp := ros_stamp(values):
        values = {ROS_TIME: stamp, **values}
    for key, unit in values.items():
        if key.rpartition(".")[2].lower() in _UNIT_KEYS and is_unit(unit):
            beside = {
                name: axis for name in values if name.startswith(key[:-5].rstrip(".")) and (axis := stem_and_axis(name))
            }
            if len({stem for stem, _ in beside.values()}) == 1:
                values = {f"{name} [{unit}]" if name in beside else name: value for name, value in values.items()}
    tag = next((value for value in values.values() if _TAG.fullmatch(value)), "") or values.get("sensor", "")
    if not tag or is_number(tag):
        return values
    return {name if seconds_of(name) is not None else f"{tag}.{name}": value for name, value in values.items()}


def _rows_of(content: object) -> list[object]:
    """Return the rows of a JSON document, or raise a ValueError."""
    if isinstance(content, list) and content and all(isinstance(row, (dict, list)) for row in content):
        return content
    if not isinstance(content, dict):
        raise ValueError("no list of objects")
    units = {key: value for key, value in content.items() if key.lower() in _UNIT_KEYS}
    names = next((names for value in content.values() if (names := _names(value))), ())
    for rows in content.values():  # beside the names of their columns
        if isinstance(rows, list) and names and all(isinstance(row, list) and len(row) == len(names) for row in rows):
            return [dict(zip(names, row, strict=True)) for row in rows]
    columns = dict(_columns(content, ""))
    lengths = set(map(len, columns.values()))
    if len(columns) > 1 and len(lengths) == 1:
        return [units | dict(zip(columns, row, strict=True)) for row in zip(*columns.values(), strict=True)]
    tables: dict[str, list[object]] = {}
    for key, value in content.items():
        with suppress(ValueError):
            tables[key] = _rows_of(value)
    if not tables:
        raise ValueError("no list of objects, and no lists of equal length")
    return [
        {key: row} if len(tables) > 1 or isinstance(row, list) or is_sensor(key) else row
        for key, rows in tables.items()
        for row in rows
    ]


def _names(value: object) -> list[str]:
    """Return the names in a list of names, or of objects with a name and a unit; none if it is something else."""
    if not isinstance(value, list):
        return []
    names = [f"{v['name']} [{v.get('units', '')}]" if isinstance(v, dict) and "name" in v else v for v in value]
    return names if all(isinstance(name, str) for name in names) else []


def _columns(content: dict[str, object], name: str) -> Iterator[tuple[str, list[object]]]:
    """Yield the lists of numbers in an object, also pandas' objects with numbered rows, by their names."""
    for key, inner in content.items():
        value = list(inner.values()) if isinstance(inner, dict) and all(map(str.isdigit, inner)) else inner
        if isinstance(value, dict):
            yield from _columns(value, f"{name}{key}.")
        elif isinstance(value, list) and not any(isinstance(cell, (dict, list)) for cell in value):
            yield f"{name}{key}", value


def _delimited_form(path: Path, lines: Sequence[Line], fewest: int) -> Form:
    """Return the form of rows of cells, which may have text above them.

    A table is only searched further down if the first line does not fit the lines below it.
    """
    own = _delimiter(lines[0].text)
    for decimal in (".", ","):
        look = _Look(path, lines, own, decimal)
        place = look.fitting(fewest)
        if place is not None:
            return look.form(*look.begin(place, fewest))
        looks = {delimiter: _Look(path, lines, delimiter, decimal) for delimiter in (*_DELIMITERS, None)}
        begins = [
            (look, place, *look.header(place))
            for place, line in enumerate(lines)
            if (look := looks[_delimiter(line.text)]).may_begin(place, max(fewest, _AXES))
        ]
        if begins:  # Numbers above a header with names of axes are LabVIEW's, of settings.
            look, place, begin, first, headers = min(begins, key=lambda begin: not axis_triples(begin[-1]))
            if not headers:
                look.refuse_lost(place)
            return look.form(begin, first, headers)
    if lines[0].text.lstrip().startswith(("{", "[{", "[[")) or lines[0].text.strip() == "[":
        raise ConfigError(f"{path}: JSON, but neither one document nor an object on each line")
    # There are no readings, which the reader reports.
    look = _Look(path, lines, own, ".")
    try:
        look.cells(lines[0].text)
    except ValueError as error:
        raise ConfigError(f"{path}:{lines[0].number}: {error}") from error
    return look.form(0, 1, look.rows[0]) if look.numbers(0) < fewest else look.form(0, 0, ())


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

    def begin(self, place: int, fewest: int) -> tuple[int, int, tuple[str, ...]]:
        """Return the first row, the first row of readings, and the header of a table.

        The table's first row fits its first readings.
        """
        if self.numbers(0) >= fewest:
            return 0, 0, ()
        begin, first, headers = self.header(place)
        if headers and (begin == 0 or (axis_triples(headers) and not axis_triples(self.rows[0]))):
            return begin, first, headers
        return 0, 1, self.rows[0]

    def header(self, place: int) -> tuple[int, int, tuple[str, ...]]:
        """Return the first row of the header just above a row of readings, that row, and the names: none without one.

        A header may have a row of names of sensors, one of axes, and one of units.
        """
        if not self._is_header(place - 1, place):
            return place, place, ()
        begin, names = place - 1, self.rows[place - 1]
        units: tuple[str, ...] = ()
        if _are_units(names) and self._is_header(begin - 1, place):
            begin, names, units = begin - 1, self.rows[begin - 1], names
        while _are_axes(names) and self._is_header(begin - 1, place):
            begin, names = begin - 1, _join_sensors(self.rows[begin - 1], names)
        if units:
            names = tuple(
                [
                    f"{name} [{unit.strip('()[]')}]" if unit else name
                    for name, unit in zip_longest(names, units, fillvalue="")
                ]
            )
        return begin, place, names

    def _is_header(self, at: int, place: int) -> bool:
        """Return whether a row has a name for each cell of one of readings."""
        if at < 0 or not any(self.rows[at]) or self.numbers(at):
            return False
        first_cells = [row[0] for row in self.rows[place:] if row]
        if len(self.rows[at]) + 1 == len(self.rows[place]) and len(first_cells) >= _AXES and counts(first_cells):
            self.rows[at] = ("", *self.rows[at])  # pandas' and R's tables, whose first column has no name
        return _fits(self.rows[at], self.rows[place])

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

    def form(self, begin: int, first: int, headers: tuple[str, ...]) -> Form:
        """Return the form of a table with its header from one row on, and its readings from another."""
        headers = headers or self._comment(begin)
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
        width = len(headers or self.rows[begin])
        form = Form(headers, width, first, self.table_rows, begin, notes, separated)
        return self._form_by_sensor(form) or form

    def _form_by_sensor(self, form: Form) -> Form | None:
        """Return the form of a table in which a cell of each row names its sensor; None if no column has two names."""
        rows = [row for row in self.rows[form.first :] if len(row) == form.width]
        tags = [set(cells) for cells in zip(*rows, strict=True) if any(map(_TAG.fullmatch, cells))]
        if len(set(form.headers)) < form.width or max(map(len, tags), default=0) < _FEWEST_TAGS:
            return None

        def values(lines: Iterable[Line]) -> Iterator[tuple[Line, dict[str, str]]]:
            for line in lines:
                ((_, cells, _),) = self.table_rows([line])
                row = dict(zip(form.headers, cells, strict=True)) if len(cells) == form.width else {}
                yield line, _joined(row)

        first_rows = [_joined(dict(zip(form.headers, row, strict=True))) for row in rows]
        by_sensor = _json_form(first_rows, values, self.lines[: form.first], f"first {len(self.lines)} lines", ())
        return by_sensor and replace(by_sensor, preamble=form.preamble, notes=form.notes)

    def table_rows(self, lines: Iterable[Line]) -> Iterator[TableRow]:
        """Yield the cells of lines."""
        for line in lines:
            try:
                cells = self.cells(line.text)
            except ValueError as error:
                if line.text.endswith("\n"):
                    raise ConfigError(f"{self.path}:{line.number}: {error}") from error
                cells = ()
            yield TableRow(line.number, cells, line.arrived_s)

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


def _are_units(cells: Sequence[str]) -> bool:
    units = sum(map(is_unit, cells))
    return units >= _AXES or (units > 0 and all(not cell or is_unit(cell, other=True) for cell in cells))


def _are_axes(cells: Sequence[str]) -> bool:
    parts = [cell.lower() in _PARTS_OF_NAMES or is_unit(cell, other=True) for cell in cells]
    return all(parts) and any(cells) and not any(map(is_unit, cells))


def _join_sensors(sensors: Sequence[str], axes: Sequence[str]) -> tuple[str, ...]:
    """Return names of columns from a row with the name of each sensor above its first axis."""
    names, sensor = [], ""
    for above, axis in zip_longest(sensors, axes, fillvalue=""):
        sensor = above or (sensor if axis else "")
        unit = _BRACKETED_UNIT.search(sensor)
        bare = sensor[: unit.start()] if unit and axis else sensor
        names.append(f"{bare} {axis}{unit[0] if unit and axis else ''}".strip())
    return tuple(names)


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
    bare = text.strip()
    return "|" if bare.startswith("|") else next((delimiter for delimiter in _DELIMITERS if delimiter in bare), None)


def _cells_or_nothing(text: str, delimiter: str | None) -> tuple[str, ...]:
    try:
        return _cells(text, delimiter)
    except ValueError:
        return ()


def _cells(text: str, delimiter: str | None) -> tuple[str, ...]:
    """Return the cells of a line, or raise a ValueError with the reason."""
    if delimiter is None:
        return tuple([cell.strip('"') for cell in text.split()])
    text = text.strip("\r\n") if delimiter != "|" else text.strip().removeprefix("|").removesuffix("|")
    if '"' not in text and "\r" not in text:
        return tuple([cell.strip() for cell in text.split(delimiter)])
    try:
        (cells,) = csv.reader([text], delimiter=delimiter, skipinitialspace=True, strict=True)
    except (csv.Error, ValueError) as error:
        if "\r" in text:
            raise ValueError("carriage returns within the line; save with line ends LF or CR LF") from error
        raise ValueError("a quote is opened and not closed on the line") from error
    return tuple([cell.strip() for cell in cells])
