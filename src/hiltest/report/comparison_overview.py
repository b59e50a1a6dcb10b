"""Contents of a comparison's report: its changes in order of concern, the two sides, the counts, and a figure."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

from hiltest.report.figures.rows import Row, RowFigure
from hiltest.report.marks import KeyEntry, Mark
from hiltest.run_record.comparison import Answer, Change, Comparison, Difference, Side
from hiltest.text import format_number
from hiltest.verdict.wording import (
    SHOWN,
    build,
    counted_by,
    held_to,
    models_shown,
    moved,
    moved_percent,
    percent,
    revision,
    seen_from,
    shown,
)

# Signs beside the words, for readers who do not see their colour.
_SIGNS = {Change.WORSE: "✗", Change.GONE: "−", Change.BETTER: "✓", Change.NEW: "+", Change.CHANGED: "≠"}
_ANSWERS = {Answer.MAY: "good", Answer.NOT: "bad", Answer.UNKNOWN: "warn"}
_TONES = {Change.WORSE: "fail", Change.GONE: "fail", Change.BETTER: "pass"}
_DRAWN_AT_MOST = 10
_FURTHEST_PERCENT = 100.0
_MARKS = {
    Change.WORSE: (Mark.CROSS, "over"),
    Change.BETTER: (Mark.DOT, "better filled"),
    Change.CHANGED: (Mark.DIAMOND, "neutral filled"),
}
_KEY = tuple(KeyEntry(str(change), "", mark, style) for change, (mark, style) in _MARKS.items())


@dataclass(frozen=True, slots=True)
class Changed:
    """One changed measurement, as text; `outcome` includes the note."""

    name: str
    change: str
    sign: str
    tone: str
    base: str
    new: str
    moved: str
    tolerance: str
    limit: str
    outcome: str


@dataclass(frozen=True, slots=True)
class AgainstBaseline:
    """Section of the page about the comparison."""

    comparison: Comparison
    tone: str
    counts: str
    changed: tuple[Changed, ...]
    sides: tuple[tuple[str, str, str], ...]
    figure: RowFigure | None


def against_baseline(comparison: Comparison | None) -> AgainstBaseline | None:
    """Return the section; None if the run was compared with nothing."""
    if comparison is None:
        return None
    return AgainstBaseline(
        comparison,
        _ANSWERS[comparison.answer],
        counts(comparison),
        tuple(changed(comparison)),
        tuple(sides(comparison)),
        change_figure(comparison),
    )


def changed(comparison: Comparison) -> Iterator[Changed]:
    """Yield the changed measurements, worst first; unchanged ones are only counted."""
    for _, differences in shown(comparison):
        yield from map(_changed_row, differences)


def counts(comparison: Comparison) -> str:
    """Return the number of measurements for each change, and the cycle models of the cycles shown."""
    numbers = (
        (len(comparison.differences_with(change)), change) for change in (*SHOWN, Change.NOT_TAKEN, Change.UNCHANGED)
    )
    words = ", ".join(f"{number} {change}" for number, change in numbers if number) or "nothing to compare"
    return "; ".join(filter(None, (words, counted_by(models_shown(comparison)))))


def sides(comparison: Comparison) -> Iterator[tuple[str, str, str]]:
    """Yield name, base and new value of each property of the two sides that at least one of them states."""
    for (name, base), (_, new) in zip(_side(comparison.base), _side(comparison.new), strict=True):
        if base or new:
            yield name, base, new


def _changed_row(difference: Difference) -> Changed:
    outcome = "" if difference.outcome == "information" else difference.outcome
    tolerance = "; ".join(filter(None, (held_to(difference.tolerance, difference.unit), seen_from(difference))))
    return Changed(
        difference.name,
        str(difference.change),
        _SIGNS[difference.change],
        _TONES.get(difference.change, ""),
        _number(difference.base, difference.unit),
        _number(difference.new, difference.unit),
        moved(difference),
        "" if difference.delta is None else tolerance,
        str(difference.limit or ""),
        ": ".join(filter(None, (outcome, difference.note))),
    )


def _number(value: float | None, unit: str) -> str:
    return "-" if value is None else f"{format_number(value)} {unit}".rstrip()


def _side(side: Side) -> Iterator[tuple[str, str]]:
    yield "file", f"{side.file} {side.sha256[:16]}".strip()
    yield "firmware", f"{side.firmware} {side.version} {build(side)}"
    yield "made for", revision(side.revision)
    yield "compiler", side.compiler
    yield "cycle model", side.cycle_model
    yield "rig", side.rig
    yield "seeds", ", ".join(map(str, side.seeds)) or "none"
    yield "saved", side.saved_utc


def change_figure(comparison: Comparison) -> RowFigure | None:
    """Draw the changes in percent of the baseline's value; None without any."""
    candidates = [
        (difference, by_percent)
        for change in _MARKS
        for difference in comparison.differences_with(change)
        if (by_percent := moved_percent(difference)) is not None
    ]
    if not candidates:
        return None
    drawn = candidates[:_DRAWN_AT_MOST]
    reach = min(_FURTHEST_PERCENT, max(abs(by_percent) for _, by_percent in drawn)) or 1.0
    words = "" if len(drawn) == len(candidates) else f", {len(drawn)} of {len(candidates)}"
    rows = [_row(difference, by_percent, reach) for difference, by_percent in drawn]
    return RowFigure(f"Change in percent of the baseline's value{words}", rows, _KEY)


def _row(difference: Difference, by_percent: float, reach: float) -> Row:
    mark, style = _MARKS[difference.change]
    at = 0.5 + 0.47 * min(max(by_percent / reach, -1.0), 1.0)
    return Row(difference.name, f"{difference.change}, {percent(by_percent)}", at, mark, style, ends=(0.5,), start=0.5)
