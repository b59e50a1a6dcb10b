"""A trend at the terminal."""

from __future__ import annotations

from rich.box import SIMPLE_HEAD
from rich.console import Console
from rich.markup import escape
from rich.table import Table

from hiltest.record.comparison import Change
from hiltest.trend import words
from hiltest.trend.series import Measured, Trend
from hiltest.verdict.wording import numbers

_STEPS_AT_MOST = 20
_STYLES = {Change.WORSE: "red", Change.BETTER: "green"}


def print_trend(trend: Trend, console: Console, *, every: bool) -> None:
    """Print what has a limit or a change point, or with `every` all; then the newest change points and the sentence."""
    shown = [each for each in trend.measured if every or each.limit or each.steps]
    if shown:
        console.print(_grid(trend, shown))
    if remark := words.models(shown):
        console.print(escape(remark), soft_wrap=True)
    if len(shown) < len(trend.measured):
        console.print(f"{len(trend.measured) - len(shown)} more without limit and change point: --all")
    for step in trend.steps[:_STEPS_AT_MOST]:
        entry, found = trend.entries[step.after], step.difference
        line = f"{words.run_name(trend, step.after)}, {entry.when_utc}: {found.change}: {found.name} {numbers(found)}"
        console.print(escape(line), style=_STYLES.get(found.change), soft_wrap=True)
        console.print(escape(f"    {words.between(trend, step)} ({entry.file})"), soft_wrap=True)
    if len(trend.steps) > _STEPS_AT_MOST:
        console.print(f"and {len(trend.steps) - _STEPS_AT_MOST} change points before")
    console.print(escape(words.sentence(trend)), soft_wrap=True)


def _grid(trend: Trend, measured: list[Measured]) -> Table:
    grid = Table(box=SIMPLE_HEAD, pad_edge=False, padding=(0, 1, 0, 0))
    for heading in words.HEADINGS:
        grid.add_column(heading, justify="right" if heading in words.NUMERIC else "left", overflow="fold")
    for each, cells in zip(measured, words.rows(trend, measured), strict=True):
        grid.add_row(*map(escape, cells), style="bold" if each.steps else None)
    return grid
