"""A section of the page that is one figure: panels on a grid, their key, and the numbers behind them."""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from typing import Protocol

from markupsafe import Markup

from hiltest.measurement import Measurement
from hiltest.report.marks import KeyEntry
from hiltest.report.svg import Sheet
from hiltest.run_record.run import Cell, Table
from hiltest.text import format_number

_WIDTH, _GAP = 1094.0, 16.0  # of the inside of a card on a wide screen, and between two panels, in px
_FEWEST, _STYLED = 2, 6  # columns: a single panel is no wider than two, and the style sheet supports up to six


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
        """Numbers of the panel."""

    def svg(self) -> Markup:
        """Return the panel as an element of the page."""


@dataclass(frozen=True, slots=True)
class FigureGroup:
    """One section."""

    anchor: str
    """Anchor of its heading."""
    heading: str
    legend: str
    panels: Sequence[Drawing]
    most: int = 3
    """Panels in a row on a wide screen; one more if that fills the last row better."""
    caption: str = ""
    """Common caption of the panels."""
    numbers: Sequence[Sheet] = ()
    """Numbers of all panels, if those of single panels would be harder to read."""
    short: str = ""
    """Shorter heading for the contents; may be empty."""

    @property
    def columns(self) -> int:
        """Number of panels in a row."""
        return columns(len(self.panels), self.most)

    @property
    def key(self) -> Sequence[KeyEntry]:
        """Key for all panels; empty if one mark has two meanings, and each panel therefore has its own key."""
        entries = tuple(dict.fromkeys(entry for panel in self.panels for entry in panel.key))
        swatches = {(entry.line, entry.mark, entry.mark_style) for entry in entries}
        return entries if len(swatches) == len(entries) else ()

    @property
    def sheets(self) -> Sequence[Sheet]:
        """Numbers of the panels, for readers who cannot see them or need exact values."""
        return self.numbers or [panel.sheet for panel in self.panels if panel.sheet]


def columns(count: int, most: int) -> int:
    """Return the number of columns that leaves the fewest places of the last row empty."""
    if count <= most:
        return max(count, 1)
    return min(range(min(most + 1, _STYLED), most // 2, -1), key=lambda count_of_columns: -count % count_of_columns)


def panel_width(count: int, most: int) -> float:
    """Return the width of a panel at which its letters have their nominal size on a wide screen."""
    across = max(_FEWEST, columns(count, most))
    return (_WIDTH - _GAP * (across - 1)) / across


def numbers(table: Table, column: str) -> list[float]:
    """Return a column as floats; other cells become NaN and are not drawn."""
    return [_number(cell) for cell in table.column_if_any(column)]


def upper_limit(measurement: Measurement | None) -> float | None:
    """Return the upper limit of a measurement; None without one."""
    return None if measurement is None or measurement.limit is None else measurement.limit.max


def written(cells: Iterable[Cell], digits: int = 4) -> list[str]:
    """Return cells as text; a missing number is empty."""
    return [_format_cell(cell, digits) for cell in cells]


def _number(cell: Cell) -> float:
    return float(cell) if isinstance(cell, int | float) and not isinstance(cell, bool) else math.nan


def _format_cell(cell: Cell, digits: int) -> str:
    if cell is None or isinstance(cell, str):
        return cell or ""
    if isinstance(cell, bool):
        return "yes" if cell else "no"
    return format_number(cell, digits) if math.isfinite(cell) else ""
