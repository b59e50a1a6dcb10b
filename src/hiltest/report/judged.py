"""What a verdict says of the base that its run was judged against."""

from __future__ import annotations

from hiltest.comparison.model import Change, Comparison, Difference
from hiltest.comparison.words import SHOWN, numbers

_NAMED_AT_MOST = 2


def judged_words(comparison: Comparison | None, *, passes: bool, chosen: bool = False) -> str:
    """Return what got better and what got worse since the base, in one sentence; nothing without a base.

    Parameters
    ----------
    comparison : Comparison or None
    passes : bool
        Whether the run passes: only then may the change be merged.
    chosen : bool, optional
        Whether only chosen tests ran: what the others would have said is not known then.
    """
    if comparison is None:
        return ""
    base = comparison.base.file
    if not comparison.evaluated:
        more = len(comparison.obstacles) - 1
        others = f" (and {more} more reason{'s' * (more > 1)})" if more else ""
        return f"Not compared with {base}: {comparison.obstacles[0].rstrip('.')}{others}."
    counts = [_counted(change, comparison.of(change)) for change in (*SHOWN, Change.UNCHANGED)]
    merge = ""
    if comparison.regression:
        merge = ": not to be merged"
    elif passes:
        merge = ": only the chosen tests were compared" if chosen else ": may be merged"
    return f"Against {base}: {'; '.join(filter(None, counts)) or 'nothing measured'}{merge}."


def _counted(change: Change, found: tuple[Difference, ...]) -> str:
    if not found:
        return ""
    if change not in (Change.WORSE, Change.BETTER):
        return f"{len(found)} {change}"
    named = [f"{each.name} {numbers(each)}" for each in found[:_NAMED_AT_MOST]]
    more = len(found) - len(named)
    return f"{len(found)} {change}: {', '.join(named)}{f' and {more} more' if more else ''}"
