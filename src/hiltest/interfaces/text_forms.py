"""Forms of a line, which locate its fields. A field is printed text and may hold several numbers."""

from __future__ import annotations

import json
import re
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any, Protocol

from hiltest.interfaces.text_lines import Pattern

# Separator between the numbers of one field.
_BETWEEN = re.compile(r"[\s,;]+")


@dataclass(frozen=True, slots=True)
class LineFields:
    """Fields that a form finds in a line."""

    fields: Mapping[str, Sequence[str]] = field(default_factory=dict)
    """Texts of each field."""
    remark: str = ""
    """Description of a line without a quantity."""
    is_header: bool = False
    """True if the line is a header."""


class LineForm(Protocol):
    """Locator of fields in lines."""

    def find(self, line: str) -> LineFields:
        """Return the fields of a line."""


class PatternForm:
    """Form whose fields are groups of regular expressions, each searched in every line."""

    def __init__(self, patterns: Sequence[Pattern]) -> None:
        self._patterns = patterns

    def find(self, line: str) -> LineFields:
        """Return the groups of all patterns that match; of groups with the same name, the first pattern's."""
        fields: dict[str, list[str]] = {}
        for pattern in self._patterns:
            match = pattern.search(line)
            for name, text in match.groupdict().items() if match else ():
                if text is not None:
                    fields.setdefault(name, _split_numbers(text))
        return LineFields(
            fields, "a pattern matches, but without a complete quantity" if fields else "no pattern matches"
        )


class JsonForm:
    """Form whose lines are JSON objects; fields are values by their path, such as ``imu.mag`` or ``imu.mag.0``."""

    def __init__(self, paths: Sequence[str]) -> None:
        self._paths = paths

    def find(self, line: str) -> LineFields:
        """Return the values at the paths; an array gives its elements."""
        try:
            # Numbers stay as printed text; they are validated later, NaN included.
            content = json.loads(line, parse_float=str, parse_int=str, parse_constant=str)
        except (ValueError, RecursionError):
            return LineFields(remark="no JSON")
        texts = {path: list(_texts(_value_at(content, path))) for path in self._paths}
        missing = [path for path in self._paths if not texts[path]]
        return LineFields(
            {path: values for path, values in texts.items() if values}, f"nothing at {', '.join(missing)}"
        )


def _split_numbers(text: str) -> list[str]:
    """Return the numbers of a field that was printed as one text."""
    return _BETWEEN.split(text.strip())


def _value_at(content: Any, path: str) -> Any:
    """Return the value at a path; None if there is none."""
    if isinstance(content, dict) and path in content:
        return content[path]
    first, dot, rest = path.partition(".")
    if isinstance(content, dict):
        inner = content.get(first)
    elif isinstance(content, list) and first.isascii() and first.isdigit() and int(first) < len(content):
        inner = content[int(first)]
    else:
        return None
    return _value_at(inner, rest) if dot else inner


def _texts(value: Any) -> Iterator[str]:
    """Yield one value, or those of an array; a matrix row by row."""
    for row in value if isinstance(value, list) else [value]:
        for cell in row if isinstance(row, list) else [row]:
            if isinstance(cell, str | bool):
                yield str(cell)


class ColumnForm:
    """Form whose lines are rows of a table; fields are columns by name, or by number from 1.

    Parameters
    ----------
    names
        Names or numbers.
    columns
        Names of all columns; if empty, the firmware prints a header line.
    separator
        Separator of columns; a blank stands for any number of blanks and tabs.
    """

    def __init__(self, names: Sequence[str], columns: Sequence[str], separator: str) -> None:
        self._separator = None if separator == " " else separator
        self._selected = names
        self._names = {name.lower() for name in names if not name.isdecimal()}
        self._places: dict[str, int] | None = None
        self._width = 0
        if columns or not self._names:
            self._take_header(columns)

    def find(self, line: str) -> LineFields:
        """Return the cells of a row; a header line has none."""
        cells = [part.strip().strip('"') for part in line.split(self._separator)]
        if self._names and self._names <= {cell.lower() for cell in cells}:
            self._take_header(cells)
            return LineFields(remark="names of the columns", is_header=True)
        if self._places is None:
            return LineFields(remark=f"no line with the names {', '.join(sorted(self._names))} has arrived")
        if self._width and len(cells) != self._width:
            return LineFields(remark=f"{len(cells)} columns, not {self._width}")
        fields = {name: _split_numbers(cells[place]) for name, place in self._places.items() if cells[place:]}
        return LineFields(fields, "too few columns")

    def _take_header(self, cells: Sequence[str]) -> None:
        places = {name.lower(): place for place, name in reversed([*enumerate(cells)])}
        self._width = len(cells)
        self._places = {name: int(name) - 1 if name.isdecimal() else places[name.lower()] for name in self._selected}
