"""The pytest plugin, which consists of hooks; the modules that they call do the work.

Every pytest run on the machine imports this module, so that it imports nothing
heavy: no numpy, no pydantic and no emulator until a test requests a board.
"""

from __future__ import annotations

import sys
from collections.abc import Generator, Sequence
from typing import Any

import pytest

from hiltest.processes import lacks_resources
from hiltest.run_record.outcomes import TestOutcome
from hiltest.session import hookspecs
from hiltest.session.bench_session import SESSION, HilSession
from hiltest.session.fixtures import (
    benchmark_cycles,
    board,
    cycles,
    hil_calibration,
    hil_progress,
    hil_settings,
    measure,
    rig,
    turntable,
)
from hiltest.session.gate import CUT_SHORT, NOT_EVALUATED
from hiltest.session.plain_imports import import_plainly
from hiltest.session.results import (
    CAUSE,
    FAILED_LIMITS,
    FOUND,
    FOUND_AT_ITS_END,
    FOUND_HERE,
    GATING,
    OUT_OF_LIMIT,
    REASON,
    TRACE,
    WIRE_TRACE,
    carry_over,
    pack,
    unpack,
)
from hiltest.session.selection import MARKER, leave_out_full, only_looks, uses_board, uses_hiltest
from hiltest.session.settings import add_options, resolve

__all__ = [
    "benchmark_cycles",
    "board",
    "cycles",
    "hil_calibration",
    "hil_progress",
    "hil_settings",
    "measure",
    "rig",
    "turntable",
]

_LETTERS = {TestOutcome.CONNECTION_LOST: "L", TestOutcome.WRONG_FIRMWARE: "W"}


def pytest_addhooks(pluginmanager: pytest.PytestPluginManager) -> None:
    """Let conftest files implement the ``pytest_hil_`` hooks. pytest calls this hook first."""
    import_plainly()
    pluginmanager.add_hookspecs(hookspecs)


def pytest_addoption(parser: pytest.Parser) -> None:
    """Add ``--hil-`` options and their ini twins."""
    add_options(parser)


def pytest_configure(config: pytest.Config) -> None:
    """Register the markers and store the session's state."""
    config.addinivalue_line("markers", "hil: the test needs a board; skipped with the reason once the board is lost")
    config.addinivalue_line("markers", "full: a test that needs a board, and is left out of the gate set of tests")
    hil = config.stash[SESSION] = HilSession(config, resolve(config))
    if hil.is_worker or hil.hands_out:
        from hiltest.session.workers import Controller, Worker

        config.pluginmanager.register(Worker(hil) if hil.is_worker else Controller(hil), "hiltest-workers")
    if "pytest_benchmark.plugin" in sys.modules:
        from hiltest.session.benchmark_hooks import join_pytest_benchmark

        join_pytest_benchmark(config.pluginmanager)


# This hook is the last, after other plugins, such as junitxml, have written into the folder.
@pytest.hookimpl(trylast=True)
def pytest_unconfigure(config: pytest.Config) -> None:
    """Release the folder of the record."""
    hil = config.stash.get(SESSION, None)
    if hil is not None:
        hil.folder.release()


# This hook is the last: it omits tests that the user's own choice would have run.
@pytest.hookimpl(trylast=True)
def pytest_collection_modifyitems(config: pytest.Config, items: list[pytest.Item]) -> None:
    """Omit tests of the full set from the gate set."""
    hil = config.stash[SESSION]
    if hil.settings.suite == "gate":
        hil.choice.left_out = leave_out_full(config, items, [item for item in items if uses_hiltest(item)])


def pytest_deselected(items: Sequence[pytest.Item]) -> None:
    """Note which tests are left out, by the gate set or by ``-k``, ``-m`` or another option."""
    for item in filter(uses_hiltest, items):
        hil = item.config.stash[SESSION]
        if hil.settings.suite == "full" or item.get_closest_marker(MARKER) is None:
            hil.choice.deselected = True
        else:
            hil.choice.full_tests_left_out += 1


# This hook is the first, so that the board is known when other plugins report the collection.
@pytest.hookimpl(tryfirst=True)
def pytest_collection_finish(session: pytest.Session) -> None:
    """Open the rig and the board as soon as it is known that a test needs them."""
    hil = session.config.stash[SESSION]
    hil.choice.left_out.check_that_some_are_left(session.items)
    if hil.begin(session.items):
        from hiltest.session.recording import cutting_short, start_recording

        with cutting_short():
            start_recording(hil)


def pytest_report_collectionfinish(config: pytest.Config) -> list[str]:
    """Show the board of the tests."""
    hil = config.stash[SESSION]
    return [*hil.describe(), *hil.choice.left_out.describe()]


# This wrapper is the innermost one around the set-up: no fixture of a test is set up on a lost board.
@pytest.hookimpl(wrapper=True, trylast=True)
def pytest_runtest_setup(item: pytest.Item) -> Generator[None, object, object]:
    """Skip a test whose board is already lost."""
    hil = item.config.stash[SESSION]
    hil.begin_test(item.nodeid)
    carry_over(item)
    if hil.trouble_reported and uses_board(item):
        if hil.trouble_met_by == item.nodeid and hil.trouble is not None:
            raise hil.trouble  # this is another attempt of the test that was charged with the loss, and no skip
        pytest.skip(f"connection lost earlier: {hil.trouble}")
    with hil.refusing_reset():
        return (yield)


@pytest.hookimpl(wrapper=True)
def pytest_runtest_call(item: pytest.Item) -> Generator[None, object, object]:
    """Fail a test at its end for measurements out of their limits, even if it then skips or excuses itself."""
    try:
        with item.config.stash[SESSION].refusing_reset():
            result = yield
    except (pytest.skip.Exception, pytest.xfail.Exception):
        _fail_out_of_limit(item)
        raise
    except BaseException:
        item.stash[GATING] = []  # the test is already red for its own reason
        raise
    _fail_out_of_limit(item)
    return result


@pytest.hookimpl(wrapper=True)
def pytest_runtest_teardown(item: pytest.Item) -> Generator[None, object, object]:
    """Fail a test for measurements out of their limits that a fixture made after it."""
    result = yield
    _fail_out_of_limit(item)
    return result


def _fail_out_of_limit(item: pytest.Item) -> None:
    gating = item.stash.get(GATING, [])
    item.stash[GATING] = []
    if not gating:
        return
    from hiltest.measurement import Outcome

    if failed := [measurement for measurement in gating if measurement.outcome is Outcome.FAIL]:
        item.stash[FAILED_LIMITS] = [measurement.name for measurement in failed]
        pytest.fail("; ".join(map(str, failed)), pytrace=False)


@pytest.hookimpl(wrapper=True)
def pytest_runtest_makereport(
    item: pytest.Item, call: pytest.CallInfo[None]
) -> Generator[None, pytest.TestReport, pytest.TestReport]:
    """Add the findings, and the responsibility for a failure, to the report."""
    report = yield
    item.config.stash[SESSION].clear_progress()
    findings = item.stash.get(FOUND, None)
    if findings is not None:
        setattr(report, FOUND_HERE, findings)
        del item.stash[FOUND]
        if call.when == "teardown":
            item.stash[FOUND_AT_ITS_END] = findings
    if failed_limits := item.stash.get(FAILED_LIMITS, None):
        del item.stash[FAILED_LIMITS]
        setattr(report, OUT_OF_LIMIT, failed_limits)
    if report.failed and call.excinfo is not None:
        hil = item.config.stash[SESSION]
        if uses_hiltest(item) and lacks_resources(call.excinfo.value):
            # The test has not failed: it could not be made.
            pytest.exit(f"cut short in {item.nodeid}: {call.excinfo.value!r}", returncode=CUT_SHORT)
        trace = hil.keep_trace(hil.test_id(item.nodeid), report.when, call.excinfo.value)
        in_fixture = call.when == "setup" and uses_hiltest(item)
        first = hil.failed_first(call.excinfo.value, item.nodeid) if in_fixture else item.nodeid
        if trace:
            setattr(report, TRACE, trace)
            if first == item.nodeid:
                report.sections.append((WIRE_TRACE, str(hil.folder.path / trace)))
        # A test that does not use hiltest fails as usual, with its traceback.
        if uses_hiltest(item):
            from hiltest.errors import HiltestError

            cause = hil.blame(call.excinfo.value, item.nodeid)
            if cause:
                setattr(report, CAUSE, str(cause))
            if cause or isinstance(call.excinfo.value, HiltestError):
                setattr(report, REASON, str(call.excinfo.value))
            if first != item.nodeid:
                report.longrepr = f"{call.excinfo.value}\nas in {first}, which shares the fixture"
    return report


@pytest.hookimpl(wrapper=True)
def pytest_report_to_serializable() -> Generator[None, dict[str, Any] | None, dict[str, Any] | None]:
    """Pack the findings as plain data if a report leaves the process, as from a worker."""
    data = yield
    if data and FOUND_HERE in data:
        data[FOUND_HERE] = pack(data[FOUND_HERE])
    return data


@pytest.hookimpl(wrapper=True)
def pytest_report_from_serializable() -> Generator[None, object, object]:
    """Unpack the findings from plain data."""
    report = yield
    packed = getattr(report, FOUND_HERE, None)
    if packed is not None:
        setattr(report, FOUND_HERE, unpack(packed))
    return report


# This hook is the first: a lost bench is a category of its own, whatever other plugins call a failed report.
@pytest.hookimpl(tryfirst=True)
def pytest_report_teststatus(report: pytest.CollectReport | pytest.TestReport) -> tuple[str, str, object] | None:
    """Name tests that the bench or the firmware ended."""
    # pytest-rerunfailures names the tests that it repeats.
    cause = getattr(report, CAUSE, "") if report.failed else ""
    return (cause, _LETTERS[TestOutcome(cause)], (cause.upper(), {"red": True})) if cause else None


# This hook is the first, and wraps all others: pytest itself ends with 0 if it only shows something.
@pytest.hookimpl(wrapper=True, tryfirst=True)
def pytest_cmdline_main(config: pytest.Config) -> Generator[None, object, object]:
    """Fail closed: a requested comparison that was not made is no pass."""
    code = yield
    if code == pytest.ExitCode.OK and (reason := _unevaluated_reason(config)):
        print(reason)
        return NOT_EVALUATED
    return code


def _unevaluated_reason(config: pytest.Config) -> str:
    """Return why a requested gate is not evaluated although no run is recorded; empty without a gate."""
    hil = config.stash.get(SESSION, None)
    if hil is None or hil.is_worker or config.pluginmanager.has_plugin("hiltest-recording"):
        return ""
    return hil.gate.unevaluated("no test ran" if only_looks(config) else "no test that ran uses hiltest")
