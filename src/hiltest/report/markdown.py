"""Render a run as Markdown, for a pull request or a job summary."""

from __future__ import annotations

from collections.abc import Iterable, Iterator

from hiltest.report import overview, stream_overview
from hiltest.report.comparison_overview import changed, counts, sides
from hiltest.report.figures.heading import failed_heading
from hiltest.report.markdown_text import folded, plain_text, table
from hiltest.report.terminal import CHANGE_SEEN, coverage_line, shown_limit, shown_outcome, shown_seen, shown_value
from hiltest.run_record.comparison import Comparison
from hiltest.run_record.exit_codes import ExitCode
from hiltest.run_record.outcomes import TestOutcome
from hiltest.run_record.run import Run, TestResult
from hiltest.text import number
from hiltest.verdict.compare import changes_seen
from hiltest.verdict.summary import Failure, Summary, cost_line, summarise
from hiltest.verdict.verdict import headline


def markdown_report(run: Run) -> str:
    """Return the page of a run; below the first lines and the changes, the rest is folded if the run is red."""
    return "\n".join(_lines(run)) + "\n"


def comparison_lines(
    comparison: Comparison, heading: str = "Against the baseline", *, fold: bool = False
) -> Iterator[str]:
    """Yield the lines of a comparison: its sentence, its obstacles, and all changes, which may be folded."""
    yield from ("", f"## {heading}", "", plain_text(comparison.sentence))
    if comparison.remark:
        yield from ("", plain_text(comparison.remark))
    if comparison.obstacles:
        yield ""
        yield from (f"- not evaluated: {plain_text(obstacle)}" for obstacle in comparison.obstacles)
    rows = [
        [row.change, row.name, row.base, row.new, row.moved, row.tolerance, row.limit, row.outcome]
        for row in changed(comparison)
    ]
    lines = table(["change", "measurement", "base", "new", "by", "tolerance", "limit", "outcome"], rows)
    if rows:
        yield from folded("Changes", lines) if fold else ("", *lines)
    yield from ("", f"{plain_text(counts(comparison))}.")
    both = ([*row] for row in sides(comparison))
    yield from folded("Compared runs", table(["", "base", "new"], both))


def _lines(run: Run) -> Iterator[str]:
    summary = summarise(run)
    first = headline(run, summary)
    yield f"# {plain_text(first.verdict)}"
    for line in first.lines[1:]:
        yield from ("", plain_text(line))
    if picture := failed_heading(run, summary):
        yield from picture.mermaid()
    is_red = run.verdict.exit_code != 0
    yield from _section("Failures", _failures(summary), fold=is_red)
    yield from _section("Tests that did not pass", _tests(run), fold=is_red)
    yield from _section("Accuracy and cost", _accuracy_and_cost(run), fold=is_red or run.comparison is not None)
    yield from _section("Close to the limit", _close(summary), fold=is_red)
    yield from ("", plain_text(overview.board_line(run)))
    if run.coverage is not None:
        yield from ("", plain_text(f"{coverage_line(run.coverage)}: {run.coverage.file}"))
    if run.comparison is not None:
        yield from comparison_lines(run.comparison, fold=run.verdict.exit_code == ExitCode.FAILED)
    stages = stream_overview.stream_stages(run)
    if stages:
        rows = ([*row] for row in stages)
        yield from folded(stream_overview.HEADING, table([*stream_overview.HEADINGS], rows))
    yield from folded("Every measurement", _measurements(run))
    yield from folded(
        "Basis of the numbers",
        (f"- {plain_text(name)}: {plain_text(text)}" for name, text in overview.provenance(run)),
    )


def _section(heading: str, lines: Iterable[str], *, fold: bool) -> Iterator[str]:
    """Yield lines below a heading, or folded; nothing without lines."""
    if whole := list(lines):
        yield from folded(heading, whole) if fold else ("", f"## {heading}", "", *whole)


def _failures(summary: Summary) -> Iterator[str]:
    rows = [
        [
            failure.measurement.name,
            shown_value(failure.measurement),
            failure.measurement.unit,
            shown_limit(failure.measurement),
            "" if failure.was is None else number(failure.was, failure.measurement.unit),
            summary.other_cause(failure) or failure.measurement.note,
            failure.measurement.place or failure.measurement.test,
        ]
        for failure in (*summary.failures, *(Failure(unset, None, "") for unset in summary.unset))
    ]
    if rows:
        heads = ["measurement", "value", "unit", "limit", "baseline", "another cause or remark", "measured at"]
        yield from table(heads, rows)
    for advice in summary.advice[1:]:
        yield from ("", plain_text(f"Then: {advice}"))


def _close(summary: Summary) -> Iterator[str]:
    if summary.close:
        rows = (
            [near.name, shown_value(near), near.unit, shown_limit(near), str(near.band or "")] for near in summary.close
        )
        yield from table(["measurement", "value", "unit", "limit", "uncertainty range"], rows)


def _accuracy_and_cost(run: Run) -> Iterator[str]:
    calibrators = overview.accuracy_and_cost(run)
    if not calibrators.rows:
        return
    yield from table(
        ["calibrator", *calibrators.headings],
        ([row.name, *(_cell_text(cell) for cell in row.cells)] for row in calibrators.rows),
    )
    if cost := cost_line(run):
        yield from ("", plain_text(cost))


def _tests(run: Run) -> Iterator[str]:
    troubled = [test for test in run.tests if test.outcome not in (TestOutcome.PASSED, TestOutcome.XFAILED)]
    if troubled:
        yield from table(["test", "outcome", "reason"], ([test.id, test.outcome, _reason(test)] for test in troubled))


def _reason(test: TestResult) -> str:
    return f"{test.reason} (wire trace: {test.trace})" if test.trace else test.reason


def _measurements(run: Run) -> Iterator[str]:
    detectable = changes_seen(run)
    rows = (
        [
            row.name,
            shown_value(row),
            row.unit,
            ", change ".join(filter(None, (shown_limit(row), shown_seen(row, detectable)))),
            shown_outcome(row),
            "; ".join(filter(None, (overview.origin(row), row.note))),
        ]
        for row in run.measurements
    )
    yield from table(["measurement", "value", "unit", "limit", "outcome", "where from, and notes"], rows)
    yield from ("", plain_text(f"Change: {CHANGE_SEEN}."))


def _cell_text(cell: overview.Cell) -> str:
    mark = {"fail": " FAIL", "unset": " not evaluated"}.get(cell.tone, "")
    return f"{cell.text}{mark}" + (f" ({cell.note})" if cell.note else "")
