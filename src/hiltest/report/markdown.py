"""Render a run as Markdown, for a pull request or a job summary."""

from __future__ import annotations

import re
from collections.abc import Iterable, Iterator

from hiltest.measurement import Measurement
from hiltest.report import overview, stream_overview
from hiltest.report.record import Run, TestResult
from hiltest.report.terminal import shown_limit, shown_outcome, shown_value

_SPECIAL = re.compile(r"([\\`*_{}\[\]<>#|~&])")


def markdown_report(run: Run) -> str:
    """Return the page of a run: verdict, accuracy and cost, what was out of order, the rest folded."""
    return "\n".join(_lines(run)) + "\n"


def plain_text(text: str) -> str:
    """Return text that Markdown shows as it is, on one line.

    Examples
    --------
    >>> plain_text("<script>|")
    '\\\\<script\\\\>\\\\|'
    """
    return _SPECIAL.sub(r"\\\1", " ".join(text.split()))


def _lines(run: Run) -> Iterator[str]:
    yield f"# {plain_text(run.verdict.outcome.upper())}"
    yield ""
    yield plain_text(run.verdict.sentence)
    yield ""
    yield plain_text(overview.board_line(run))
    calibrators = overview.accuracy_and_cost(run)
    if calibrators.rows:
        yield ""
        yield from _table(
            ["calibrator", *calibrators.headings],
            ([row.name, *(_marked(cell) for cell in row.cells)] for row in calibrators.rows),
        )
    gating = [each for each in run.measurements if each.gates]
    if gating:
        yield from ("", "## Out of order", "")
        yield from _measurements(gating)
    yield from _tests(run)
    yield from _streams(run)
    yield from ("", "<details><summary>Every measurement</summary>", "")
    yield from _measurements(run.measurements)
    yield from ("", "</details>", "", "<details><summary>What the numbers rest on</summary>", "")
    yield from (f"- {plain_text(name)}: {plain_text(text)}" for name, text in overview.provenance(run))
    yield from ("", "</details>")


def _streams(run: Run) -> Iterator[str]:
    stages = stream_overview.stream_stages(run)
    if stages:
        yield from ("", f"<details><summary>{stream_overview.HEADING}</summary>", "")
        yield from _table([*stream_overview.HEADINGS], ([*row] for row in stages))
        yield from ("", "</details>")


def _tests(run: Run) -> Iterator[str]:
    troubled = [test for test in run.tests if test.outcome not in ("passed", "xfailed")]
    if troubled:
        yield from ("", "## Tests that did not pass", "")
        yield from _table(["test", "outcome", "reason"], ([test.id, test.outcome, _reason(test)] for test in troubled))


def _reason(test: TestResult) -> str:
    return f"{test.reason} (wire trace: {test.trace})" if test.trace else test.reason


def _measurements(measurements: Iterable[Measurement]) -> Iterator[str]:
    rows = (
        [each.name, shown_value(each), each.unit, shown_limit(each),
         shown_outcome(each) + (f": {each.note}" if each.note else ""), overview.origin(each)]
        for each in measurements
    )
    yield from _table(["measurement", "value", "unit", "limit", "outcome", "where from"], rows)


def _table(headings: list[str], rows: Iterable[list[str]]) -> Iterator[str]:
    yield f"| {' | '.join(headings)} |"
    yield f"|{' --- |' * len(headings)}"
    for row in rows:
        yield f"| {' | '.join(plain_text(cell) for cell in row)} |"


def _marked(cell: overview.Cell) -> str:
    mark = {"fail": " FAIL", "unset": " not judged"}.get(cell.tone, "")
    return f"{cell.text}{mark}"
