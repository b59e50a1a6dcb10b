"""Findings of a test, and their way to the record: on the item while the test runs, then on its reports."""

from __future__ import annotations

import json
from collections.abc import Callable, Mapping, Sequence
from dataclasses import asdict, replace
from typing import TYPE_CHECKING, Any

import pytest

from hiltest.run_record.outcomes import TestOutcome

if TYPE_CHECKING:
    from _typeshed import DataclassInstance

    from hiltest.measurement import Measurement
    from hiltest.run_record.run import Table, TestResult

_NAMED_AT_MOST = 3

# Attributes of a report. They are plain data, except FOUND_HERE, which a worker sends in the form that `pack` returns.
CAUSE = "hil_cause"
"""Outcome of a test that the bench or the firmware ended."""
REASON = "hil_reason"
"""Fault of the bench or the firmware, in one line."""
TRACE = "hil_trace"
"""The wire trace of a failed test, relative to the run's folder."""
OUT_OF_LIMIT = "hil_out_of_limit"
"""Names of the measurements that failed a test, if nothing else failed it."""
WIRE_TRACE = "wire trace"
"""Section of a report with the path of its trace."""
FOUND_HERE = "hil_found"
"""Measurements and tables of one phase of a test."""
BENCH = "hil_bench"
"""Bench of a worker: presence of a rig, the board that answered, and its seed."""


class TestFindings:
    """Measurements and tables of one test since its last report."""

    __slots__ = ("measurements", "tables")

    def __init__(self, measurements: Sequence[Measurement] = (), tables: Sequence[Table] = ()) -> None:
        self.measurements = list(measurements)
        self.tables = list(tables)


FOUND: pytest.StashKey[TestFindings] = pytest.StashKey()
FOUND_AT_ITS_END: pytest.StashKey[TestFindings] = pytest.StashKey()
"""Findings that the report of a tear-down already contains."""
GATING: pytest.StashKey[list[Measurement]] = pytest.StashKey()
FAILED_LIMITS: pytest.StashKey[list[str]] = pytest.StashKey()
"""Names of the measurements that failed the test in this phase."""


def carry_over(item: pytest.Item) -> None:
    """Add the measurements of the previous attempt's tear-down again at the set-up of the next attempt.

    pytest-rerunfailures before 16 drops reports that follow a failed one.
    """
    before = item.stash.get(FOUND_AT_ITS_END, None)
    if before is not None:
        item.stash.setdefault(FOUND, TestFindings()).measurements.extend(before.measurements)


def pack(findings: TestFindings) -> dict[str, Any]:
    """Return findings as plain data that can leave the process, without enums and numpy's numbers."""
    return {
        "measurements": [plain_data(measurement.rounded()) for measurement in findings.measurements],
        "tables": [plain_data(table.rounded()) for table in findings.tables],
    }


def unpack(content: Mapping[str, Any]) -> TestFindings:
    """Return the findings from the result of `pack`."""
    from hiltest.measurement import Measurement
    from hiltest.run_record.run import Table
    from hiltest.run_record.run_json import part_from

    return TestFindings(
        [part_from(Measurement, part) for part in content["measurements"]],
        [part_from(Table, part) for part in content["tables"]],
    )


def plain_data(record: DataclassInstance) -> dict[str, Any]:
    """Return the same as `asdict` for a part of the record, with types of JSON only."""
    plain: dict[str, Any] = json.loads(json.dumps(asdict(record)))
    return plain


def properties_of(measurement: Measurement) -> list[tuple[str, object]]:
    """Return the properties of a measurement in junit.xml."""
    name = f"hil.{measurement.name}"
    shown = measurement.rounded()
    properties: list[tuple[str, object]] = [
        (name, "" if shown.value is None else shown.value),
        (f"{name}.unit", shown.unit),
        (f"{name}.outcome", str(shown.outcome)),
    ]
    if shown.limit is not None:
        properties.append((f"{name}.limit", str(shown.limit)))
    if shown.cycle_model:
        properties.append((f"{name}.cycle_model", shown.cycle_model))
    return properties


class TestLog:
    """Reports of the tests that are running now.

    Parameters
    ----------
    test_id
        Function that returns the id in the record for pytest's node id.
    """

    __test__ = False  # pytest takes the class for a test class because of its name

    def __init__(self, test_id: Callable[[str], str] = str) -> None:
        self._test_id = test_id
        self._attempts: dict[str, list[list[pytest.TestReport]]] = {}

    def add(self, report: pytest.TestReport) -> None:
        """Add the report of one phase; another set-up of the same test begins another attempt."""
        attempts = self._attempts.setdefault(report.nodeid, [])
        if report.when == "setup" or not attempts:
            attempts.append([])
        attempts[-1].append(report)

    def finish(self, nodeid: str) -> list[TestResult]:
        """Return a result for each attempt of a test, of which the last counts; empty if the test never ran."""
        results = [self._result(nodeid, reports) for reports in self._attempts.pop(nodeid, [])]
        return [*(replace(result, outcome=TestOutcome.RERUN) for result in results[:-1]), *results[-1:]]

    def _result(self, nodeid: str, reports: Sequence[pytest.TestReport]) -> TestResult:
        from hiltest.run_record.run import TestResult

        worst = max(reports, key=_badness)
        return TestResult(
            id=self._test_id(nodeid),
            outcome=_outcome(worst),
            duration_s=round(sum(report.duration for report in reports), 6),
            reason=_reason(worst),
            trace=next((getattr(report, TRACE) for report in reports if hasattr(report, TRACE)), ""),
        )


def out_of_limit_in_words(names: Sequence[str]) -> str:
    """Return why measurements failed a test, without their values, which the list of failures shows."""
    from hiltest.text import join_words

    return f"out of limit: {join_words(names, _NAMED_AT_MOST)}"


def _outcome(report: pytest.TestReport) -> TestOutcome:
    outcome = TestOutcome(str(report.outcome))  # including outcomes of plugins such as pytest-rerunfailures
    if outcome is TestOutcome.RERUN:
        return outcome
    cause = getattr(report, CAUSE, "")
    if cause:
        return TestOutcome(cause)
    if hasattr(report, "wasxfail"):
        return TestOutcome.XFAILED if report.skipped else TestOutcome.XPASSED
    if report.failed and report.when != "call":
        return TestOutcome.ERROR
    return outcome


def _badness(report: pytest.TestReport) -> tuple[bool, bool, bool]:
    # The first phase of several failed ones counts, since max() returns the first of equal items.
    return (report.failed or str(report.outcome) == TestOutcome.RERUN, report.skipped, report.when == "call")


def _reason(report: pytest.TestReport) -> str:
    """Return the reason in one line why a test did not pass."""
    if report.passed:
        return ""
    if hasattr(report, REASON):
        return str(getattr(report, REASON))
    if names := getattr(report, OUT_OF_LIMIT, None):
        return out_of_limit_in_words(names)
    if report.skipped and isinstance(report.longrepr, tuple):
        return str(report.longrepr[2]).removeprefix("Skipped: ")
    crash = getattr(report.longrepr, "reprcrash", None)
    text = str(crash.message if crash else report.longrepr).removeprefix("Failed: ")  # of pytest.fail
    lines = text.strip().splitlines()
    return lines[0] if lines else ""
