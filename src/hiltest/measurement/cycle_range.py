"""Uncertainty range of a cycle count, from the uncertainty of the cycle model that counted it."""

from __future__ import annotations

from dataclasses import dataclass

from hiltest.text import readable

#: The row of a cycle model that says what published counts differ by, whatever the other rows are: a part of any count.
DOUBT = "doubt_permille"
ABOUT_FETCH = frozenset(
    {"fetch_late", "fetch_late_fp", "fetch_late_integer", "target_misplaced", "return_misplaced"}
)
"""Rows that price where an instruction lies: they ask whether it has been fetched when it is wanted."""


@dataclass(frozen=True, slots=True)
class RowEffect:
    """A cycle count with one row of the cycle model at the lower or upper end of its range."""

    row: str
    low: int
    high: int


@dataclass(frozen=True, slots=True)
class CycleRange:
    """Uncertainty range of a cycle count: every uncertain row of its cycle model takes any value of its own range."""

    low: int
    high: int
    """Counts with every row at the cheap, or the dear, end of its own range."""
    rows: tuple[RowEffect, ...] = ()
    """Each that changes the count, alone: the one that changes it most comes first."""

    def __str__(self) -> str:
        return _range(self.low, self.high)

    @property
    def moved_most_by(self) -> RowEffect | None:
        """The row that alone changes the count most; None when no row does."""
        return next(iter(self.rows), None)

    @property
    def about_fetch(self) -> int:
        """How many cycles of the range are doubt about fetch and alignment."""
        return sum(abs(row.high - row.low) for row in self.rows if row.row in ABOUT_FETCH)

    def explained(self, model: str = "the cycle model", *, of: float | None = None) -> str:
        """Return the range in words, with the row that contributes most, and what part of `of` is doubt about fetch."""
        if not of or not self.about_fetch:
            return self._explained(model)
        return f"{self._explained(model)}; {100 * self.about_fetch / of:.1f} % of the count is doubt about fetch"

    def _explained(self, model: str) -> str:
        most = self.moved_most_by
        if most is None and self.low == self.high:
            return f"no uncertain row of {model} enters"
        if most is None:
            return f"{self}, by the uncertainty of the memories that it runs from"
        return f"{self} by uncertain rows of {model}, most by {most.row}: {_range(most.low, most.high)}"


def _range(low: int, high: int) -> str:
    return f"{readable(min(low, high))} to {readable(max(low, high))}"
