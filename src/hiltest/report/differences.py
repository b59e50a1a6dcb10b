"""A comparison in words and numbers, the same in every report."""

from __future__ import annotations

from collections.abc import Iterator

from hiltest.comparison.model import Change, Comparison, Difference
from hiltest.measurement import readable

ORDER = (Change.WORSE, Change.GONE, Change.BETTER, Change.NEW, Change.CHANGED)
"""What a reader has to know first comes first; what did not change is only counted."""


def changed(comparison: Comparison) -> Iterator[Difference]:
    """Yield what changed, in the order that reports show it."""
    for change in ORDER:
        yield from comparison.of(change)


def counts(comparison: Comparison) -> str:
    """Return how many measurements changed in which way.

    Examples
    --------
    >>> counts(comparison)  # doctest: +SKIP
    '1 worse, 2 better, 150 unchanged'
    """
    numbers = ((len(comparison.of(change)), change) for change in (*ORDER, Change.UNCHANGED))
    return ", ".join(f"{number} {change}" for number, change in numbers if number) or "nothing to compare"


def shown(value: float | None) -> str:
    """Return a number as people read it; a dash where there is none."""
    return "-" if value is None else readable(value)


def shown_delta(difference: Difference) -> str:
    """Return how far a measurement moved, and relative to the base unless that is small beside the change."""
    if difference.delta is None:
        return ""
    words = f"{difference.delta:+.4g}" if abs(difference.delta) < 1000 else _signed(difference.delta)
    if difference.base and abs(difference.delta) <= abs(difference.base):
        words += f" ({100.0 * difference.delta / abs(difference.base):+.1f} %)"
    if difference.interval:
        low, high = difference.interval
        words += f", 95 % {readable(low)} to {readable(high)} over {difference.seeds} seeds"
    return words


def shown_tolerance(difference: Difference) -> str:
    """Return how far it may move and still count as unchanged."""
    absolute, relative = difference.tolerance.absolute, difference.tolerance.relative
    if not absolute and not relative:
        return "exact"
    parts = [f"{readable(absolute)} {difference.unit}".rstrip()] if absolute else []
    parts += [f"{100.0 * relative:g} %"] if relative else []
    return " and ".join(parts)


def _signed(value: float) -> str:
    return f"{'+' if value > 0 else '-'}{readable(abs(value))}"
