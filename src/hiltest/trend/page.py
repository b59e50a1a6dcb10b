"""A trend as one self-contained page: no script, no address, light and dark."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import groupby

from hiltest.report.marks import SERIES, KeyEntry
from hiltest.report.page import render
from hiltest.report.svg import Figure
from hiltest.trend import words
from hiltest.trend.figures import figure, step_key
from hiltest.trend.folder import Skipped
from hiltest.trend.series import Measured, Trend
from hiltest.verdict.wording import build, numbers, revision

STEPS_AT_MOST = 200


@dataclass(frozen=True, slots=True)
class Group:
    """Measurements that are shown together, with their plots."""

    heading: str
    rows: tuple[tuple[Measured, Figure], ...]
    is_open: bool


def trend_page(trend: Trend, skipped: Sequence[Skipped]) -> str:
    """Return the page: what made steps first, then all by the first word of their names."""
    counted = words.models(trend.measured)
    return render(
        "trend.html.j2", package="hiltest.trend", trend=trend, skipped=skipped, groups=_groups(trend),
        sentence=words.sentence(trend), counted=counted[:1].upper() + counted[1:], words=words, numbers=numbers,
        build=build, revision=revision, revised=any(each.evidence.side.revision for each in trend.entries),
        key=[*_line_key(trend), *(step_key() if trend.steps else [])],
        steps=trend.steps[:STEPS_AT_MOST], more_steps=max(0, len(trend.steps) - STEPS_AT_MOST),
    )


def _line_key(trend: Trend) -> list[KeyEntry]:
    """Return what the styles of the lines stand for, where there are several and each has its own."""
    if not 1 < len(trend.lines) <= len(SERIES):
        return []
    named = zip(trend.lines, SERIES, strict=False)
    return [KeyEntry(words.line_name(trend, line), style, mark, f"{style} filled") for line, (style, mark) in named]


def _groups(trend: Trend) -> list[Group]:
    names = [words.run_name(trend, index) for index in range(len(trend.entries))]
    drawn = [(each, figure(each, len(names), names)) for each in trend.measured]
    stepped = tuple((each, plot) for each, plot in drawn if each.steps)
    groups = [Group("Measurements with a step", stepped, is_open=True)] if stepped else []
    rest = [(each, plot) for each, plot in drawn if not each.steps]
    for word, members in groupby(rest, key=lambda pair: pair[0].name.split(".")[0]):
        groups.append(Group(word, tuple(members), is_open=False))
    return groups
