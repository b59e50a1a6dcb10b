"""Tables of judged entries for a terminal, and the page with the picture."""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence

from rich.box import SIMPLE_HEAD
from rich.console import Console
from rich.markup import escape
from rich.table import Table

from hiltest.judge.filter_scores import PhaseScore
from hiltest.judge.judgement import ALL, EntryResult, JudgeDocument, ranks_with
from hiltest.judge.worlds import DEFAULT_CLOUDS, FAMILIES, RIG, WORLDS
from hiltest.measurement.estimates import Estimate
from hiltest.report.marks import SERIES, KeyEntry, series
from hiltest.report.page import render
from hiltest.report.svg import Figure, log_ticks
from hiltest.text import format_number

_TEXTS = ("motion", "phase")
_NO_CYCLES, _EDGE = "no cycles", 3.0  # ratio of cycles that the edge of the picture is wide
PAGE_FILE, JSON_FILE = "judge.html", "judge.json"
HEADINGS = (
    "calibrator",
    *DEFAULT_CLOUDS,
    "x bound",
    "interval",
    "median",
    "99 %",
    "worst [deg]",
    "refused",
    "no ellipsoid",
    "cycles",
    "range",
    "other compiler",
    "stack",
    "flash",
)
FILTER_HEADINGS = (
    "filter",
    "motion",
    "phase",
    "total [deg]",
    "heading [deg]",
    "inclination [deg]",
    "cycles",
    "range",
    "most cycles",
)
FAMILY_HEADINGS = ("worlds", "x bound", "interval", "median", "99 %", "interval", "refused", "they would err [deg]")


def print_tables(console: Console, judged: JudgeDocument) -> None:
    """Print all entries, and the families of the judged one."""
    if judged.filters:
        console.print(_table("", *filled_columns(FILTER_HEADINGS, list(filter_rows(judged)))))
        return
    first = judged.entries[0]
    console.print(_table("", *filled_columns(HEADINGS, [entry_row(entry, first) for entry in judged.entries])))
    console.print(_table(first.name, *filled_columns(FAMILY_HEADINGS, list(family_rows(first)))))


def filled_columns(headings: Sequence[str], rows: Sequence[Sequence[str]]) -> tuple[list[str], list[list[str]]]:
    """Return headings and rows without the columns that are empty in all rows."""
    filled = [number for number, _ in enumerate(headings) if any(row[number] for row in rows)]
    return [headings[number] for number in filled], [[row[number] for number in filled] for row in rows]


def _table(title: str, headings: Sequence[str], rows: Sequence[Sequence[str]]) -> Table:
    table = Table(
        title=escape(title) or None, title_justify="left", box=SIMPLE_HEAD, pad_edge=False, padding=(0, 1, 0, 0)
    )
    for number, heading in enumerate(headings):
        table.add_column(heading, justify="left" if number == 0 or heading in _TEXTS else "right")
    for row in rows:
        table.add_row(*map(escape, row))
    return table


def entry_row(entry: EntryResult, first: EntryResult) -> tuple[str, ...]:
    """Return a row under `HEADINGS`; cycles that do not rank with those of the first entry are in another column."""
    rig, whole, cost = entry.family(RIG), entry.family(ALL), entry.cost
    cycles = format_number(cost.cycles) if cost.cycles else ""
    is_ranked = entry is first or not first.cost.cycles or ranks_with(entry, first)
    return (
        entry.name,
        *(_value(entry.family(cloud).rms) for cloud in DEFAULT_CLOUDS),
        _value(whole.rms),
        _interval(whole.rms),
        _value(whole.median),
        _value(whole.p99),
        _value(rig.worst_deg),
        str(whole.refused),
        str(whole.no_ellipsoid),
        cycles if is_ranked else "",
        f"{format_number(cost.low)} to {format_number(cost.high)}" if cost.low and cost.high else "",
        "" if is_ranked else cycles,
        "" if cost.stack_bytes is None else format_number(cost.stack_bytes),
        "" if cost.flash_bytes is None else format_number(cost.flash_bytes),
    )


def family_rows(entry: EntryResult) -> Iterator[tuple[str, ...]]:
    """Yield a row under `FAMILY_HEADINGS` for each family."""
    titles = {family.name: f"{family.name}: {family.title}" for family in FAMILIES} | {ALL: "all"}
    for result in entry.families:
        yield (
            titles[result.family],
            _value(result.rms),
            _interval(result.rms),
            _value(result.median),
            _value(result.p99),
            _interval(result.p99),
            str(result.refused),
            "" if result.refused_deg is None else f"{result.refused_deg:.1f}",
        )


def filter_rows(judged: JudgeDocument) -> Iterator[tuple[str, ...]]:
    """Yield a row under `FILTER_HEADINGS` for each filter, motion and phase."""
    for result in judged.filters:
        for score in result.scores:
            yield (
                result.name,
                score.motion,
                score.phase,
                *(f"{error:.2f}" if error is not None else "" for error in _errors(score)),
                "" if result.cycles is None else format_number(result.cycles),
                "" if result.low is None else f"{result.low} to {result.high}",
                "" if result.most_cycles is None else format_number(result.most_cycles),
            )


def _errors(score: PhaseScore) -> tuple[float | None, float, float | None]:
    return score.total_deg, score.heading_deg, score.inclination_deg


def _value(estimate: Estimate | None) -> str:
    return "" if estimate is None else f"{estimate.value:.2f}"


def _measured(value: float | None) -> str:
    return "not measured" if value is None else f"{value:g}"


def _interval(estimate: Estimate | None) -> str:
    return "" if estimate is None else estimate.interval


def page(judged: JudgeDocument) -> str:
    """Return the page: sentence, picture and tables."""
    rows = [entry_row(entry, judged.entries[0]) for entry in judged.entries]
    return render(
        "judge.html.j2",
        package="hiltest.judge",
        judged=judged,
        name=(judged.filters or judged.entries)[0].name,
        figure=_figure(judged.entries),
        filters=filled_columns(FILTER_HEADINGS, list(filter_rows(judged))),
        all_entries=filled_columns(HEADINGS, rows),
        families=[
            (entry, filled_columns(FAMILY_HEADINGS, list(family_rows(entry))))
            for entry in judged.entries
            if entry.role != "hiltest"
        ],
        limits=[(limit.name, _measured(limit.value), f"{limit.most:g}") for limit in judged.limits],
        worlds=WORLDS * len(FAMILIES),
    )


def _figure(entries: Sequence[EntryResult]) -> Figure | None:
    """Draw the error over the bound against cycles, and entries without cycles at the edge.

    None without two entries that have an error, or without cycles.
    """
    drawn = [
        (entry, float(entry.cost.cycles or 0), whole.rms, whole.p99.value)
        for entry in entries
        if (whole := entry.family(ALL)).rms and whole.p99
    ]
    xs, ys = [cycles for _, cycles, _, _ in drawn if cycles], [y for *_, rms, high in drawn for y in (rms.value, high)]
    if len(drawn) < 2 or not xs:  # one dot is no comparison
        return None
    ends, has_edge = (min(xs) / 1.5, max(xs) * 1.5), len(xs) < len(drawn)
    figure = Figure(
        title="Error over bound against cycles",
        description="; ".join(
            f"{entry.name}: {middle.value:.2f} times the bound, {high:.2f} in the 99th percentile, "
            + (f"for {cycles:.0f} cycles" if cycles else _NO_CYCLES)
            for entry, cycles, middle, high in drawn
        ),
        x_label="cycles for 100 points",
        y_label="rms heading error / bound",
        x_range=(ends[0], ends[1] * (_EDGE if has_edge else 1.0)),
        x_ticks=log_ticks(*ends) if has_edge else (),
        y_range=(min(0.5, *ys) / 1.1, max(ys) * 1.2),
        log_x=True,
        log_y=True,
        width=720.0,
        height=360.0,
    )
    for number, (entry, cycles, middle, high) in enumerate(drawn):
        style, mark = series(number)
        fill = "filled" if number < len(SERIES) else "hollow"  # shapes repeat
        mark_style, radius = f"{style} {fill}", 5.0 if entry.role == "hiltest" else 7.0
        x, text = (cycles, "") if cycles else (ends[1] * math.sqrt(_EDGE), _NO_CYCLES)
        figure.bars([(x, middle.value, high)], style)
        figure.series(entry.name, [(x, middle.value)], mark=mark, mark_style=mark_style, radius=radius, x_text=text)
    if has_edge:
        figure.upright(ends[1], _NO_CYCLES, "thesis", right=True)
    figure.level(1.0, "limit")
    figure.key.append(KeyEntry("bound", "limit"))
    return figure
