"""Uncertainty range of a cycle count, from the uncertainty of the cycle model that counted it."""

from __future__ import annotations

from dataclasses import dataclass

from hiltest.text import format_number

#: Row of a cycle model for differences of published counts that the other rows do not explain, as a part of any count.
DOUBT = "doubt_permille"
#: Effect on a range that comes from the errors of counts whose true values were published.
PUBLISHED = "published counts"
ABOUT_FETCH = frozenset({"fetch_late", "fetch_late_fp", "fetch_late_integer", "target_misplaced", "return_misplaced"})
"""Rows whose price depends on an instruction's position, which decides if it is fetched in time."""


@dataclass(frozen=True, slots=True)
class RowEffect:
    """A cycle count with one row of the cycle model at the lower or upper end of its range."""

    row: str
    low: int
    high: int


@dataclass(frozen=True, slots=True)
class CycleRange:
    """Uncertainty range of a cycle count if each uncertain row of its cycle model takes any value of its own range."""

    low: int
    high: int
    """Counts with every row at the cheap end, and at the expensive end, of its own range."""
    rows: tuple[RowEffect, ...] = ()
    """Rows that change the count, each alone; the largest change comes first."""

    def __str__(self) -> str:
        return _range(self.low, self.high)

    @property
    def moved_most_by(self) -> RowEffect | None:
        """The row that alone changes the count most; None without one."""
        return next(iter(self.rows), None)

    @property
    def about_fetch(self) -> int:
        """Number of cycles of the range that are due to doubt about fetch and alignment."""
        return sum(abs(row.high - row.low) for row in self.rows if row.row in ABOUT_FETCH)

    def explained(self, *, of: float | None = None) -> str:
        """Return the range in words, with the largest contribution, and the share of `of` that is doubt about fetch."""
        if not of or not self.about_fetch:
            return self._explain()
        return f"{self._explain()}; {100 * self.about_fetch / of:.1f} % of the count is uncertainty of fetch"

    def _explain(self) -> str:
        most = self.moved_most_by
        if most is None and self.low == self.high:
            return "no uncertain row of the cycle model enters"
        if most is None:
            return f"{self}, by the uncertainty of the memories that it runs from"
        if most.row == PUBLISHED and len(self.rows) == 1:
            return f"{self}, as published counts differ from those of the cycle model"
        return f"{self} by uncertain rows of the cycle model, most by {most.row}: {_range(most.low, most.high)}"


def _range(low: int, high: int) -> str:
    return f"{format_number(min(low, high))} to {format_number(max(low, high))}"
