"""A comparison in words: the numbers of one measurement, and all of it in one sentence."""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence
from math import isfinite

from hiltest.comparison.model import Change, Comparison, Difference, Revision, Side
from hiltest.measurement import readable

SHOWN = (Change.WORSE, Change.GONE, Change.BETTER, Change.NEW, Change.CHANGED)
"""In this order; what is unchanged is only counted."""

_NAMED_AT_MOST = 2
_COMMIT_DIGITS = 12  # which tell any two commits of a repository apart


def revision(of: Revision | None) -> str:
    """Return what sources a run was made for: label, commit and branch, as far as they are known.

    Examples
    --------
    ``v1.2-rc1, commit 0123456789ab, branch main``
    """
    if of is None:
        return ""
    commit = f"commit {of.commit[:_COMMIT_DIGITS]}" if of.commit else ""
    return ", ".join(filter(None, (of.label, commit, f"branch {of.branch}" if of.branch else "")))


def build(side: Side) -> str:
    """Return what build the numbers of a side are of; those of a baseline may be of several.

    Examples
    --------
    ``build 8fc8, with 2 measurements accepted from build 17ab and 1 measurement accepted from build 90cd``
    """
    accepted = [
        f"{each.measurements} measurement{'s' * (each.measurements != 1)} accepted from build {each.build_id}"
        for each in side.accepted
    ]
    of_firmware = f"build {side.build_id}" if side.build_id else "no firmware"
    return of_firmware + (f", with {' and '.join(accepted)}" if accepted else "")


def numbers(difference: Difference) -> str:
    """Return what a measurement was and is, how far it moved, and its limit.

    Examples
    --------
    ``11 061 -> 11 161 cycles (+100, +0.9 %; limit at most 12 500)``
    """
    was, now = (_value(value) for value in (difference.base, difference.new))
    if difference.base is None or difference.new is None:
        values = was if difference.new is None else now
    else:
        values = f"{was} -> {now}"
    details = "; ".join(filter(None, (moved(difference), _limit(difference), difference.note)))
    return f"{values} {_unit(difference)}".rstrip() + (f" ({details})" if details else "")


def moved(difference: Difference) -> str:
    """Return by how much a measurement moved, in its unit and in percent; empty when it has no pair."""
    if difference.delta is None:
        return ""
    words = _signed(difference.delta)
    if difference.base and difference.base * (difference.new or 0.0) > 0:
        share = 100 * difference.delta / abs(difference.base)
        words += f", {percent(share)} %" if isfinite(share) else ""
    if difference.interval is not None:
        low, high = difference.interval
        words += f", 95 % {_signed(low)} to {_signed(high)}"
    return words


def sentence(differences: Sequence[Difference], obstacles: Sequence[str]) -> str:
    """Return what a comparison comes to, in one sentence."""
    if obstacles:
        more = len(obstacles) - 1
        others = f" (and {more} more reason{'s' * (more > 1)})" if more else ""
        return f"NOT EVALUATED: {obstacles[0]}{others}."
    counts = Counter(each.change for each in differences)
    tally = ", ".join(f"{counts[each]} {each}" for each in (*SHOWN, Change.UNCHANGED) if counts[each]) or "nothing"
    worse = [each for each in differences if each.change is Change.WORSE]
    if not worse:
        return f"No regression: {tally}."
    named = [f"{each.name} {numbers(each)}" for each in worse[:_NAMED_AT_MOST]]
    more = len(worse) - len(named)
    return f"REGRESSION: {', '.join(named)}{f' and {more} more' if more else ''}; {tally}."


def shown(comparison: Comparison) -> list[tuple[Change, tuple[Difference, ...]]]:
    """Return the groups that are shown, in the order to show them, without empty ones."""
    groups = [(change, comparison.of(change)) for change in SHOWN]
    return [(change, found) for change, found in groups if found]


def _value(value: float | None) -> str:
    return "-" if value is None else readable(value)


def _signed(value: float) -> str:
    return f"{'+' if value >= 0 else '-'}{readable(abs(value))}"


def percent(value: float) -> str:
    """Return two digits of it, or all before the point."""
    return f"{value:+.2g}" if abs(value) < 99.5 else f"{'+' if value > 0 else '-'}{readable(round(abs(value)))}"


def _unit(difference: Difference) -> str:
    return "cycles" if difference.unit == "cycle" else difference.unit


def _limit(difference: Difference) -> str:
    return "" if difference.limit is None else f"limit {difference.limit}"
