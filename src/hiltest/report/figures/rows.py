"""A drawing of rows: a name, a number at its end, and below both a bar. It reads the same on any width."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field

from markupsafe import Markup

from hiltest.report.marks import KeyEntry, Mark, shape
from hiltest.report.svg import drawing

_WIDTH, _ROW, _LEFT, _RIGHT = 460.0, 42.0, 4.0, 456.0
_TEXT, _BAR, _THICK = 15.0, 28.0, 8.0  # below the top of a row: a line of text, the middle of the bar, its height


@dataclass(frozen=True, slots=True)
class Row:
    """One bar.

    Attributes
    ----------
    name, number : str
    at : float
        Where the mark stands, 0 to 1 of the width.
    mark : Mark
    style : str
        Class of the mark.
    zone : (float, float) or None
        The part of the width that is shaded.
    ends : sequence of float
        Where the zone has a limit, and a line says so.
    start : float or None
        Where a line to the mark begins.
    """

    name: str
    number: str
    at: float
    mark: Mark
    style: str
    zone: tuple[float, float] | None = None
    ends: Sequence[float] = ()
    start: float | None = None


@dataclass(frozen=True, slots=True)
class RowFigure:
    """Rows under each other; `title` and `description` are what a screen reader says of them."""

    title: str
    description: str
    rows: Sequence[Row]
    key: Sequence[KeyEntry] = field(default=())

    def svg(self) -> Markup:
        """Return the finished drawing."""
        content = Markup("").join(_drawn(row, index * _ROW) for index, row in enumerate(self.rows))
        return drawing(self.title, self.description, _WIDTH, len(self.rows) * _ROW, content)


def _drawn(row: Row, top: float) -> Markup:
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
    parts.append(row.mark.at(_x(row.at), middle, 4.5, row.style))
    return Markup("").join(parts)


def _x(share: float) -> float:
    return _LEFT + min(max(share, 0.0), 1.0) * (_RIGHT - _LEFT)
