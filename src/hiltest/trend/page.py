"""A trend as one self-contained page: no script, no address, light and dark."""

from __future__ import annotations

from collections.abc import Sequence
from itertools import groupby

from hiltest.report.figures.section import FigureGroup, panel_width
from hiltest.report.marks import SERIES, KeyEntry
from hiltest.report.page import render
from hiltest.trend import words
from hiltest.trend.figures import figure, step_key
from hiltest.trend.folder import Skipped
from hiltest.trend.series import Measured, Trend
from hiltest.verdict.wording import build, numbers, revision

_POINTS_AT_MOST = 200
_MOST = 4  # plots in a row


def trend_page(trend: Trend, skipped: Sequence[Skipped]) -> str:
    """Return the page: the plots with a change point, what changed in each run, then all other plots."""
    counted = words.models(trend.measured)
    points = trend.steps[:_POINTS_AT_MOST]
    moved = dict.fromkeys(step.difference.name for step in trend.steps)
    stepped = [each for name in moved for each in trend.measured if each.name == name and each.steps]
    level = [each for each in trend.measured if not each.steps]
    groups = _plots(trend, "With a change point", stepped), _plots(trend, "Without a change point", level)
    return render(
        "trend.html.j2", package="hiltest.trend", trend=trend, skipped=skipped, sentence=words.sentence(trend),
        counted=counted[:1].upper() + counted[1:], words=words, numbers=numbers, build=build, revision=revision,
        revised=any(each.evidence.side.revision for each in trend.entries),
        key=[*_line_key(trend), *(step_key() if trend.steps else [])],
        groups=[each for each in groups if each.panels],
        changed=[(after, list(steps)) for after, steps in groupby(points, key=lambda step: step.after)],
        more=len(trend.steps) - len(points),
    )


def _plots(trend: Trend, heading: str, measured: Sequence[Measured]) -> FigureGroup:
    names = [words.run_name(trend, index) for index in range(len(trend.entries))]
    width = panel_width(len(measured), _MOST)
    drawn = [figure(each, names, more=words.under(trend, each), width=width) for each in measured]
    return FigureGroup("", heading, "", drawn, most=_MOST)


def _line_key(trend: Trend) -> list[KeyEntry]:
    """Return what the styles of the lines stand for, where there are several and each has its own."""
    if not 1 < len(trend.lines) <= len(SERIES):
        return []
    named = zip(trend.lines, SERIES, strict=False)
    return [KeyEntry(words.line_name(trend, line), style, mark, f"{style} filled") for line, (style, mark) in named]

