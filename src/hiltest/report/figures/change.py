"""Against the baseline: how far each measurement that changed has moved."""

from __future__ import annotations

from hiltest.record.comparison import Change, Comparison, Difference
from hiltest.report.figures.rows import Row, RowFigure
from hiltest.report.marks import KeyEntry, Mark
from hiltest.verdict.wording import moved_percent, percent

_SHOWN = 10
_FURTHEST_PERCENT = 100.0
_MARKS = {
    Change.WORSE: (Mark.CROSS, "over"), Change.BETTER: (Mark.DOT, "better filled"),
    Change.CHANGED: (Mark.DIAMOND, "neutral filled"),
}
_KEY = tuple(KeyEntry(str(change), "", mark, style) for change, (mark, style) in _MARKS.items())


def change_figure(comparison: Comparison) -> RowFigure | None:
    """Draw what got worse, better or other in percent of the baseline's value, None when nothing did."""
    changed = [(each, moved) for change in _MARKS for each in comparison.of(change)
               if (moved := moved_percent(each)) is not None]
    if not changed:
        return None
    shown = changed[:_SHOWN]
    reach = min(_FURTHEST_PERCENT, max(abs(moved) for _, moved in shown)) or 1.0
    words = "" if len(shown) == len(changed) else f", {len(shown)} of {len(changed)}"
    return RowFigure(f"Change in percent of the baseline's value{words}", [_row(*each, reach) for each in shown], _KEY)


def _row(difference: Difference, moved: float, reach: float) -> Row:
    mark, style = _MARKS[difference.change]
    at = 0.5 + 0.47 * min(max(moved / reach, -1.0), 1.0)
    return Row(difference.name, f"{difference.change}, {percent(moved)}", at, mark, style, ends=(0.5,), start=0.5)
