"""A section of the page that is one figure: panels on a grid, their key, and the numbers behind them."""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from typing import Protocol

from markupsafe import Markup

from hiltest.measurement import Measurement
from hiltest.record.run import Cell, Table
from hiltest.report.marks import KeyEntry
from hiltest.report.svg import Sheet
from hiltest.text import readable

_WIDTH, _GAP = 1094.0, 16.0  # of the inside of a card on a desk, and between two panels, in px
_FEWEST, _STYLED = 2, 6  # columns: one alone is drawn no wider than two, and the style sheet knows up to six


class Drawing(Protocol):
    """A panel: axes or rows."""

    @property
    def title(self) -> str:
        """Its caption."""

    @property
    def key(self) -> Sequence[KeyEntry]:
        """Key of its lines and marks."""

    @property
    def sheet(self) -> Sheet | None:
        """The numbers behind it."""

    def svg(self) -> Markup:
        """Return it as an element of the page."""


@dataclass(frozen=True, slots=True)
class FigureGroup:
    """One section."""

    anchor: str
    """Anchor of its heading."""
    heading: str
    legend: str
    panels: Sequence[Drawing]
    most: int = 3
    """Panels in a row on a desk; one more where it fills the last row better."""
    caption: str = ""
    """What all panels show."""
    numbers: Sequence[Sheet] = ()
    """Where those of the panels one by one would be harder to read."""
    short: str = ""
    """The heading in the contents, where it is shorter there."""

    @property
    def columns(self) -> int:
        """Number of panels in a row."""
        return columns(len(self.panels), self.most)

    @property
    def key(self) -> Sequence[KeyEntry]:
        """Key for all panels; empty where each panel has its own, because one mark stands for two things."""
        entries = tuple(dict.fromkeys(entry for panel in self.panels for entry in panel.key))
        swatches = {(entry.line, entry.mark, entry.mark_style) for entry in entries}
        return entries if len(swatches) == len(entries) else ()

    @property
    def sheets(self) -> Sequence[Sheet]:
        """The numbers behind the panels, for readers who cannot see them or want them exactly."""
        return self.numbers or [panel.sheet for panel in self.panels if panel.sheet]


def columns(count: int, most: int) -> int:
    """Return in how many columns panels leave the fewest places of the last row empty."""
    if count <= most:
        return max(count, 1)
    return min(range(min(most + 1, _STYLED), most // 2, -1), key=lambda each: -count % each)


def panel_width(count: int, most: int) -> float:
    """Return how wide a panel is drawn, so that its letters have their size on a desk."""
    across = max(_FEWEST, columns(count, most))
    return (_WIDTH - _GAP * (across - 1)) / across


def numbers(table: Table, column: str) -> list[float]:
    """Return a column as floats; what is no number is NaN and is not drawn."""
    return [_number(cell) for cell in table.column_if_any(column)]


def upper_limit(measurement: Measurement | None) -> float | None:
    """Return how large a measurement may be, None without a limit."""
    return None if measurement is None or measurement.limit is None else measurement.limit.max


def written(cells: Iterable[Cell], digits: int = 4) -> list[str]:
    """Return cells as people read them; a missing number is empty."""
    return [_written(cell, digits) for cell in cells]


def _number(cell: Cell) -> float:
    return float(cell) if isinstance(cell, int | float) and not isinstance(cell, bool) else math.nan


def _written(cell: Cell, digits: int) -> str:
    if cell is None or isinstance(cell, str):
        return cell or ""
    if isinstance(cell, bool):
        return "yes" if cell else "no"
    return readable(cell, digits) if math.isfinite(cell) else ""
