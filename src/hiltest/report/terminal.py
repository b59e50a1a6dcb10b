"""What is printed at the end of a session."""

from __future__ import annotations

from collections.abc import Sequence
from io import StringIO
from pathlib import Path

from rich.box import SIMPLE_HEAD
from rich.console import Console
from rich.markup import escape
from rich.table import Table as Grid

from hiltest.measurement import Measurement, Outcome
from hiltest.record.files import RECORD_FILES
from hiltest.record.run import Run
from hiltest.report.comparison_text import print_changes, say_how_to_keep
from hiltest.report.cost_line import cost_line
from hiltest.text import readable

BAND_BEYOND = "its band reaches beyond the limit"
"""What stands beside a count that keeps its limit; a remark, which changes no outcome."""

_STYLES = {Outcome.FAIL: "bold red", Outcome.UNSET: "yellow", Outcome.NOT_OFFERED: "dim"}


def summary(
    run: Run, folder: Path, *, every: bool, sentence: bool, width: int, colour: bool, options: str | None = None
) -> str:
    """Return the table of measurements, their bands, what the bench did, what changed, the files, costs and verdict.

    Parameters
    ----------
    run : Run
    folder : Path
        Where its files are.
    every : bool
        Whether to show measurements without a limit too.
    sentence : bool
        Whether to end with the verdict.
    width : int
        Columns of the terminal.
    colour : bool
        Whether it shows colours.
    options : str, optional
        For ``hiltest run``, to run the same on other seeds.
    """
    text = StringIO()
    console = Console(
        file=text, width=width, force_terminal=colour, no_color=not colour, color_system="standard" if colour else None,
        highlight=False,
    )
    shown = [each for each in run.measurements if every or each.limit or each.information or each.gates]
    if shown:
        console.print(_grid(shown))
    for each in shown:
        if each.note and not _is_why(each):
            console.print(escape(f"{each.name} {shown_value(each)}: {each.note}"), soft_wrap=True)
    _print_bands(console, run.measurements)
    if len(shown) < len(run.measurements):
        console.print(f"{len(run.measurements) - len(shown)} more without a limit are in the report")
    for test in run.tests:
        if test.outcome.is_of_bench:
            console.print(f"[red]{test.outcome}[/red]: {escape(test.id)}: {escape(test.reason)}", soft_wrap=True)
        if test.trace:
            trace = escape(f"{test.id}: {shown_path(folder / test.trace)}")
            console.print(f"wire trace of {trace}", soft_wrap=True)
    if run.comparison is not None:
        print_changes(console, run.comparison)
        say_how_to_keep(console, run.comparison, shown_path(folder), options)
    files = [name for name in RECORD_FILES if (folder / name).exists()]
    console.print(escape(f"{shown_path(folder)}: {', '.join(files)}"), soft_wrap=True)
    if line := cost_line(run):
        console.print(escape(line), soft_wrap=True)
    if sentence:
        console.print(escape(run.verdict.sentence), soft_wrap=True)
    return text.getvalue()


def shown_path(path: Path) -> str:
    """Return a path as one would type it here."""
    here = Path.cwd()
    return str(path.relative_to(here)) if path.is_relative_to(here) else str(path)


def shown_value(measurement: Measurement) -> str:
    """Return the value as people read it: four digits, whole numbers in groups of three."""
    value = measurement.value
    if value is None:
        return "-"
    return readable(value) if isinstance(value, int) or abs(value) >= 1000 else f"{value:.4g}"


def shown_limit(measurement: Measurement) -> str:
    """Return the limit as people read it; one in brackets is information, without a verdict."""
    if measurement.limit is None and measurement.information is not None:
        return f"({measurement.information})"
    return str(measurement.limit or "")


def shown_outcome(measurement: Measurement) -> str:
    """Return the outcome as people read it; without a limit nothing was judged."""
    if measurement.outcome is Outcome.INFORMATION:
        return ""
    return f"{measurement.outcome}; {BAND_BEYOND}" if measurement.band_reaches_beyond else str(measurement.outcome)


def _is_why(measurement: Measurement) -> bool:
    """Say whether the note is the reason of the outcome, and not what the number is of."""
    return measurement.outcome not in (Outcome.PASS, Outcome.INFORMATION)


def _empty_grid() -> Grid:
    return Grid(box=SIMPLE_HEAD, pad_edge=False, padding=(0, 1, 0, 0))


def _print_bands(console: Console, measurements: Sequence[Measurement]) -> None:
    """Print counts beside their bands, limit or not, and say of which the band decides about the limit."""
    banded = [(each, each.band) for each in measurements if each.band]
    for model in dict.fromkeys(each.cycle_model for each, _ in banded):
        rows = "hiltest timing show [--profile P] has the rows"
        console.print(escape(f"What the doubt about {model} makes of cycle counts; {rows}:"), soft_wrap=True)
        grid = _empty_grid()
        grid.add_column("measurement", overflow="fold")
        for name in ("cycles", "lowest", "highest"):
            grid.add_column(name, justify="right", no_wrap=True)
        grid.add_column("moved most by", no_wrap=True)
        for each, band in banded:
            if each.cycle_model == model:
                most = band.moved_most_by
                by = most.row if most else "memories" if band.low < band.high else "no row"
                grid.add_row(escape(each.name), shown_value(each), readable(band.low), readable(band.high), escape(by))
        console.print(grid)
    for each, _ in banded:
        if each.band_reaches_beyond:
            console.print(escape(f"{each.name}: {BAND_BEYOND}, {shown_limit(each)}"), style="yellow", soft_wrap=True)


def _grid(measurements: Sequence[Measurement]) -> Grid:
    grid = _empty_grid()
    grid.add_column("measurement", overflow="fold")
    grid.add_column("value", justify="right", no_wrap=True)
    grid.add_column("unit", no_wrap=True)
    grid.add_column("limit")
    grid.add_column("outcome", min_width=4)
    for each in measurements:
        # Remarks stand below: here they would leave the names no room.
        outcome = "" if each.outcome is Outcome.INFORMATION else str(each.outcome)
        outcome += f" ({each.note})" if each.note and _is_why(each) else ""
        grid.add_row(
            escape(each.name), shown_value(each), escape(each.unit), shown_limit(each), escape(outcome),
            style=_STYLES.get(each.outcome),
        )
    return grid
