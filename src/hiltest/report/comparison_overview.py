"""What the page shows of a comparison with a baseline: its changes in order of concern, and the two sides."""

from __future__ import annotations

from dataclasses import dataclass

from hiltest.comparison.model import Change, Comparison, Difference, Tolerance
from hiltest.measurement import readable
from hiltest.report.figures.change import change_figure, change_percent, percent_text
from hiltest.report.figures.rows import RowFigure

# In order of concern, with the sign that stands for each beside its word.
SIGNS = {Change.WORSE: "✗", Change.GONE: "−", Change.BETTER: "✓", Change.NEW: "+", Change.CHANGED: "≠"}
TONES = {Change.WORSE: "fail", Change.GONE: "fail", Change.BETTER: "pass"}


@dataclass(frozen=True, slots=True)
class Changed:
    """One measurement that is not what it was, as text."""

    name: str
    change: str
    sign: str
    tone: str
    base: str
    new: str
    delta: str
    tolerance: str
    limit: str
    note: str


@dataclass(frozen=True, slots=True)
class AgainstBaseline:
    """The section of the page."""

    comparison: Comparison
    tone: str
    counts: str
    changed: tuple[Changed, ...]
    sides: tuple[tuple[str, str, str], ...]
    figure: RowFigure | None


def against_baseline(comparison: Comparison | None) -> AgainstBaseline | None:
    """Return the section, None when the run was compared with nothing."""
    if comparison is None:
        return None
    tone = "warn" if comparison.obstacles else "bad" if comparison.regression else "good"
    counts = ", ".join(f"{len(found)} {change}" for change in (*SIGNS, Change.UNCHANGED)
                       if (found := comparison.of(change)))
    changed = (each for change in SIGNS for each in comparison.of(change))
    return AgainstBaseline(
        comparison, tone, counts or "nothing compared", tuple(map(_in_text, changed)), tuple(_sides(comparison)),
        change_figure(comparison),
    )


def _in_text(each: Difference) -> Changed:
    return Changed(
        each.name, str(each.change), SIGNS[each.change], TONES.get(each.change, ""), _number(each.base, each.unit),
        _number(each.new, each.unit), _delta(each), _tolerance(each.tolerance, each.unit), str(each.limit or ""),
        each.note,
    )


def _number(value: float | None, unit: str) -> str:
    return "" if value is None else f"{readable(value)} {unit}".rstrip()


def _delta(each: Difference) -> str:
    if each.delta is None:
        return ""
    percent = change_percent(each)
    parts = [f"{'+' if each.delta > 0 else ''}{readable(each.delta)}"]
    if percent is not None:
        parts.append(percent_text(percent))
    if each.interval is not None:
        low, high = each.interval
        parts.append(f"95 %: {readable(low)} to {readable(high)} over {each.seeds} seeds")
    return ", ".join(parts)


def _tolerance(tolerance: Tolerance, unit: str) -> str:
    if tolerance.absolute == 0.0 and tolerance.relative == 0.0:
        return "exact"
    return f"{readable(tolerance.absolute)} {unit}".rstrip() + f" and {100.0 * tolerance.relative:g} %"


def _sides(comparison: Comparison) -> list[tuple[str, str, str]]:
    base, new = comparison.base, comparison.new
    rows = [
        ("file", base.file, new.file or "this run"), ("SHA-256", base.sha256, new.sha256),
        ("firmware", f"{base.firmware} {base.version}", f"{new.firmware} {new.version}"),
        ("build", base.build_id, new.build_id), ("compiler", base.compiler, new.compiler),
        ("cycle model", base.cycle_model, new.cycle_model), ("rig", base.rig, new.rig),
        ("seeds", ", ".join(map(str, base.seeds)), ", ".join(map(str, new.seeds))),
        ("saved", base.saved_utc, new.saved_utc),
    ]
    return [row for row in rows if row[1].strip() or row[2].strip()]
