"""Output at the end of a session: verdict, failures, calibrators, close limits, and the files."""

from __future__ import annotations

import os
from collections.abc import Mapping, Sequence
from io import StringIO
from pathlib import Path

from rich.console import Console
from rich.markup import escape
from rich.table import Table as Grid

from hiltest.errors import LIKELY_CAUSE
from hiltest.measurement import Measurement, Outcome
from hiltest.report.comparison_text import print_changes, print_smallest_changes, print_wrapped, say_how_to_keep
from hiltest.run_record.exit_codes import ExitCode
from hiltest.run_record.failures import group_by_reason, tests_named
from hiltest.run_record.files import REPORT_FILE
from hiltest.run_record.run import CoverageRecord, Run
from hiltest.text import format_count, format_number, format_with_unit, number, short_test_id
from hiltest.verdict.calibrators import AS_READ, WITH_WAITS, WITHOUT_WAITS, WORSE_THAN_NONE, is_worse_than_none
from hiltest.verdict.compare import changes_seen
from hiltest.verdict.summary import (
    CLOSE,
    MAY_EXCEED,
    Failure,
    Summary,
    cost_line,
    expected_line,
    limit_in_words,
    summarise,
    unmeasured_in_words,
)
from hiltest.verdict.verdict import failure_in_words, headline, worst_failure

_STYLES = {Outcome.FAIL: "bold red", Outcome.UNSET: "yellow", Outcome.CANNOT_TELL: "yellow", Outcome.NOT_OFFERED: "dim"}
_INDENT = "  "
_CHANGES_AT_MOST = 5
_FAILURES_AT_MOST = 2
# Folded headings of columns whose numbers are much narrower.
_FOLDED = {
    WITHOUT_WAITS: "cycles without\nmemory waits\n(ranked)",
    WITH_WAITS: "cycles\nas it runs\nfrom flash",
}
INCOMPLETE = "This run is not complete: it was cut short, or tests were left out. Missing measurements were not taken."
CHANGE_SEEN = "smallest change that a comparison of such a run detects in 4 of 5 cases"


def summary(run: Run, folder: Path, *, verbose: bool, width: int, colour: bool, options: str | None = None) -> str:
    """Return the most important results, at most a screen of them if everything passed.

    Parameters
    ----------
    folder
        Folder of the run's files.
    verbose
        True if to print every measurement, the uncertainty of every count, and the cost of the calibrators, too.
    width
        Columns of the terminal.
    colour
        True if the terminal shows colours.
    options
        Options for ``hiltest run`` to run the same on other seeds.
    """
    text = StringIO()
    console = Console(
        file=text,
        width=width,
        force_terminal=colour,
        no_color=not colour,
        color_system="standard" if colour else None,
        highlight=False,
    )
    run_summary = summarise(run)
    _print_headline(console, run, run_summary)
    _print_failures(console, run_summary, run, folder, verbose=verbose)
    _print_calibrators(console, run_summary, expected_line(run))
    _print_close(console, run_summary)
    if verbose:
        _print_everything(console, run)
    if run.comparison is not None:
        sentence = "" if run.verdict.exit_code == ExitCode.FAILED else run.verdict.sentence
        print_changes(console, run.comparison, sentence=sentence, at_most=None if verbose else _CHANGES_AT_MOST)
        say_how_to_keep(console, run.comparison, shown_path(folder), options)
    count = format_count(len(run.measurements), "measurement")
    more = "" if verbose else f"; -v prints {'it' if len(run.measurements) == 1 else 'them'}"
    if run.coverage is not None:
        file = shown_path(Path(os.path.normpath(folder / run.coverage.file)))
        console.print(escape(f"{coverage_line(run.coverage)}: {file}"), soft_wrap=True)
    console.print(escape(f"Report: {shown_path(folder / REPORT_FILE)} ({count}{more})"), soft_wrap=True)
    return text.getvalue()


def is_incomplete(run: Run) -> bool:
    """Return whether measurements may be missing, because the run was cut short or tests were left out."""
    return not run.verdict.complete or run.chosen


def coverage_line(coverage: CoverageRecord) -> str:
    """Return the executed share of the firmware, in one line."""
    shares = (
        f"{hit} of {count} {name}{f' ({100 * hit / count:.1f} %)' if count else ''}"
        for (hit, count), name in (
            (coverage.lines, "lines"),
            (coverage.functions, "functions"),
            (coverage.branches, "branches both ways"),
        )
    )
    return f"Coverage: {', '.join(shares)}"


def shown_path(path: Path) -> str:
    """Return a path relative to the current folder if it is inside."""
    folder = Path.cwd()
    return str(path.relative_to(folder)) if path.is_relative_to(folder) else str(path)


def shown_value(measurement: Measurement) -> str:
    """Return the value as every report shows it."""
    return number(measurement.value, measurement.unit)


def shown_limit(measurement: Measurement) -> str:
    """Return the limit as text; one in brackets is a reference value that is not enforced."""
    if measurement.limit is None and measurement.information is not None:
        return f"({measurement.information})"
    uncertainty = ""
    if measurement.limit and measurement.uncertainty:
        uncertainty = f", U {format_number(measurement.uncertainty, 2)}"
    return f"{measurement.limit or ''}{uncertainty}"


def shown_seen(measurement: Measurement, detectable: Mapping[str, float]) -> str:
    """Return the smallest change that a comparison detects, for a measurement with a limit."""
    if measurement.limit is None or (change := detectable.get(measurement.name)) is None:
        return ""
    return format_number(change, 2) if change else "any"


def shown_outcome(measurement: Measurement) -> str:
    """Return the outcome as text; it is empty without a limit."""
    if measurement.outcome is Outcome.INFORMATION:
        return ""
    if measurement.outcome is Outcome.UNSET:
        return "not measured" if measurement.value is None else "not evaluated"
    return f"{measurement.outcome}; {MAY_EXCEED}" if measurement.may_exceed_limit else str(measurement.outcome)


def _print_headline(console: Console, run: Run, summary_of_run: Summary) -> None:
    lines = headline(run, summary_of_run).lines
    if run.verdict.exit_code not in (ExitCode.FAILED, ExitCode.REGRESSION):
        lines = [run.verdict.sentence, *lines[2:]]
    print_wrapped(console, lines[0], "bold red" if run.verdict.exit_code else "bold green")
    for line in lines[1:]:
        print_wrapped(console, line, indent=_INDENT)


def _print_failures(console: Console, summary_of_run: Summary, run: Run, folder: Path, *, verbose: bool) -> None:
    """Print the failures below the headline, which names the first: a few of each kind, or all."""
    first = worst_failure(summary_of_run) if summary_of_run.failures else None
    failures = [
        LIKELY_CAUSE.join(filter(None, (failure_in_words(failure), summary_of_run.other_cause(failure))))
        for failure in summary_of_run.failures
        if failure is not first
    ]
    groups = list(group_by_reason(summary_of_run.broken).items())
    tests = [f"{tests[0].outcome}: {tests_named(tests)}: {reason}" for reason, tests in groups[first is None :]]
    unset = [
        f"cannot tell: {failure_in_words(Failure(measurement, None, ''))}"
        if measurement.outcome is Outcome.CANNOT_TELL
        else f"not evaluated: {measurement.name}: {measurement.note}"
        for measurement in summary_of_run.unset
    ]
    for lines, style in ((failures, "red"), (tests, "red"), (unset, "yellow")):
        most = len(lines) if verbose else _FAILURES_AT_MOST
        for line in lines[:most]:
            print_wrapped(console, line, style, _INDENT)
        if more := len(lines[most:]):
            print_wrapped(console, f"and {more} more in the report", style, _INDENT)
    if summary_of_run.unmeasured:
        print_wrapped(console, unmeasured_in_words(summary_of_run.unmeasured), "yellow", _INDENT)
    for reason, tests_of_bench in group_by_reason(test for test in run.tests if test.outcome.is_of_bench).items():
        why = "" if reason in run.verdict.sentence else f": {reason}"  # the sentence contains the first reason
        line = f"{tests_of_bench[0].outcome}: {tests_named(tests_of_bench)}{why}"
        print_wrapped(console, line, "red", _INDENT)
    if traces := {test.trace: test for test in run.tests if test.trace}:
        (trace, test), *more_traces = traces.items()
        tests_traced = format_count(len(traces), "test") if more_traces else short_test_id(test.id)
        file = shown_path((folder / trace).parent if more_traces else folder / trace)
        print_wrapped(console, f"wire trace of {tests_traced}: {file}", indent=_INDENT)
    if run.verdict.exit_code and is_incomplete(run):
        print_wrapped(console, INCOMPLETE, "yellow", _INDENT)
    for advice in summary_of_run.advice[1:] if verbose else ():
        print_wrapped(console, f"Then: {advice}", indent=_INDENT)


def _grid() -> Grid:
    return Grid(box=None, pad_edge=False, padding=(0, 2, 0, 0), header_style="bold")


def _print_calibrators(console: Console, summary_of_run: Summary, expected: str) -> None:
    if not summary_of_run.calibrators:
        return
    results = [calibrator.result for calibrator in summary_of_run.calibrators]
    columns = [
        ("worst \\[deg]", [shown_value(result.maximum) for result in results]),
        ("limit", [_upper_limit(result.maximum) for result in results]),
    ]
    if counted_cycles := any(result.cycles for result in results):
        columns += _costs(summary_of_run)
    names = [result.name for result in results]
    wide = sum(_width(heading, cells) for heading, cells in [("calibrator", names), *columns]) > console.width
    grid = _grid()
    grid.add_column("calibrator" if counted_cycles else "heading", no_wrap=True)
    for heading, _ in columns:
        grid.add_column(heading.replace(" ", "\n") if wide else heading, justify="right", no_wrap=True)
    for result, *cells in zip(results, *(cells for _, cells in columns), strict=True):
        style = "red" if result.maximum.gates or (result.cycles and result.cycles.gates) else ""
        grid.add_row(escape(result.name), *cells, style=style)
    as_read = summary_of_run.as_read
    if as_read is not None:
        grid.add_row(AS_READ, shown_value(as_read))
    console.print()
    console.print(grid)
    worse = [result.name for result in results if is_worse_than_none(result.maximum, as_read)]
    if worse:
        print_wrapped(console, f"{', '.join(worse)}: {WORSE_THAN_NONE}.", "red")
    if expected:
        print_wrapped(console, expected)


def _width(heading: str, cells: Sequence[str]) -> int:
    """Return the width of a column, including the gap to the next."""
    return 2 + max(map(len, [*heading.replace("\\", "").splitlines(), *cells]))


def _costs(summary_of_run: Summary) -> list[tuple[str, list[str]]]:
    """Return headings and cells of cost; headings name the waits of memories if counts with and without exist."""
    results = [calibrator.result for calibrator in summary_of_run.calibrators]
    counts = [result.cycles for result in results]
    cycles = [shown_value(count) if count else "" for count in counts]
    ranges = ("uncertainty range", [str(count.band or "") if count else "" for count in counts])
    limits = ("limit", [_upper_limit(count) for count in counts])
    waited = [shown_value(result.from_flash) if result.from_flash else "" for result in results]
    ratios = (
        [(f"of {summary_of_run.reference}", [calibrator.ratio for calibrator in summary_of_run.calibrators])]
        if summary_of_run.reference
        else []
    )
    if not any(waited):
        return [("cycles", cycles), ranges, limits, *ratios]
    of_limits = [limits] if any(limits[1]) else []
    return [(_FOLDED[WITHOUT_WAITS], cycles), ranges, (_FOLDED[WITH_WAITS], waited), *of_limits, *ratios]


def _upper_limit(measurement: Measurement | None) -> str:
    most = measurement.limit.max if measurement and measurement.limit else None
    return "" if most is None else format_number(most)


def _print_close(console: Console, summary_of_run: Summary) -> None:
    if not summary_of_run.close:
        return
    console.print()
    console.print(f"Close to the limit (within {100 * CLOSE:g} %, or within the model's uncertainty):", soft_wrap=True)
    for measurement in summary_of_run.close:
        band = f" ({measurement.band})" if measurement.band else ""
        value = format_with_unit(measurement.value, measurement.unit)
        line = f"{measurement.name} {value}{band}, {limit_in_words(measurement)}"
        print_wrapped(console, line, "yellow", _INDENT)


def _print_everything(console: Console, run: Run) -> None:
    """Print every measurement, the uncertainty of every count, and the cost of the calibrators."""
    console.print()
    console.print(_measurements(run.measurements))
    detectable = changes_seen(run)
    limited = [
        measurement
        for measurement in run.measurements
        if measurement.limit and measurement.unit == "deg" and measurement.name in detectable
    ]
    print_smallest_changes(
        console, CHANGE_SEEN, {measurement.name: detectable[measurement.name] for measurement in limited}
    )
    for measurement in run.measurements:
        if measurement.note and not _note_explains_outcome(measurement):
            print_wrapped(console, f"{measurement.name} {shown_value(measurement)}: {measurement.note}")
    _print_ranges(console, run.measurements)
    if line := cost_line(run):
        print_wrapped(console, line)


def _note_explains_outcome(measurement: Measurement) -> bool:
    """Return whether the note explains the outcome, instead of describing the number."""
    return measurement.outcome not in (Outcome.PASS, Outcome.INFORMATION)


def _measurements(measurements: Sequence[Measurement]) -> Grid:
    grid = _grid()
    grid.add_column("measurement", overflow="fold")
    grid.add_column("value", justify="right", no_wrap=True)
    grid.add_column("unit", no_wrap=True)
    grid.add_column("limit")
    grid.add_column("outcome", min_width=4)
    for measurement in measurements:
        # Remarks follow below, since they would leave the names no room.
        outcome = shown_outcome(measurement).partition(";")[0]
        outcome += f" ({measurement.note})" if measurement.note and _note_explains_outcome(measurement) else ""
        grid.add_row(
            escape(measurement.name),
            shown_value(measurement),
            escape(measurement.unit),
            shown_limit(measurement),
            escape(outcome),
            style=_STYLES.get(measurement.outcome),
        )
    return grid


def _print_ranges(console: Console, measurements: Sequence[Measurement]) -> None:
    """Print counts beside their uncertainty ranges, and the row of the cycle model that contributes most."""
    ranged = [(measurement, measurement.band) for measurement in measurements if measurement.band]
    for model in dict.fromkeys(measurement.cycle_model for measurement, _ in ranged):
        console.print()
        print_wrapped(console, f"Cycle-count uncertainty (model {model}; hiltest timing show has its rows):")
        grid = _grid()
        grid.add_column("measurement", overflow="fold")
        for name in ("cycles", "lowest", "highest"):
            grid.add_column(name, justify="right", no_wrap=True)
        grid.add_column("largest contributor", no_wrap=True)
        for measurement, band in ranged:
            if measurement.cycle_model == model:
                most = band.moved_most_by
                by = most.row if most else "memories" if band.low < band.high else "no row"
                if measurement.value and band.about_fetch:
                    by += f"; fetch {100 * band.about_fetch / measurement.value:.1f} %"
                grid.add_row(
                    escape(measurement.name),
                    shown_value(measurement),
                    format_number(band.low),
                    format_number(band.high),
                    escape(by),
                )
        console.print(grid)
