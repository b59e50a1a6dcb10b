"""Forms of a line: where its fields stand. A field is what was printed, and may be several numbers."""

from __future__ import annotations

import json
import re
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any, Protocol

from hiltest.device.text_lines import Pattern

# What separates the numbers of one field.
_BETWEEN = re.compile(r"[\s,;]+")


@dataclass(frozen=True, slots=True)
class Found:
    """What a form finds in a line."""

    fields: Mapping[str, Sequence[str]] = field(default_factory=dict)
    """Texts of each field."""
    remark: str = ""
    """What the line is when no quantity is in it."""
    is_header: bool = False
    """It names the columns."""


class Form(Protocol):
    """Finds fields in lines."""

    def find(self, line: str) -> Found:
        """Return the fields of a line."""


class PatternForm:
    """Fields are groups of regular expressions, of which every one is searched in every line."""

    def __init__(self, patterns: Sequence[Pattern]) -> None:
        self._patterns = patterns

    def find(self, line: str) -> Found:
        """Return the groups of all patterns that match; the first one's, where several have a group of a name."""
        fields: dict[str, list[str]] = {}
        for pattern in self._patterns:
            match = pattern.search(line)
            for name, text in match.groupdict().items() if match else ():
                if text is not None:
                    fields.setdefault(name, _apart(text))
        return Found(fields, "a pattern matches, and holds no quantity whole" if fields else "no pattern matches")


class JsonForm:
    """A line is a JSON object; fields are values in it by their path, such as ``imu.mag`` or ``imu.mag.0``."""

    def __init__(self, paths: Sequence[str]) -> None:
        self._paths = paths

    def find(self, line: str) -> Found:
        """Return the values at the paths; an array is its elements."""
        try:
            # Numbers stay as they are printed: which of them are numbers is seen later, NaN too.
            content = json.loads(line, parse_float=str, parse_int=str, parse_constant=str)
        except (ValueError, RecursionError):
            return Found(remark="no JSON")
        texts = {path: list(_texts(_at(content, path))) for path in self._paths}
        missing = [path for path in self._paths if not texts[path]]
        return Found({path: each for path, each in texts.items() if each}, f"nothing at {', '.join(missing)}")


def _apart(text: str) -> list[str]:
    """Return the numbers of a field that was printed as one text."""
    return _BETWEEN.split(text.strip())


def _at(content: Any, path: str) -> Any:
    """Return what is at a path, None for nothing."""
    if isinstance(content, dict) and path in content:
        return content[path]
    first, dot, rest = path.partition(".")
    if isinstance(content, dict):
        inner = content.get(first)
    elif isinstance(content, list) and first.isascii() and first.isdigit() and int(first) < len(content):
        inner = content[int(first)]
    else:
        return None
    return _at(inner, rest) if dot else inner


def _texts(value: Any) -> Iterator[str]:
    """Yield one value, or those of an array, of a matrix row by row."""
    for row in value if isinstance(value, list) else [value]:
        for each in row if isinstance(row, list) else [row]:
            if isinstance(each, str | bool):
                yield str(each)


class ColumnForm:
    """A line is a row of a table; fields are columns by name, or by number from 1.

    Parameters
    ----------
    wanted
        Names or numbers.
    columns
        Names of all columns; without them the firmware prints them in a line of their own.
    separator
        Between columns; a blank stands for any number of blanks and tabs.
    """

    def __init__(self, wanted: Sequence[str], columns: Sequence[str], separator: str) -> None:
        self._separator = None if separator == " " else separator
        self._wanted = wanted
        self._names = {each.lower() for each in wanted if not each.isdecimal()}
        self._places: dict[str, int] | None = None
        self._width = 0
        if columns or not self._names:
            self._take_header(columns)

    def find(self, line: str) -> Found:
        """Return the cells of a row; a header line has none."""
        cells = [part.strip().strip('"') for part in line.split(self._separator)]
        if self._names and self._names <= {cell.lower() for cell in cells}:
            self._take_header(cells)
            return Found(remark="names of the columns", is_header=True)
        if self._places is None:
            return Found(remark=f"no line with the names {', '.join(sorted(self._names))} came yet")
        if self._width and len(cells) != self._width:
            return Found(remark=f"{len(cells)} columns, not {self._width}")
        fields = {each: _apart(cells[place]) for each, place in self._places.items() if cells[place:]}
        return Found(fields, "too few columns")

    def _take_header(self, cells: Sequence[str]) -> None:
        places = {each.lower(): place for place, each in reversed([*enumerate(cells)])}
        self._width = len(cells)
        self._places = {each: int(each) - 1 if each.isdecimal() else places[each.lower()] for each in self._wanted}
