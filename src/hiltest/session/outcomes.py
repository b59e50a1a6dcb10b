"""From pytest's three reports a test to one result, and to one more for each attempt that was not the last."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace

import pytest

from hiltest.report.record import TestResult
from hiltest.session.found import CAUSE, REASON, TRACE

RERUN = "rerun"
"""What pytest-rerunfailures calls a report of an attempt that it follows with another."""


class TestLog:
    """Reports of the tests that are running now.

    Parameters
    ----------
    test_id : callable
        Makes of pytest's node id the id that the record keeps.
    """

    __test__ = False  # not a test class, whatever pytest makes of the name

    def __init__(self, test_id: Callable[[str], str] = str) -> None:
        self._test_id = test_id
        self._attempts: dict[str, list[list[pytest.TestReport]]] = {}

    def add(self, report: pytest.TestReport) -> None:
        """Take the report of one phase; another set-up of the same test begins another attempt."""
        attempts = self._attempts.setdefault(report.nodeid, [])
        if report.when == "setup" or not attempts:
            attempts.append([])
        attempts[-1].append(report)

    def finish(self, nodeid: str) -> list[TestResult]:
        """Return a result for each attempt of a test, the last being the test's own; none if it never ran."""
        results = [self._result(nodeid, reports) for reports in self._attempts.pop(nodeid, [])]
        return [*(replace(each, outcome=RERUN) for each in results[:-1]), *results[-1:]]

    def _result(self, nodeid: str, reports: Sequence[pytest.TestReport]) -> TestResult:
        worst = max(reports, key=_badness)
        return TestResult(
            id=self._test_id(nodeid), outcome=_outcome(worst),
            duration_s=round(sum(report.duration for report in reports), 6), reason=_reason(worst),
            trace=next((getattr(each, TRACE) for each in reports if hasattr(each, TRACE)), ""),
        )


def _outcome(report: pytest.TestReport) -> str:
    if report.outcome == RERUN:
        return RERUN
    cause = getattr(report, CAUSE, "")
    if cause:
        return str(cause)
    if hasattr(report, "wasxfail"):
        return "xfailed" if report.skipped else "xpassed"
    if report.failed:
        return "failed" if report.when == "call" else "error"
    return report.outcome


def _badness(report: pytest.TestReport) -> tuple[bool, bool, bool]:
    # Of several failures the first phase counts: max() keeps the first of equals.
    return (report.failed or report.outcome == RERUN, report.skipped, report.when == "call")


def _reason(report: pytest.TestReport) -> str:
    """Return one line saying why a test did not pass."""
    if report.passed:
        return ""
    if hasattr(report, REASON):
        return str(getattr(report, REASON))
    if report.skipped and isinstance(report.longrepr, tuple):
        return str(report.longrepr[2]).removeprefix("Skipped: ")
    crash = getattr(report.longrepr, "reprcrash", None)
    text = str(crash.message if crash else report.longrepr)
    lines = text.strip().splitlines()
    return lines[0] if lines else ""
