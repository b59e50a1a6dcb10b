"""The interval that a value must lie in."""

from __future__ import annotations

import math
from dataclasses import dataclass

from hiltest.measurement.kind import Better


@dataclass(frozen=True, slots=True)
class Limit:
    """Closed interval that a value must lie in; None leaves a side open.

    Raises
    ------
    ValueError
        If both sides are open, one is not a finite number, or they are in the wrong order.
    """

    min: float | None = None
    max: float | None = None

    def __post_init__(self) -> None:
        sides = [side for side in (self.min, self.max) if side is not None]
        if not sides:
            raise ValueError("a limit needs min, max or both")
        if not all(math.isfinite(side) for side in sides):
            raise ValueError(f"a limit must be finite, got {self.min} to {self.max}")
        if self.min is not None and self.max is not None and self.min > self.max:
            raise ValueError(f"limit min {self.min} is above its max {self.max}")

    @classmethod
    def within(cls, magnitude: float) -> Limit:
        """Return the limit ``-magnitude`` to ``+magnitude``."""
        return cls(min=-magnitude, max=magnitude)

    def holds(self, value: float) -> bool:
        """Return whether `value` lies inside; a NaN never does."""
        above = self.min is None or value >= self.min
        below = self.max is None or value <= self.max
        return above and below

    def is_met(self, value: float, uncertainty: float = 0.0) -> bool | None:
        """Return whether a value meets the limit; None if its uncertainty leaves that open.

        Parameters
        ----------
        uncertainty
            Expanded uncertainty U of the value, 0 or more, in its unit.

        Notes
        -----
        The decision rule of ISO 14253-1 with a guard band of U on both sides of a limit: conformity is proven if
        all of ``value - U`` to ``value + U`` is inside, nonconformity if all of it is outside of one side.
        """
        if self.holds(value - uncertainty) and self.holds(value + uncertainty):
            return True
        too_low = self.min is not None and value + uncertainty < self.min
        too_high = self.max is not None and value - uncertainty > self.max
        return False if too_low or too_high or not uncertainty else None

    def covers(self, other: Limit) -> bool:
        """Return whether every value that meets `other` meets this limit, too."""
        above = self.min is None or (other.min is not None and other.min >= self.min)
        below = self.max is None or (other.max is not None and other.max <= self.max)
        return above and below

    @property
    def better(self) -> Better:
        """Better direction of a value without a kind: away from the side that limits it."""
        if self.min is None:
            return Better.LOWER
        if self.max is None:
            return Better.HIGHER
        return Better.NEARER_ZERO if self.min == -self.max else Better.NEITHER

    def __str__(self) -> str:
        if self.min is None:
            return f"at most {_number(self.max)}"
        if self.max is None:
            return f"at least {_number(self.min)}"
        if self.min == self.max:
            return f"exactly {_number(self.max)}"
        if self.min == -self.max:
            return f"within ±{_number(self.max)}"
        return f"{_number(self.min)} to {_number(self.max)}"


def _number(value: float | None) -> str:
    """Return a side of a limit as it was written, with thousands separated."""
    return f"{value:,.9g}".replace(",", " ")
