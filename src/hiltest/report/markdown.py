"""Render a run as Markdown, for a pull request or a job summary."""

from __future__ import annotations

from collections.abc import Iterator

from hiltest.record.comparison import Comparison
from hiltest.record.outcomes import TestOutcome
from hiltest.record.run import Run, TestResult
from hiltest.report import overview, stream_overview
from hiltest.report.comparison_overview import changed, counts, sides
from hiltest.report.markdown_text import folded, plain_text, table
from hiltest.report.terminal import CHANGE_SEEN, coverage_line, shown_limit, shown_outcome, shown_seen, shown_value
from hiltest.text import number
from hiltest.verdict.compare import changes_seen
from hiltest.verdict.summary import Failure, Summary, cost_line, summarise


def markdown_report(run: Run) -> str:
    """Return the page of a run: verdict, what failed, the calibrators, what is close, what changed; the rest folded."""
    return "\n".join(_lines(run)) + "\n"


def comparison_lines(comparison: Comparison) -> Iterator[str]:
    """Yield the lines of a comparison: its sentence, its obstacles, and all changes."""
    yield from ("", "## Against the baseline", "", plain_text(comparison.sentence))
    if comparison.remark:
        yield from ("", plain_text(comparison.remark))
    if comparison.obstacles:
        yield ""
        yield from (f"- not evaluated: {plain_text(obstacle)}" for obstacle in comparison.obstacles)
    rows = [
        [each.change, each.name, each.base, each.new, each.moved, each.tolerance, each.limit, each.outcome]
        for each in changed(comparison)
    ]
    if rows:
        yield ""
        yield from table(["change", "measurement", "base", "new", "by", "tolerance", "limit", "outcome"], rows)
    yield from ("", f"{plain_text(counts(comparison))}.")
    both = ([*row] for row in sides(comparison))
    yield from folded("What was compared", table(["", "base", "new"], both))


def _lines(run: Run) -> Iterator[str]:
    yield f"# {plain_text(run.verdict.outcome.upper())}"
    found = summarise(run)
    yield from ("", plain_text(run.verdict.sentence))
    yield from _failures(found)
    yield from _tests(run)
    for advice in found.advice:
        yield from ("", plain_text(f"Next: {advice}"))
    yield from _accuracy_and_cost(run)
    yield from _close(found)
    yield from ("", plain_text(overview.board_line(run)))
    if run.coverage is not None:
        yield from ("", plain_text(f"{coverage_line(run.coverage)}: {run.coverage.file}"))
    if run.comparison is not None:
        yield from comparison_lines(run.comparison)
    stages = stream_overview.stream_stages(run)
    if stages:
        rows = ([*row] for row in stages)
        yield from folded(stream_overview.HEADING, table([*stream_overview.HEADINGS], rows))
    yield from folded("Every measurement", _measurements(run))
    yield from folded(
        "What the numbers rest on",
        (f"- {plain_text(name)}: {plain_text(text)}" for name, text in overview.provenance(run)),
    )


def _failures(found: Summary) -> Iterator[str]:
    rows = [
        [each.measurement.name, shown_value(each.measurement), each.measurement.unit, shown_limit(each.measurement),
         "" if each.was is None else number(each.was, each.measurement.unit), each.cause or each.measurement.note,
         each.measurement.place or each.measurement.test]
        for each in (*found.failures, *(Failure(unset, None, "") for unset in found.unset))
    ]
    if rows:
        yield from ("", "## Failures", "")
        heads = ["measurement", "value", "unit", "limit", "baseline", "likely cause, or why", "measured at"]
        yield from table(heads, rows)


def _close(found: Summary) -> Iterator[str]:
    if found.close:
        yield from ("", "## Close to the limit", "")
        rows = (
            [each.name, shown_value(each), each.unit, shown_limit(each), str(each.band or "")] for each in found.close
        )
        yield from table(["measurement", "value", "unit", "limit", "uncertainty range"], rows)


def _accuracy_and_cost(run: Run) -> Iterator[str]:
    calibrators = overview.accuracy_and_cost(run)
    if not calibrators.rows:
        return
    lines = table(
        ["calibrator", *calibrators.headings],
        ([row.name, *(_marked(cell) for cell in row.cells)] for row in calibrators.rows),
    )
    if run.comparison is None:
        yield from ("", "## Accuracy and cost", "", *lines)
        if cost := cost_line(run):
            yield from ("", plain_text(cost))
    else:
        yield from folded("Accuracy and cost", [*lines, "", plain_text(cost_line(run))])


def _tests(run: Run) -> Iterator[str]:
    troubled = [test for test in run.tests if test.outcome not in (TestOutcome.PASSED, TestOutcome.XFAILED)]
    if troubled:
        yield from ("", "## Tests that did not pass", "")
        yield from table(["test", "outcome", "reason"], ([test.id, test.outcome, _reason(test)] for test in troubled))


def _reason(test: TestResult) -> str:
    return f"{test.reason} (wire trace: {test.trace})" if test.trace else test.reason


def _measurements(run: Run) -> Iterator[str]:
    seen = changes_seen(run)
    rows = (
        [each.name, shown_value(each), each.unit,
         ", change ".join(filter(None, (shown_limit(each), shown_seen(each, seen)))),
         shown_outcome(each) + (f": {each.note}" if each.note else ""), overview.origin(each)]
        for each in run.measurements
    )
    yield from table(["measurement", "value", "unit", "limit", "outcome", "where from"], rows)
    yield from ("", plain_text(f"Change: {CHANGE_SEEN}."))


def _marked(cell: overview.Cell) -> str:
    mark = {"fail": " FAIL", "unset": " not evaluated"}.get(cell.tone, "")
    return f"{cell.text}{mark}" + (f" ({cell.note})" if cell.note else "")
