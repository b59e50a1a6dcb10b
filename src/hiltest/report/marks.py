"""Marks of a plot, which differ in shape and not only in colour, and the key that names them."""

from __future__ import annotations

from dataclasses import dataclass
from enum import StrEnum

from markupsafe import Markup, escape

from hiltest.text import legible


class Mark(StrEnum):
    """Shape of a mark; the path is drawn around the origin with a radius of 1."""

    DOT = "dot"
    SQUARE = "M-.9 -.9h1.8v1.8h-1.8z"
    DIAMOND = "M0 -1.3L1.3 0L0 1.3L-1.3 0z"
    TRIANGLE = "M0 -1.2L1.15 .9h-2.3z"
    FLAG = "M0 1.2L1.15 -.9h-2.3z"
    CROSS = "M-1 -1L1 1M-1 1L1 -1"
    PLUS = "M0 -1.2V1.2M-1.2 0H1.2"
    HOURGLASS = "M-1 -1.1h2L-1 1.1h2z"

    def draw(self, x: float, y: float, radius: float, style: str) -> Markup:
        """Return the mark at a position in the view box."""
        if self is Mark.DOT:
            return shape('<circle class="{}" cx="{}" cy="{}" r="{}"/>', style, x, y, radius)
        template = '<path class="mark {}" transform="translate({} {}) scale({})" d="{}"/>'
        return shape(template, style, x, y, radius, self.value)


# Styles of successive series: a class of the style sheet with a colour and dashes, and a shape. After the last class
# each one has its neighbour's shape, so that no pair occurs twice.
SERIES = tuple(
    (f"series-{index}", [*Mark][(index + turn) % len(Mark)]) for turn in range(len(Mark)) for index in range(len(Mark))
)


def series(index: int) -> tuple[str, Mark]:
    """Return class and shape of a series; they repeat after the sixty-fourth."""
    return SERIES[index % len(SERIES)]


@dataclass(frozen=True, slots=True)
class KeyEntry:
    """Meaning of a line or a mark; `line` and `mark` are classes of the style sheet."""

    text: str
    line: str = ""
    mark: Mark | None = None
    mark_style: str = ""

    @property
    def swatch(self) -> Markup:
        """The line and the mark at the size of a letter."""
        width = 34.0 if self.line else 14.0
        parts = []
        if self.line:
            parts.append(shape('<path class="{}" d="M1 7h32"/>', self.line))
        if self.mark:
            parts.append(self.mark.draw(width / 2.0, 7.0, 3.5, self.mark_style or self.line))
        template = '<svg class="swatch" viewBox="0 0 {0:g} 14" width="{0:g}" height="14" aria-hidden="true">{1}</svg>'
        return Markup(template).format(width, Markup("").join(parts))


def shape(template: str, *values: object) -> Markup:
    """Return an element: numbers to a tenth, texts escaped."""
    written = (f"{value:.1f}" if isinstance(value, float) else escape(legible(str(value))) for value in values)
    return Markup(template).format(*written)
