"""A trend as one self-contained page without scripts or addresses, as a table on the terminal, and as a document."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import asdict, dataclass
from itertools import groupby
from typing import Any

from rich.box import SIMPLE_HEAD
from rich.console import Console
from rich.markup import escape
from rich.table import Table

from hiltest.measurement import Outcome
from hiltest.report.figures.section import FigureGroup, panel_width
from hiltest.report.marks import SERIES, KeyEntry
from hiltest.report.page import render
from hiltest.report.trend import words
from hiltest.report.trend.figures import change_point_key, figure
from hiltest.report.trend.folder import Skipped
from hiltest.report.trend.series import ChangePoint, MeasurementTrend, Point, RunEntry, Series, Trend, TrendLine
from hiltest.run_record.comparison import Change
from hiltest.verdict.wording import build, numbers, revision

_POINTS_AT_MOST = 200
_MOST = 4  # plots in a row
_STEPS_AT_MOST = 20
_STYLES = {Change.WORSE: "red", Change.BETTER: "green"}


@dataclass(frozen=True, slots=True)
class TrendDocument:
    """Measurements over the runs of a folder; entries and lines are numbered from 0."""

    entries: list[dict[str, Any]]
    """Runs in order of time."""
    lines: tuple[TrendLine, ...]
    """Conditions that joined runs share."""
    measurements: list[dict[str, Any]]
    """Measurements with values, limits and change points by line."""
    skipped: Sequence[Skipped]
    """Files that are no records, and the reasons."""


def trend_page(trend: Trend, skipped: Sequence[Skipped]) -> str:
    """Return the page: plots with a change point, the changes of each run, then all other plots."""
    remark = words.models(trend.measured)
    points = trend.change_points[:_POINTS_AT_MOST]
    moved = dict.fromkeys(step.difference.name for step in trend.change_points)
    stepped = [
        measured for name in moved for measured in trend.measured if measured.name == name and measured.change_points
    ]
    level = [measured for measured in trend.measured if not measured.change_points]
    groups = _plots(trend, "With a change point", stepped), _plots(trend, "Without a change point", level)
    return render(
        "trend.html.j2",
        package="hiltest.report.trend",
        trend=trend,
        skipped=skipped,
        sentence=words.sentence(trend),
        counted=remark[:1].upper() + remark[1:],
        words=words,
        numbers=numbers,
        build=build,
        revision=revision,
        revised=any(entry.evidence.side.revision for entry in trend.entries),
        key=[*_line_key(trend), *(change_point_key() if trend.change_points else [])],
        groups=[group for group in groups if group.panels],
        changed=[(after, list(steps)) for after, steps in groupby(points, key=lambda step: step.after)],
        more=len(trend.change_points) - len(points),
    )


def _plots(trend: Trend, heading: str, measured: Sequence[MeasurementTrend]) -> FigureGroup:
    names = [f"{words.run_name(trend, index)}, {entry.when_utc[:10]}" for index, entry in enumerate(trend.entries)]
    width = panel_width(len(measured), _MOST)
    drawn = [figure(measurement, names, more=words.under(trend, measurement), width=width) for measurement in measured]
    return FigureGroup("", heading, "", drawn, most=_MOST)


def _line_key(trend: Trend) -> list[KeyEntry]:
    """Return the key of the lines' styles, if there are several lines and each has its own style."""
    if not 1 < len(trend.lines) <= len(SERIES):
        return []
    named = zip(trend.lines, SERIES, strict=False)
    return [KeyEntry(words.line_name(trend, line), style, mark, f"{style} filled") for line, (style, mark) in named]


def print_trend(trend: Trend, console: Console, *, every: bool) -> None:
    """Print measurements with a limit or change point, or all with `every`; then the newest changes and a sentence."""
    shown = [measured for measured in trend.measured if every or measured.limit or measured.change_points]
    if shown:
        console.print(_grid(trend, shown))
    if remark := words.models(shown):
        console.print(escape(remark), soft_wrap=True)
    if len(shown) < len(trend.measured):
        console.print(f"{len(trend.measured) - len(shown)} more without limit and change point (--all shows them)")
    for step in trend.change_points[:_STEPS_AT_MOST]:
        entry, difference = trend.entries[step.after], step.difference
        run = f"{words.run_name(trend, step.after)}, {entry.when_utc}"
        line = f"{run}: {difference.change}: {difference.name} {numbers(difference)}"
        console.print(escape(line), style=_STYLES.get(difference.change), soft_wrap=True)
        console.print(escape(f"    {words.between(trend, step)} ({entry.file})"), soft_wrap=True)
    if len(trend.change_points) > _STEPS_AT_MOST:
        console.print(f"and {len(trend.change_points) - _STEPS_AT_MOST} earlier change points")
    console.print(escape(words.sentence(trend)), soft_wrap=True)


def _grid(trend: Trend, measured: list[MeasurementTrend]) -> Table:
    grid = Table(box=SIMPLE_HEAD, pad_edge=False, padding=(0, 1, 0, 0))
    for heading in words.HEADINGS:
        grid.add_column(heading, justify="right" if heading in words.NUMERIC else "left", overflow="fold")
    for measurement, cells in zip(measured, words.rows(trend, measured), strict=True):
        grid.add_row(*map(escape, cells), style="bold" if measurement.change_points else None)
    return grid


def trend_document(trend: Trend, skipped: Sequence[Skipped]) -> TrendDocument:
    """Return the document of ``hiltest report trend``."""
    entries = [_entry(entry) for entry in trend.entries]
    return TrendDocument(entries, trend.lines, [_measured(measured) for measured in trend.measured], skipped)


def _entry(entry: RunEntry) -> dict[str, Any]:
    side = asdict(entry.evidence.side)
    return {**side, "file": entry.file, "when_utc": entry.when_utc, "faults": list(entry.evidence.faults)}


def _measured(measured: MeasurementTrend) -> dict[str, Any]:
    return {"name": measured.name, "unit": measured.unit, "series": [_series(series) for series in measured.series]}


def _series(series: Series) -> dict[str, Any]:
    points = series.points
    spread = any(point.low < point.high for point in points)
    return {
        "line": series.line,
        "cycle_model": series.cycle_model,
        "entries": [point.entry for point in points],
        "values": [point.value for point in points],
        "lowest": [point.low for point in points] if spread else None,
        "highest": [point.high for point in points] if spread else None,
        "limits": [_limit(stretch) for _, stretch in groupby(points, key=lambda point: point.limit)],
        "failed": [point.entry for point in points if point.outcome == Outcome.FAIL],
        "steps": [_step(change_point) for change_point in series.change_points],
    }


def _limit(stretch: Iterator[Point]) -> dict[str, Any]:
    """Return a limit and the first entry that has it."""
    first = next(stretch)
    return {"entry": first.entry, "limit": first.limit and asdict(first.limit)}


def _step(step: ChangePoint) -> dict[str, Any]:
    difference = step.difference
    return {
        "before": step.before,
        "after": step.after,
        "change": difference.change,
        "base": difference.base,
        "new": difference.new,
        "delta": difference.delta,
        "interval": difference.interval,
        "tolerance": asdict(difference.tolerance),
    }
