"""pytest-xdist: tests that use hiltest run in one worker, and the controlling process keeps the record.

A worker opens the board when its first test needs it, and writes no files but wire traces. Its findings are attached
to the reports of its tests, and those of its end to its final output.
"""

from __future__ import annotations

from collections.abc import Generator, Sequence
from contextlib import suppress
from pathlib import Path
from typing import TYPE_CHECKING, Any, Protocol

import pytest

from hiltest.session.bench_session import HilSession
from hiltest.session.record_folder import RecordFolder
from hiltest.session.results import BENCH, TestFindings, pack, plain_data, unpack
from hiltest.session.selection import GROUP, OmittedTests, uses_board, uses_hiltest

if TYPE_CHECKING:
    from hiltest.session.recording import Recording

_OUTPUT = "hil"


class Node(Protocol):
    """A worker from the point of view of the controlling process; a crashed worker has no output."""

    workerinput: dict[str, Any]
    workeroutput: dict[str, Any]


class Worker:
    """Plugin in a worker: it keeps tests that use hiltest together, and reports their bench."""

    def __init__(self, hil: HilSession) -> None:
        self._hil = hil
        self._board: dict[str, Any] | None = None
        # The session sends this dictionary at its end.
        self._output: dict[str, Any] = {
            "found": pack(TestFindings()),
            "left_out": ([], ""),
            "deselected": False,
            "full_tests_left_out": 0,
            "crash": "",
            "usage_error": "",
            "coverage": "",
        }
        hil.config.workeroutput[_OUTPUT] = self._output  # type: ignore[attr-defined]

    # This hook is the first, so that pytest-xdist sees the group.
    @pytest.hookimpl(tryfirst=True)
    def pytest_collection_modifyitems(self, items: list[pytest.Item]) -> None:
        """Put all tests that use hiltest into one group."""
        for item in items:
            if uses_hiltest(item):
                item.add_marker(pytest.mark.xdist_group(GROUP))

    @pytest.hookimpl(wrapper=True, tryfirst=True)
    def pytest_collection_finish(self, session: pytest.Session) -> Generator[None, object, object]:
        """Refuse to open one board in several workers, and report every usage error, which xdist does not."""
        if distribution_of(self._hil.config) == SPREAD:
            put_into_group(session.items)
        let_groups_count(session.items)
        try:
            check_one_worker(self._hil.config, session.items)
            result = yield
        except pytest.UsageError as error:
            self._output["usage_error"] = str(error)
            raise
        self._output["left_out"] = (list(self._hil.choice.left_out.tests), self._hil.choice.left_out.how)
        self._output["deselected"] = self._hil.choice.deselected
        self._output["full_tests_left_out"] = self._hil.choice.full_tests_left_out
        return result

    # This hook is the first: the board is open, or lost, before any set-up of the test.
    @pytest.hookimpl(tryfirst=True)
    def pytest_runtest_setup(self, item: pytest.Item) -> None:
        """Open the board for the first test that needs it; only this worker gets such tests."""
        from hiltest.errors import BenchError, ConfigError, ProtocolError

        if not uses_board(item):
            return
        try:
            # The test itself is charged with a lost board.
            with suppress(BenchError, ProtocolError):
                self._hil.connect()
        except ConfigError as error:
            self._output["usage_error"] = str(error)
            pytest.exit(str(error), returncode=int(pytest.ExitCode.USAGE_ERROR))

    @pytest.hookimpl(wrapper=True)
    def pytest_runtest_makereport(self, item: pytest.Item) -> Generator[None, pytest.TestReport, pytest.TestReport]:
        """Add the bench of the test's numbers to the report."""
        report = yield
        if uses_hiltest(item):
            hil = self._hil
            description = {
                "rig": hil.rig_if_needed is not None,
                "only_benchmarks": hil.choice.only_benchmarks,
                "folder": str(hil.folder.path),
            }
            setattr(report, BENCH, {**description, **self._bench_data()})
        return report

    def pytest_sessionfinish(self) -> None:
        """Close the board, and send the coverage and the measurements of the whole session."""
        self._output["found"] = pack(TestFindings(self._hil.end()))
        self._output["crash"] = self._hil.crash
        if self._hil.coverage is not None:
            from hiltest.virtual.coverage.lcov import to_lcov

            self._output["coverage"] = to_lcov(self._hil.coverage)

    def _bench_data(self) -> dict[str, Any]:
        from hiltest.session.recording import board_record

        board = self._hil.board
        if board is not None and self._board is None:
            self._board = plain_data(board_record(board))
        return {"board": self._board, "seed": None if board is None else board.seed}


_DISTRIBUTION = "hil_distribution"
SPREAD = "load"
"""Distribution of pytest-xdist if only ``-n`` is set."""


def distribution_of(config: pytest.Config) -> str:
    """Return, in a worker, the value of ``--dist`` in the controlling process."""
    return str(config.workerinput[_DISTRIBUTION])  # type: ignore[attr-defined]


def put_into_group(items: Sequence[pytest.Item]) -> None:
    """Append the group to the ids of tests that use hiltest, by which `GroupedLoad` keeps them together."""
    for item in items:
        if uses_hiltest(item):
            setattr(item, "_nodeid", f"{item.nodeid}@{GROUP}")  # noqa: B010


def let_groups_count(items: Sequence[pytest.Item]) -> None:
    """Restore the ids with the group, as pytest-xdist sets them.

    It distributes tests by the group after their id, and sets that through an attribute that pytest ignores since 9.2
    (its issue 1386): ``--dist loadgroup`` would silently group nothing.
    """
    for item in items:
        meant = getattr(item, "_nodeid", item.nodeid)
        if meant != item.nodeid:
            item._id = type(item.id).parse(meant)


def check_one_worker(config: pytest.Config, items: Sequence[pytest.Item]) -> None:
    """Refuse a session whose tests that use hiltest would run in several workers.

    Raises
    ------
    pytest.UsageError
        With the remedy.
    """
    ours = [item for item in items if uses_hiltest(item)]
    workers = config.workerinput["workercount"]  # type: ignore[attr-defined]
    if not ours or workers < 2:
        return
    distribution = distribution_of(config)
    if distribution not in (SPREAD, "loadgroup"):
        raise pytest.UsageError(
            f"{workers} workers, and {ours[0].nodeid} uses hiltest: such tests share one board and one record, and "
            f"must run in one worker. Leave out --dist {distribution}, or -n"
        )
    strays = [item.nodeid for item in ours if not item.nodeid.endswith(f"@{GROUP}")]
    if strays:
        raise pytest.UsageError(
            f"{strays[0]} uses hiltest, and is not in the xdist_group {GROUP!r} alone: such tests share one board and "
            "one record. Leave out its own xdist_group, or run without -n"
        )


class GroupedLoad:
    """Distribution of tests under ``-n``: that of pytest-xdist, but tests that use hiltest go to one worker."""

    def __init__(self, config: pytest.Config, log: Any) -> None:
        from xdist.scheduler import LoadScheduling

        self._config, self._log = config, log
        self._inner = LoadScheduling(config, log)
        self._is_decided = False

    def __getattr__(self, name: str) -> Any:
        return getattr(self._inner, name)

    def schedule(self) -> None:
        """Distribute the tests; the first call chooses the distribution, as only the workers know the tests."""
        collected = {} if self._is_decided else dict(self._inner.node2collection)
        self._is_decided = True
        if any(test_id.endswith(f"@{GROUP}") for ids in collected.values() for test_id in ids):
            from xdist.scheduler import LoadGroupScheduling

            self._inner = LoadGroupScheduling(self._config, self._log)
            for node, ids in collected.items():
                self._inner.add_node(node)
                self._inner.add_node_collection(node, ids)
        self._inner.schedule()


class Controller:
    """Plugin in the controlling process: it begins the record with the first test that uses hiltest."""

    def __init__(self, hil: HilSession) -> None:
        self._hil = hil
        self._recording: Recording | None = None
        # Reports, and ids of finished tests, from before the first one that must be recorded.
        self._early: list[pytest.TestReport | str] = []

    @pytest.hookimpl(optionalhook=True)
    def pytest_configure_node(self, node: Node) -> None:
        """Send the distribution to a worker, which pytest-xdist does not."""
        node.workerinput[_DISTRIBUTION] = self._hil.config.option.dist

    @pytest.hookimpl(tryfirst=True, optionalhook=True)
    def pytest_xdist_make_scheduler(self, config: pytest.Config, log: Any) -> GroupedLoad | None:
        """Keep tests that use hiltest together if the user chose no distribution."""
        return GroupedLoad(config, log) if config.option.dist == SPREAD else None

    def pytest_sessionstart(self) -> None:
        """Begin at once if the command itself needs the bench."""
        if self._hil.is_required:
            self._begin()

    def pytest_runtest_logreport(self, report: pytest.TestReport) -> None:
        """Begin with the first report that has a bench."""
        if self._recording is not None:
            return
        self._early.append(report)
        bench = getattr(report, BENCH, None)
        if bench is not None:
            self._hil.choice.only_benchmarks = bench["only_benchmarks"]
            self._hil.folder = RecordFolder(Path(bench["folder"]))
            if bench["rig"]:
                _ = self._hil.rig
            self._begin()

    def pytest_runtest_logfinish(self, nodeid: str) -> None:
        """Remember that a test has finished."""
        if self._recording is None:
            self._early.append(nodeid)

    def pytest_testnodedown(self, node: Node) -> None:
        """Record the final output of a worker.

        Raises
        ------
        pytest.UsageError
            If the worker reported one.
        """
        output = getattr(node, "workeroutput", {}).get(_OUTPUT)
        if output is None:
            return
        if output["usage_error"]:
            raise pytest.UsageError(output["usage_error"])
        tests, how = output["left_out"]
        self._hil.choice.left_out = OmittedTests(tuple(tests), how)
        self._hil.choice.deselected = output["deselected"]
        self._hil.choice.full_tests_left_out = output["full_tests_left_out"]
        self._hil.crash = self._hil.crash or output["crash"]
        if output["coverage"]:
            from hiltest.virtual.coverage.lcov import from_lcov

            self._hil.coverage = from_lcov(output["coverage"], "coverage of a worker")
        if self._recording is not None:
            self._recording.record(unpack(output["found"]))

    def _begin(self) -> None:
        from hiltest.errors import ConfigError
        from hiltest.session.recording import start_recording

        self._hil.gate.read()
        try:
            self._recording = start_recording(self._hil)
        except ConfigError as error:
            raise pytest.UsageError(str(error)) from error
        for event in self._early:
            if isinstance(event, str):
                self._recording.pytest_runtest_logfinish(event)
            else:
                self._recording.pytest_runtest_logreport(event)
