"""Output at the end of a session: the verdict, failures, the calibrators, what is close to its limit, and the files."""

from __future__ import annotations

import os
import re
import textwrap
from collections.abc import Mapping, Sequence
from io import StringIO
from pathlib import Path

from rich.console import Console
from rich.markup import escape
from rich.table import Table as Grid

from hiltest.measurement import Measurement, Outcome
from hiltest.record.failures import by_reason, tests_named
from hiltest.record.files import REPORT_FILE
from hiltest.record.run import CoverageRecord, Run
from hiltest.report.comparison_text import print_changes, print_smallest_changes, printable, say_how_to_keep
from hiltest.text import counted, number, readable, with_unit, without_folders
from hiltest.verdict.calibrators import WITH_WAITS, WITHOUT_WAITS
from hiltest.verdict.compare import changes_seen
from hiltest.verdict.summary import (
    CLOSE,
    MAY_EXCEED,
    Failure,
    Summary,
    cost_line,
    held_to,
    limit_in_words,
    summarise,
    unmeasured_in_words,
)
from hiltest.verdict.verdict import headline

_STYLES = {Outcome.FAIL: "bold red", Outcome.UNSET: "yellow", Outcome.CANNOT_TELL: "yellow", Outcome.NOT_OFFERED: "dim"}
_INDENT = "  "
_CHANGES_AT_MOST = 5
# Headings of columns whose numbers are far narrower.
_FOLDED = {
    WITHOUT_WAITS: "cycles without\nmemory waits\n(ranked)", WITH_WAITS: "cycles\nas it runs\nfrom flash",
}  # fmt: skip
CHANGE_SEEN = "smallest change that a comparison of such a run sees in 4 of 5 cases"
_WITHIN_NUMBER = re.compile(r"(?<=\d) (?=\d{3}\b)")
_NO_BREAK = "\N{NO-BREAK SPACE}"


def summary(
    run: Run, folder: Path, *, verbose: bool, width: int, colour: bool, options: str | None = None
) -> str:
    """Return what a reader wants first, at most a screen of it where everything passed.

    Parameters
    ----------
    folder
        Where its files are.
    verbose
        Whether to print every measurement, the uncertainty of every count, and the cost of the calibrators too.
    width
        Columns of the terminal.
    colour
        Whether it shows colours.
    options
        For ``hiltest run``, to run the same on other seeds.
    """
    text = StringIO()
    console = Console(
        file=text, width=width, force_terminal=colour, no_color=not colour, color_system="standard" if colour else None,
        highlight=False,
    )
    found = summarise(run)
    _wrapped(console, headline(run.verdict, found), "bold green" if run.verdict.exit_code == 0 else "bold red")
    _print_failures(console, found, run, folder)
    _print_calibrators(console, found)
    _print_close(console, found)
    if verbose:
        _print_everything(console, run)
    if run.comparison is not None:
        print_changes(console, run.comparison, at_most=None if verbose else _CHANGES_AT_MOST)
        say_how_to_keep(console, run.comparison, shown_path(folder), options)
    count = counted(len(run.measurements), "measurement")
    more = "" if verbose else f"; -v prints {'it' if len(run.measurements) == 1 else 'them'}"
    if run.coverage is not None:
        file = shown_path(Path(os.path.normpath(folder / run.coverage.file)))
        console.print(escape(f"{coverage_line(run.coverage)}: {file}"), soft_wrap=True)
    console.print(escape(f"Report: {shown_path(folder / REPORT_FILE)} ({count}{more})"), soft_wrap=True)
    return text.getvalue()


def coverage_line(coverage: CoverageRecord) -> str:
    """Return how much of the firmware was executed, in one line."""
    shares = (
        f"{hit} of {found} {what}{f' ({100 * hit / found:.1f} %)' if found else ''}" for (hit, found), what in (
            (coverage.lines, "lines"), (coverage.functions, "functions"), (coverage.branches, "branches both ways"),
        )
    )  # fmt: skip
    return f"Coverage: {', '.join(shares)}"


def shown_path(path: Path) -> str:
    """Return a path as one would type it here."""
    here = Path.cwd()
    return str(path.relative_to(here)) if path.is_relative_to(here) else str(path)


def shown_value(measurement: Measurement) -> str:
    """Return the value as every report shows it."""
    return number(measurement.value, measurement.unit)


def shown_limit(measurement: Measurement) -> str:
    """Return the limit as people read it; one in brackets is a reference value that is not enforced."""
    if measurement.limit is None and measurement.information is not None:
        return f"({measurement.information})"
    uncertainty = f", U {readable(measurement.uncertainty, 2)}" if measurement.limit and measurement.uncertainty else ""
    return f"{measurement.limit or ''}{uncertainty}"


def shown_seen(measurement: Measurement, seen: Mapping[str, float]) -> str:
    """Return the smallest change that a comparison sees, of what has a limit."""
    if measurement.limit is None or (change := seen.get(measurement.name)) is None:
        return ""
    return readable(change, 2) if change else "any"


def shown_outcome(measurement: Measurement) -> str:
    """Return the outcome as people read it; without a limit there is none."""
    if measurement.outcome is Outcome.INFORMATION:
        return ""
    if measurement.outcome is Outcome.UNSET:
        return "not measured" if measurement.value is None else "not evaluated"
    return f"{measurement.outcome}; {MAY_EXCEED}" if measurement.may_exceed_limit else str(measurement.outcome)


def failure_line(failure: Failure) -> str:
    """Return a failure in one line: value, limit, value in the baseline, and where it was measured."""
    each = failure.measurement
    value = each.note or "no value" if each.value is None else with_unit(each.value, each.unit)
    place = each.place or without_folders(each.test)
    note = f": {each.note}" if each.note and each.value is not None else ""
    return f"{each.name} {value}" + held_to(each, failure.was) + note + (f", {place}" if place else "")


def _wrapped(console: Console, text: str, style: str = "", indent: str = "") -> None:
    """Print a text folded at the terminal's width, numbers and names whole."""
    whole = _WITHIN_NUMBER.sub(_NO_BREAK, printable(text))
    for line in textwrap.wrap(
        whole, console.width, initial_indent=indent, subsequent_indent=indent and f"{indent}  ",
        break_long_words=False, break_on_hyphens=False,
    ):
        console.print(escape(line.replace(_NO_BREAK, " ")), style=style, soft_wrap=True)


def _print_failures(console: Console, found: Summary, run: Run, folder: Path) -> None:
    said: set[str] = set()
    for failure in found.failures:
        _wrapped(console, failure_line(failure), "red", _INDENT)
        if failure.cause and failure.cause not in said:
            _wrapped(console, f"likely cause: {failure.cause}", indent=2 * _INDENT)
        said.add(failure.cause)
    for reason, tests in by_reason(found.broken).items():
        _wrapped(console, f"{tests[0].outcome}: {tests_named(tests)}: {reason}", "red", _INDENT)
    for words in found.causes:
        if words not in said:
            _wrapped(console, f"likely cause: {words}", indent=2 * _INDENT)
    for measurement in found.unset:
        what = measurement.outcome if measurement.outcome is Outcome.CANNOT_TELL else "not evaluated"
        _wrapped(console, f"{what}: {measurement.name}: {measurement.note}", "yellow", _INDENT)
    if found.unmeasured:
        _wrapped(console, unmeasured_in_words(found.unmeasured), "yellow", _INDENT)
    for reason, tests in by_reason(each for each in run.tests if each.outcome.is_of_bench).items():
        why = "" if reason in run.verdict.sentence else f": {reason}"  # the first stands there
        _wrapped(console, f"{tests[0].outcome}: {tests_named(tests)}{why}", "red", _INDENT)
    if traces := {test.trace: test for test in run.tests if test.trace}:
        (trace, test), *more = traces.items()
        of = counted(len(traces), "test") if more else without_folders(test.id)
        where = folder / trace
        _wrapped(console, f"wire trace of {of}: {shown_path(where.parent if more else where)}", indent=_INDENT)
    for advice in found.advice:
        _wrapped(console, f"Next: {advice}")


def _grid() -> Grid:
    return Grid(box=None, pad_edge=False, padding=(0, 2, 0, 0), header_style="bold")


def _print_calibrators(console: Console, found: Summary) -> None:
    if not found.calibrators:
        return
    results = [calibrator.result for calibrator in found.calibrators]
    columns = [("worst \\[deg]", [shown_value(result.maximum) for result in results]),
               ("limit", [_most(result.maximum) for result in results])]
    if counted_cycles := any(result.cycles for result in results):
        columns += _costs(found)
    names = [result.name for result in results]
    wide = sum(_width(heading, cells) for heading, cells in [("calibrator", names), *columns]) > console.width
    grid = _grid()
    grid.add_column("calibrator" if counted_cycles else "heading", no_wrap=True)
    for heading, _ in columns:
        grid.add_column(heading.replace(" ", "\n") if wide else heading, justify="right", no_wrap=True)
    for each, *cells in zip(results, *(cells for _, cells in columns), strict=True):
        style = "red" if each.maximum.gates or (each.cycles and each.cycles.gates) else ""
        grid.add_row(escape(each.name), *cells, style=style)
    console.print()
    console.print(grid)


def _width(heading: str, cells: Sequence[str]) -> int:
    """Return how wide a column is, with what separates it from the next."""
    return 2 + max(map(len, [*heading.replace("\\", "").splitlines(), *cells]))


def _costs(found: Summary) -> list[tuple[str, list[str]]]:
    """Return headings and cells of cost; with and without the waits of memories each column says which."""
    results = [calibrator.result for calibrator in found.calibrators]
    counts = [result.cycles for result in results]
    cycles = [shown_value(count) if count else "" for count in counts]
    ranges = ("uncertainty range", [str(count.band or "") if count else "" for count in counts])
    limits = ("limit", [_most(count) for count in counts])
    waited = [shown_value(result.from_flash) if result.from_flash else "" for result in results]
    ratios = [(f"of {found.reference}", [each.ratio for each in found.calibrators])] if found.reference else []
    if not any(waited):
        return [("cycles", cycles), ranges, limits, *ratios]
    of_limits = [limits] if any(limits[1]) else []
    return [(_FOLDED[WITHOUT_WAITS], cycles), ranges, (_FOLDED[WITH_WAITS], waited), *of_limits, *ratios]


def _most(measurement: Measurement | None) -> str:
    most = measurement.limit.max if measurement and measurement.limit else None
    return "" if most is None else readable(most)


def _print_close(console: Console, found: Summary) -> None:
    if not found.close:
        return
    console.print()
    console.print(f"Close to the limit (within {100 * CLOSE:g} %, or within the model's uncertainty):", soft_wrap=True)
    for each in found.close:
        band = f" ({each.band})" if each.band else ""
        line = f"{each.name} {with_unit(each.value, each.unit)}{band}, {limit_in_words(each)}"
        _wrapped(console, line, "yellow", _INDENT)


def _print_everything(console: Console, run: Run) -> None:
    """Print every measurement, the uncertainty of every count, and what the calibrators cost."""
    console.print()
    console.print(_measurements(run.measurements))
    seen = changes_seen(run)
    limited = [each for each in run.measurements if each.limit and each.unit == "deg" and each.name in seen]
    print_smallest_changes(console, CHANGE_SEEN, {each.name: seen[each.name] for each in limited})
    for measurement in run.measurements:
        if measurement.note and not _is_why(measurement):
            _wrapped(console, f"{measurement.name} {shown_value(measurement)}: {measurement.note}")
    _print_ranges(console, run.measurements)
    if line := cost_line(run):
        _wrapped(console, line)


def _is_why(measurement: Measurement) -> bool:
    """Say whether the note is the reason of the outcome, and not a description of the number."""
    return measurement.outcome not in (Outcome.PASS, Outcome.INFORMATION)


def _measurements(measurements: Sequence[Measurement]) -> Grid:
    grid = _grid()
    grid.add_column("measurement", overflow="fold")
    grid.add_column("value", justify="right", no_wrap=True)
    grid.add_column("unit", no_wrap=True)
    grid.add_column("limit")
    grid.add_column("outcome", min_width=4)
    for measurement in measurements:
        # Remarks stand below: here they would leave the names no room.
        outcome = shown_outcome(measurement).partition(";")[0]
        outcome += f" ({measurement.note})" if measurement.note and _is_why(measurement) else ""
        grid.add_row(
            escape(measurement.name), shown_value(measurement), escape(measurement.unit), shown_limit(measurement),
            escape(outcome), style=_STYLES.get(measurement.outcome),
        )
    return grid


def _print_ranges(console: Console, measurements: Sequence[Measurement]) -> None:
    """Print counts beside their uncertainty ranges, and the row of the cycle model that contributes most."""
    ranged = [(measurement, measurement.band) for measurement in measurements if measurement.band]
    for model in dict.fromkeys(each.cycle_model for each, _ in ranged):
        console.print()
        _wrapped(console, f"Cycle-count uncertainty (model {model}; hiltest timing show has its rows):")
        grid = _grid()
        grid.add_column("measurement", overflow="fold")
        for name in ("cycles", "lowest", "highest"):
            grid.add_column(name, justify="right", no_wrap=True)
        grid.add_column("largest contributor", no_wrap=True)
        for each, band in ranged:
            if each.cycle_model == model:
                most = band.moved_most_by
                by = most.row if most else "memories" if band.low < band.high else "no row"
                if each.value and band.about_fetch:
                    by += f"; fetch {100 * band.about_fetch / each.value:.1f} %"
                grid.add_row(escape(each.name), shown_value(each), readable(band.low), readable(band.high), escape(by))
        console.print(grid)
