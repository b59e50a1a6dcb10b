"""Failures of a run: measurements out of their limits, and tests that failed for another reason."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import replace

from hiltest.measurement import Measurement, Outcome
from hiltest.run_record.exit_codes import ExitCode
from hiltest.run_record.outcomes import RED
from hiltest.run_record.run import Findings, Run, TestResult, Verdict
from hiltest.text import format_count, format_number, join_words, short_test_id

_NAMED_AT_MOST = 3
_OF_COMPARISONS = (ExitCode.OK, ExitCode.REGRESSION, ExitCode.NOT_EVALUATED)


def out_of_limit(measurements: Iterable[Measurement]) -> list[Measurement]:
    """Return the measurements that fail their limit."""
    return [measurement for measurement in measurements if measurement.outcome is Outcome.FAIL]


def failed_otherwise(run: Run | Findings) -> list[TestResult]:
    """Return the red tests that no measurement out of its limit explains."""
    measurements = run.measurements.values() if isinstance(run, Findings) else run.measurements
    explained = {measurement.test for measurement in out_of_limit([*measurements, *run.other_attempts])}
    return [test for test in run.tests if test.outcome in RED and test.id not in explained]


def measured(measurement: Measurement) -> str:
    """Return a measurement's value and limit, or the reason for a missing value."""
    if measurement.value is None:
        return f"{measurement.name} ({measurement.note})"
    value = f"{measurement.name} {format_number(measurement.value)} {measurement.unit}".rstrip()
    return f"{value} ({measurement.limit})"


def failed_test(test: TestResult) -> str:
    """Return the name of a failed test, and the reason."""
    return f"{short_test_id(test.id)} ({test.reason})"


def limits_in_words(failed: Sequence[Measurement]) -> str:
    """Name measurements out of their limits; empty without any."""
    named = [measured(measurement) for measurement in failed]
    return f"Out of limit: {join_words(named, _NAMED_AT_MOST)}." if failed else ""


def tests_in_words(tests: Sequence[TestResult]) -> str:
    """Name tests that failed, with their reasons; empty without any."""
    named = [f"{tests_named(tests_of_reason)} ({reason})" for reason, tests_of_reason in group_by_reason(tests).items()]
    return f"Failed: {join_words(named, _NAMED_AT_MOST)}." if tests else ""


def group_by_reason(tests: Iterable[TestResult]) -> dict[str, list[TestResult]]:
    """Return tests by the reason of their failure: tests that share a failed fixture have one reason."""
    groups: dict[str, list[TestResult]] = {}
    for test in tests:
        groups.setdefault(test.reason, []).append(test)
    return groups


def tests_named(tests: Sequence[TestResult]) -> str:
    """Name the first of several tests, and count the others."""
    return join_words([short_test_id(test.id) for test in tests], 1)


def describe_unfinished(run: Run) -> Verdict:
    """Return the verdict of a run without an end, with a sentence."""
    failures = (limits_in_words(out_of_limit(run.measurements)), tests_in_words(failed_otherwise(run)))
    tests, measurements = format_count(len(run.tests), "test"), format_count(len(run.measurements), "measurement")
    last = f"; the last test was {short_test_id(run.tests[-1].id)}" if run.tests else ""
    finished = f"{run.verdict.outcome.upper()}: {tests} finished, {measurements} kept{last}."
    return replace(run.verdict, sentence=" ".join(filter(None, (finished, *failures))))


def missed_only_limits(run: Run) -> bool:
    """Return whether a run failed only because of measurements out of their limits."""
    failed = out_of_limit(run.measurements)
    return run.verdict.exit_code == ExitCode.FAILED and bool(failed) and not failed_otherwise(run)


def failed_by_itself(run: Run) -> tuple[str, ...]:
    """Return the failures of a run that neither limits nor the base explain: its tests, with the reason."""
    failed = out_of_limit(run.measurements)
    tests = tuple(failed_test(test) for test in failed_otherwise(run))
    if not tests and not failed and run.verdict.complete and run.verdict.exit_code not in _OF_COMPARISONS:
        return (f"the run itself ({run.verdict.outcome})",)
    return tests
