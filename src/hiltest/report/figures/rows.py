"""Rows of bars, each with its name and its number above it: used shares of limits, and other numbers."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

from markupsafe import Markup

from hiltest.measurement import Limit, Measurement, Outcome, Section
from hiltest.report.marks import KeyEntry, Mark, shape
from hiltest.report.svg import Sheet, drawing
from hiltest.text import format_with_unit

_WIDTH, _ROW, _LEFT, _RIGHT = 380.0, 42.0, 4.0, 376.0
_TEXT, _BAR, _THICK = 15.0, 28.0, 8.0  # below the top of a row: text line, middle of the bar; height of the bar
_ROOM = 0.75  # part of the width that a limit allows; the rest shows how far a value is beyond it
_KEY = (
    KeyEntry("within its limit", "", Mark.DOT, "level filled"),
    KeyEntry("beyond it", "", Mark.CROSS, "over"),
    KeyEntry("limit", "end"),
)


@dataclass(frozen=True, slots=True)
class Row:
    """One bar."""

    name: str
    number: str
    at: float
    """Position of the mark, 0 to 1 of the width."""
    mark: Mark
    style: str
    """Class of the mark."""
    zone: tuple[float, float] | None = None
    """Shaded part of the width."""
    ends: Sequence[float] = ()
    """Positions of limits, each drawn as a line."""
    start: float | None = None
    """Start of a line to the mark."""


@dataclass(frozen=True, slots=True)
class RowFigure:
    """Rows under each other; a screen reader reads the title and every row."""

    title: str
    rows: Sequence[Row]
    key: Sequence[KeyEntry] = ()

    @property
    def sheet(self) -> Sheet:
        """Names and numbers of the rows."""
        return Sheet(self.title, ("name", "value"), [(row.name, row.number) for row in self.rows])

    def svg(self) -> Markup:
        """Return the finished drawing."""
        content = Markup("").join(_draw_row(row, index * _ROW) for index, row in enumerate(self.rows))
        in_words = "; ".join(f"{row.name}: {row.number}" for row in self.rows)
        return drawing(self.title, in_words, _WIDTH, len(self.rows) * _ROW, content)


def bars(title: str, values: Mapping[str, tuple[float, str]]) -> RowFigure:
    """Draw numbers that are not negative as bars, by name, each with its text."""
    most = max(value for value, _ in values.values()) or 1.0
    rows = [
        Row(name, text, 0.96 * value / most, Mark.DOT, "level filled", start=0.0)
        for name, (value, text) in values.items()
    ]
    return RowFigure(title, rows)


def limit_figure(measurements: Sequence[Measurement], section: Section, title: str) -> RowFigure | None:
    """Draw the measurements of a section with a limit and a number; None without any."""
    rows = [row for measurement in measurements if measurement.section is section and (row := _limit_row(measurement))]
    if not rows:
        return None
    return RowFigure(title, rows, key=_KEY)


def _limit_row(measurement: Measurement) -> Row | None:
    limit, value = measurement.limit, measurement.value
    ends = None if limit is None else _ends(limit)
    if limit is None or value is None or ends is None:
        return None
    low, high = ends
    held = measurement.outcome is not Outcome.FAIL
    shares = [(side - low) / (high - low) for side in (limit.min, limit.max) if side is not None]
    zone = (shares[0], shares[1]) if len(shares) == 2 else (0.0, shares[0]) if limit.min is None else (shares[0], 1.0)
    return Row(
        measurement.name,
        f"{format_with_unit(value, measurement.unit)}, {limit}",
        at=(value - low) / (high - low),
        mark=Mark.DOT if held else Mark.CROSS,
        style="level filled" if held else "over",
        zone=zone,
        ends=shares,
    )


def _ends(limit: Limit) -> tuple[float, float] | None:
    """Return the values at the left and the right end of the bar; None for a limit without a width."""
    if limit.min is not None and limit.max is not None:
        middle, half = (limit.min + limit.max) / 2.0, (limit.max - limit.min) / 2.0
        return None if half == 0.0 else (middle - half / _ROOM, middle + half / _ROOM)
    side = limit.max if limit.min is None else limit.min
    if side is None or side <= 0.0:
        return None
    return 0.0, side / _ROOM if limit.min is None else side / (1.0 - _ROOM)


def _draw_row(row: Row, top: float) -> Markup:
    middle = top + _BAR
    rectangle = '<rect class="{}" x="{}" y="{}" width="{}" height="{}"/>'
    parts = [
        shape('<text class="name" x="{}" y="{}">{}</text>', _LEFT, top + _TEXT, row.name),
        shape('<text x="{}" y="{}" text-anchor="end">{}</text>', _RIGHT, top + _TEXT, row.number),
        shape(rectangle, "track", _LEFT, middle - _THICK / 2, _RIGHT - _LEFT, _THICK),
    ]
    if row.zone:
        left, right = map(_x, row.zone)
        parts.append(shape(rectangle, "allowed", left, middle - _THICK / 2, right - left, _THICK))
    parts += [shape('<path class="end" d="M{} {}v{}"/>', _x(end), middle - _THICK, 2 * _THICK) for end in row.ends]
    if row.start is not None:
        parts.append(shape('<path class="thick {}" d="M{} {}H{}"/>', row.style, _x(row.start), middle, _x(row.at)))
    parts.append(row.mark.draw(_x(row.at), middle, 4.5, row.style))
    return Markup("").join(parts)


def _x(share: float) -> float:
    return _LEFT + min(max(share, 0.0), 1.0) * (_RIGHT - _LEFT)
