"""Uncertainty range of a cycle count, from the uncertainty of the cycle model that counted it."""

from __future__ import annotations

from dataclasses import dataclass

from hiltest.text import readable


@dataclass(frozen=True, slots=True)
class RowEffect:
    """A cycle count with one row of the cycle model at the lower or upper end of its range."""

    row: str
    low: int
    high: int


@dataclass(frozen=True, slots=True)
class CycleRange:
    """Uncertainty range of a cycle count: every uncertain row of its cycle model takes any value of its own range.

    Attributes
    ----------
    low, high : int
        Counts with every row at the cheap, or the dear, end of its own range.
    rows : tuple of RowEffect
        Each that changes the count, alone: the one that changes it most comes first.
    """

    low: int
    high: int
    rows: tuple[RowEffect, ...] = ()

    def __str__(self) -> str:
        return _range(self.low, self.high)

    @property
    def moved_most_by(self) -> RowEffect | None:
        """The row that alone changes the count most; None when no row does."""
        return next(iter(self.rows), None)

    def explained(self, model: str = "the cycle model") -> str:
        """Return the uncertainty range in words, with the row of the model that contributes most."""
        most = self.moved_most_by
        if most is None and self.low == self.high:
            return f"no uncertain row of {model} enters"
        if most is None:
            return f"{self}, by the uncertainty of the memories that it runs from"
        return f"{self} by uncertain rows of {model}, most by {most.row}: {_range(most.low, most.high)}"


def _range(low: int, high: int) -> str:
    return f"{readable(min(low, high))} to {readable(max(low, high))}"
