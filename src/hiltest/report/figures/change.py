"""Against the baseline: how far each measurement that changed has moved."""

from __future__ import annotations

from collections.abc import Sequence

from hiltest.comparison.model import Change, Comparison, Difference
from hiltest.report.figures.rows import Row, RowFigure
from hiltest.report.marks import KeyEntry, Mark

_SHOWN = 20
_FURTHEST_PERCENT = 100.0
_MARKS = {
    Change.WORSE: (Mark.CROSS, "over"), Change.BETTER: (Mark.DOT, "better filled"),
    Change.CHANGED: (Mark.DIAMOND, "neutral filled"),
}
_KEY = tuple(KeyEntry(str(change), "", mark, style) for change, (mark, style) in _MARKS.items())


def change_figure(comparison: Comparison) -> RowFigure | None:
    """Draw what got worse, better or other in percent of the baseline's value, None when nothing did."""
    moved = [(each, percent) for change in _MARKS for each in comparison.of(change)
             if (percent := change_percent(each)) is not None]
    if not moved:
        return None
    shown = sorted(moved, key=lambda each: (list(_MARKS).index(each[0].change), -abs(each[1])))[:_SHOWN]
    reach = min(_FURTHEST_PERCENT, max(abs(percent) for _, percent in shown)) or 1.0
    words = "" if len(shown) == len(moved) else f", {len(shown)} of {len(moved)}"
    return RowFigure(
        f"Change of the baseline's value{words}", _in_words(shown), [_row(*each, reach) for each in shown], key=_KEY
    )


def change_percent(difference: Difference) -> float | None:
    """Return the change in percent of the base, None without a number or with a base of 0."""
    if difference.delta is None or not difference.base:
        return None
    return 100.0 * difference.delta / abs(difference.base)


def percent_text(percent: float) -> str:
    """Return a change in percent with its sign, and as many decimals as say something.

    Examples
    --------
    >>> percent_text(0.904), percent_text(-12.34), percent_text(312.4)
    ('+0.90 %', '-12.3 %', '+312 %')
    """
    decimals = 2 if abs(percent) < 1.0 else 1 if abs(percent) < 100.0 else 0
    return f"{percent:+.{decimals}f} %"


def _row(difference: Difference, percent: float, reach: float) -> Row:
    mark, style = _MARKS[difference.change]
    at = 0.5 + 0.47 * min(max(percent / reach, -1.0), 1.0)
    return Row(difference.name, percent_text(percent), at, mark, style, ends=(0.5,), start=0.5)


def _in_words(shown: Sequence[tuple[Difference, float]]) -> str:
    return "; ".join(f"{each.name}: {each.change}, {percent_text(percent)}" for each, percent in shown)
