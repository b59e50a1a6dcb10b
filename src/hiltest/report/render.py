"""Writer of all reports of a run: the page begins with the verdict."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

from hiltest import __version__
from hiltest.report import overview, stream_overview
from hiltest.report.comparison_overview import against_baseline
from hiltest.report.figures.cost import budget_group, cost_group
from hiltest.report.figures.fusion import fusion_group
from hiltest.report.figures.heading import failed_heading, heading_group
from hiltest.report.figures.inertial import accelerometer_group, gyroscope_group
from hiltest.report.figures.samples import samples_group
from hiltest.report.markdown import markdown_report
from hiltest.report.page import badge_of, render
from hiltest.report.terminal import (
    CHANGE_SEEN,
    INCOMPLETE,
    coverage_line,
    is_incomplete,
    shown_limit,
    shown_outcome,
    shown_seen,
    shown_value,
)
from hiltest.run_record.files import MARKDOWN_FILE, REPORT_FILE, write_atomically
from hiltest.run_record.outcomes import RED, TestOutcome
from hiltest.run_record.run import Run, TestResult, Verdict
from hiltest.text import format_with_unit, number
from hiltest.verdict.compare import changes_seen
from hiltest.verdict.summary import Failure, Summary, cost_line, expected_line, summarise
from hiltest.verdict.verdict import headline

# Sign and spoken words beside a limit, by the class of the cell.
_PASSED = (TestOutcome.PASSED, TestOutcome.XFAILED, TestOutcome.SKIPPED)
_SIGNS = {"pass": ("✓", "within its limit:"), "fail": ("✗", "beyond its limit:"), "unset": ("?", "not evaluated:")}
# Sections that are figures, in order; those without data are omitted.
_FIGURES = (budget_group, samples_group, accelerometer_group, gyroscope_group, fusion_group)


@dataclass(frozen=True, slots=True)
class Reported:
    """Reports that were written again."""

    folder: str
    """Folder of the reports."""
    files: list[str]
    """Names of the reports."""
    verdict: Verdict
    """Verdict of the run."""


def write_reports(run: Run, folder: Path) -> str:
    """Write ``report.html`` and ``report.md`` beside ``run.json``; return the text of ``report.md``."""
    write_atomically(folder / REPORT_FILE, html_report(run))
    page = markdown_report(run)
    write_atomically(folder / MARKDOWN_FILE, page)
    return page


def html_report(run: Run) -> str:
    """Return the page of a run."""
    summary = summarise(run)
    picture = failed_heading(run, summary)
    groups = [heading_group(run, drawn=picture.name if picture else ""), *(section(run) for section in _FIGURES)]
    listed = [*summary.failures, *(Failure(unset, None, "") for unset in summary.unset)]
    return render(
        "report.html.j2",
        run=run,
        version=__version__,
        badge=badge_of(run.verdict.outcome),
        tally=overview.tally(run),
        board_line=overview.board_line(run),
        coverage_line=coverage_line(run.coverage) if run.coverage else "",
        baseline=against_baseline(run.comparison),
        title=_title(run),
        incomplete=INCOMPLETE if is_incomplete(run) else "",
        summary=summary,
        gating=[(failure, summary.other_cause(failure) or failure.measurement.note) for failure in listed],
        troubled=_troubled_tests(run, summary),
        calibrators=overview.accuracy_and_cost(run),
        cost_line=cost_line(run),
        expected_line=expected_line(run),
        cost_figures=cost_group(run),
        first=headline(run, summary),
        picture=picture and picture.figure,
        figure_groups=[group for group in groups if group],
        signs=_SIGNS,
        streams=stream_overview,
        stream_stages=stream_overview.stream_stages(run),
        groups=overview.groups(run),
        provenance=list(overview.provenance(run)),
        value=shown_value,
        limit=shown_limit,
        outcome=shown_outcome,
        tone=overview.tone,
        origin=overview.origin,
        number=number,
        format_with_unit=format_with_unit,
        change=shown_seen,
        seen=changes_seen(run),
        change_seen=CHANGE_SEEN,
    )


def _troubled_tests(run: Run, summary: Summary) -> list[TestResult]:
    """Return the tests that did not pass, except those that only failed the measurements listed above them."""
    explained = [test for test in run.tests if test.outcome in RED and test not in summary.broken]
    return [test for test in run.tests if test.outcome not in _PASSED and (test.trace or test not in explained)]


def _title(run: Run) -> str:
    """Return the title of the run, for the tab of a browser and the heading."""
    board = run.board.description if run.board else "no board"
    return f"hiltest report: {board}{f', rig {run.rig.name}' if run.rig else ''}"
