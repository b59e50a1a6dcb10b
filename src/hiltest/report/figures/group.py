"""Figures that belong together: one section of the page, with its key and its numbers."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Protocol

from markupsafe import Markup

from hiltest.report.marks import KeyEntry


class Drawing(Protocol):
    """What a section shows: axes or rows."""

    @property
    def title(self) -> str:
        """Its caption."""

    @property
    def key(self) -> Sequence[KeyEntry]:
        """What its lines and marks stand for."""

    def svg(self) -> Markup:
        """Return it as an element of the page."""


@dataclass(frozen=True, slots=True)
class Sheet:
    """The numbers of a section as text; the first cell of a row names it."""

    caption: str
    headings: Sequence[str]
    rows: Sequence[Sequence[str]]


@dataclass(frozen=True, slots=True)
class FigureGroup:
    """One section.

    Attributes
    ----------
    anchor : str
        Of its heading.
    heading, legend : str
    figures : sequence of Drawing
    key : sequence of KeyEntry
        Where all figures share one.
    numbers : Sheet or None
        Behind the figures, for who cannot see them or wants them exactly.
    small : bool
        Whether three stand in a row.
    tall_first : bool
        Whether two others stand beside the first.
    short : str
        The heading in the contents, where it is shorter there.
    """

    anchor: str
    heading: str
    legend: str
    figures: Sequence[Drawing]
    key: Sequence[KeyEntry] = ()
    numbers: Sheet | None = None
    small: bool = False
    tall_first: bool = False
    short: str = ""
