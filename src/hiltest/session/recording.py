"""Plugin that keeps the record; registered only if a test needs hiltest."""

from __future__ import annotations

import os
import sys
from collections.abc import Generator, Iterator
from contextlib import contextmanager
from dataclasses import replace
from functools import partial
from typing import TYPE_CHECKING, Any

import pytest

from hiltest.errors import ConfigError
from hiltest.processes import asked_to_end, guard_output, interrupt_by_signals, lacks_resources
from hiltest.rig.rig import conditions_sha256
from hiltest.run_record.files import MARKDOWN_FILE, OLDER_FOLDER, write_asked_for
from hiltest.run_record.outcomes import TestOutcome
from hiltest.run_record.run import (
    BoardRecord,
    CalibrationRecord,
    CoverageRecord,
    RigRecord,
    Run,
    SensorRecord,
    TestResult,
)
from hiltest.run_record.run_json import part_from
from hiltest.session.bench_session import HilSession
from hiltest.session.gate import CUT_SHORT, NOT_EVALUATED
from hiltest.session.record_folder import remove_runs
from hiltest.session.results import (
    BENCH,
    FOUND_HERE,
    OUT_OF_LIMIT,
    WIRE_TRACE,
    TestFindings,
    TestLog,
    out_of_limit_in_words,
)
from hiltest.session.selection import suite_digests

if TYPE_CHECKING:
    from hiltest.boards import Board
    from hiltest.procedures.imu_calibration.calibration_file import CalibrationFile
    from hiltest.rig import Rig
    from hiltest.run_record.recorder import Recorder

REPLAY = "replay"
"""Name in place of a test's id if a replay ended before its recording."""
_PHASES = ("setup", "call", "teardown")


def start_recording(hil: HilSession) -> Recording:
    """Begin the record of a session, and register the plugin that keeps it."""
    rig, recorder = hil.rig_if_needed, hil.claim_folder()
    recorder.begin(calibration_record(hil.calibration))
    remove_runs(recorder.folder / OLDER_FOLDER)  # the older firmware of an earlier command must not pass for this one's
    if rig is not None:
        recorder.rig(rig_record(rig), hil.seed)
    if hil.board is not None:
        recorder.board(replace(board_record(hil.board), recording=hil.replay and hil.replay.record), hil.board.seed)
    recording = Recording(hil, recorder)
    hil.config.pluginmanager.register(recording, "hiltest-recording")
    interrupt_by_signals()
    terminal = hil.config.pluginmanager.get_plugin("terminalreporter")
    if terminal is not None:
        terminal._tw._file = guard_output(terminal._tw._file)
    return recording


@contextmanager
def cutting_short() -> Iterator[None]:
    """End the session with exit code 24 if the record cannot be written for lack of disk space, files or memory."""
    try:
        yield
    except (OSError, MemoryError, ConfigError) as error:
        if not lacks_resources(error):
            raise
        pytest.exit(f"cut short: the record cannot be written: {error}", returncode=CUT_SHORT)


class Recording:
    """Journals each finished test; at the end it decides the run and writes every file."""

    def __init__(self, hil: HilSession, recorder: Recorder) -> None:
        self._hil = hil
        self._recorder = recorder
        self._log = TestLog(hil.test_id)
        self._finished = 0
        self._test_files: set[str] = set()
        self._summary_remark = ""
        self.run: Run | None = None

    # This hook is the first, before a test runs or the session waits for a worker.
    @pytest.hookimpl(tryfirst=True)
    def pytest_runtestloop(self, session: pytest.Session) -> None:
        """Run the older firmware, if there is one; no test runs if the base is missing."""
        hil = self._hil
        if (
            (hil.trouble is not None and not hil.crash)
            or session.testsfailed
            or not (session.testscollected or hil.hands_out)
        ):
            return  # the end of the session is already certain
        hil.gate.run_older(partial(_print_line, session.config))
        hil.restart_wall_clock()
        if hil.gate.missing:
            pytest.exit(f"not evaluated: {hil.gate.missing}", returncode=NOT_EVALUATED)

    def pytest_runtest_logreport(self, report: pytest.TestReport) -> None:
        """Record the findings of one phase of a test."""
        self._log.add(report)
        self._test_files.add(report.nodeid.partition("::")[0])
        self._note_board(getattr(report, BENCH, None))
        findings = getattr(report, FOUND_HERE, None)
        if findings is not None:
            self.record(findings)
        if report.when not in _PHASES:
            # Reports of pytest-xdist on a test whose worker crashed; no other report follows.
            self.pytest_runtest_logfinish(report.nodeid)

    def record(self, findings: TestFindings) -> None:
        """Record the measurements of a test, or of a worker at its end."""
        self._recorder.add(findings.measurements, findings.tables)

    def _note_board(self, bench: dict[str, Any] | None) -> None:
        """Note the board that answered a worker."""
        if bench is None or bench["board"] is None:
            return
        board = part_from(BoardRecord, bench["board"])
        if board != self._recorder.findings.board:
            self._recorder.board(board, bench["seed"])

    def pytest_runtest_logfinish(self, nodeid: str) -> None:
        """Write a finished test through to the disk, including each attempt."""
        results = self._log.finish(nodeid)
        with cutting_short():
            self._hil.flush_tape()  # first, so that the recording has every test of the journal
            for result in results:
                self._recorder.finish_test(result)
        self._finished += bool(results) and results[-1].outcome is not TestOutcome.RERUN

    # The first of the plain implementations, so that others, such as junitxml, see the final exit status.
    @pytest.hookimpl(tryfirst=True)
    def pytest_sessionfinish(self, session: pytest.Session, exitstatus: int) -> None:
        """Close the board, decide the run, write ``run.json`` and the reports; one more Ctrl-C does not prevent it."""
        try:
            with asked_to_end():
                self._finish(session, exitstatus)
        except (OSError, MemoryError, ConfigError) as error:
            if not lacks_resources(error):
                raise
            if self.run is None:  # the journal keeps what it has
                session.exitstatus = CUT_SHORT
            _print_line(session.config, f"cut short: the record and its pages cannot be written: {error}")

    def _finish(self, session: pytest.Session, exitstatus: int) -> None:
        from hiltest.report.job_summary import append_to_job_summary
        from hiltest.report.render import write_reports
        from hiltest.verdict.evidence import evidence_of
        from hiltest.verdict.verdict import decide

        hil = self._hil
        self._recorder.add(hil.end(), hil.gate.base_poses)
        self._recorder.finish_test(None)
        if hil.divergence and not hil.trouble_reported:
            self._recorder.finish_test(TestResult(REPLAY, TestOutcome.CONNECTION_LOST, 0.0, hil.divergence))
        exitstatus = self._write_coverage(exitstatus)
        self._recorder.findings.chosen = self._hil.choice.chose_our_tests
        self._recorder.findings.tests_left_out = self._hil.choice.full_tests_left_out
        self._recorder.findings.crash = hil.crash
        self._recorder.findings.suites = suite_digests(self._test_files, session.config.rootpath)
        stopped = bool(session.shouldstop or session.shouldfail)
        cut_short = stopped or self._finished < session.testscollected
        if isinstance(sys.exception(), KeyboardInterrupt):
            # A second Ctrl-C came while pytest dealt with the first, and pytest reports neither.
            exitstatus = pytest.ExitCode.INTERRUPTED
        left_out = self._record_unmet_limits(left_out=stopped or exitstatus > 1 or self._hil.choice.chose_any_tests)
        decided = partial(
            decide, self._recorder.findings, pytest_exit=int(exitstatus), left_out=left_out, cut_short=cut_short
        )
        board = self._recorder.findings.board
        packaged = board is not None and board.kind == "virtual" and self._hil.settings.firmware is None
        if (compare := self._hil.gate.compare_by(packaged=packaged)) is not None:
            self._recorder.compare(lambda run: compare(evidence_of(run)), decided())
        self.run = self._recorder.finish(decided())
        session.exitstatus = self.run.verdict.exit_code
        page = write_reports(self.run, self._recorder.folder)
        remark = append_to_job_summary(page, self._recorder.folder / MARKDOWN_FILE)
        self._summary_remark = "\n".join(filter(None, (self._summary_remark, remark)))
        session.config.hook.pytest_hil_finished(config=session.config, run=self.run)
        terminal = session.config.pluginmanager.get_plugin("terminalreporter")
        if exitstatus == NOT_EVALUATED and terminal is not None:
            self.print_summary(terminal, session.config)  # pytest itself prints none after such an exit code

    def _write_coverage(self, exitstatus: int) -> int:
        """Write the requested coverage; return the exit status, which is a usage error if writing fails."""
        file, coverage = self._hil.settings.coverage, self._hil.coverage
        if file is None or coverage is None:
            return exitstatus
        from hiltest.virtual.coverage.lcov import to_lcov

        try:
            write_asked_for(file, to_lcov(coverage))
        except ConfigError as error:
            self._summary_remark = str(error)
            return exitstatus or int(pytest.ExitCode.USAGE_ERROR)
        self._recorder.findings.coverage = CoverageRecord(
            os.path.relpath(file, self._recorder.folder), coverage.lines, coverage.functions, coverage.branches
        )
        return exitstatus

    def _record_unmet_limits(self, *, left_out: bool) -> list[str]:
        """Record every limit of the rig without a measurement; with `left_out` only return their names."""
        findings, rig = self._recorder.findings, self._hil.rig_if_needed
        if rig is None or not self._hil.must_meet_every_limit:
            return []
        from hiltest.verdict.verdict import unmet_limits

        calibrators = findings.board.calibrators if findings.board else ()
        unmet = unmet_limits(
            rig.limits_of(findings.suite),
            rig.units,
            findings.measurements,
            calibrators,
            gate_only=bool(self._hil.choice.left_out.tests),
            places={name: rig.where("limits", name) for name in rig.limits},
        )
        lost = any(test.outcome.is_of_bench for test in findings.tests)
        if left_out or lost:
            return [measurement.name for measurement in unmet]
        self._recorder.add(unmet, ())
        self._recorder.finish_test(None)
        return []

    # A wrapper around pytest's own summary, whose first part shows tracebacks: verdict and failures come before them.
    @pytest.hookimpl(wrapper=True, tryfirst=True)
    def pytest_terminal_summary(
        self, terminalreporter: pytest.TerminalReporter, config: pytest.Config
    ) -> Generator[None, None, None]:
        """Print the verdict, the failures, the calibrators and the path of the report."""
        self.print_summary(terminalreporter, config)
        if self.run is not None:
            for report in (*terminalreporter.getreports("failed"), *terminalreporter.getreports("error")):
                _point_to_summary(report)
        return (yield)

    def print_summary(self, terminal: pytest.TerminalReporter, config: pytest.Config) -> None:
        """Print the summary if there is a run."""
        if self.run is None:
            return
        from hiltest.report.job_summary import annotation
        from hiltest.report.terminal import summary

        terminal.ensure_newline()
        terminal.write_line("")
        terminal.write(
            summary(
                self.run,
                self._recorder.folder,
                verbose=config.get_verbosity() > 0,
                width=terminal._tw.fullwidth,
                colour=terminal.hasmarkup,
                options=self._hil.settings.as_run_options(),
            )
        )
        if self._summary_remark:
            terminal.write_line(self._summary_remark)
        terminal.write(annotation(self.run.verdict))


def _point_to_summary(report: pytest.TestReport) -> None:
    """Leave values and the wire trace to the summary if only measurements out of their limits failed a test.

    The text of reports that are written to files already exists.
    """
    if names := getattr(report, OUT_OF_LIMIT, None):
        report.longrepr = out_of_limit_in_words(names)
        report.sections = [section for section in report.sections if section[0] != WIRE_TRACE]


def _print_line(config: pytest.Config, line: str) -> None:
    """Print a line at once, before the end of the session."""
    terminal = config.pluginmanager.get_plugin("terminalreporter")
    if terminal is not None:
        terminal.write_line(line)
        terminal.flush()


def rig_record(rig: Rig) -> RigRecord:
    """Return the record of a rig."""
    declared = rig.mounting
    mounting = "not declared" if declared is None else f"{declared.yaw_deg:g} ± {declared.uncertainty_deg:g} deg"
    return RigRecord(
        rig.name,
        str(rig.path),
        rig.sha256,
        mounting,
        conditions_sha256(rig),
        {name: (tolerance.absolute, tolerance.relative) for name, tolerance in rig.tolerances.items()},
        rig.procedure.cost_reference,
        str(rig.faults or ""),
    )


def calibration_record(file: CalibrationFile | None) -> CalibrationRecord | None:
    """Return the record of a calibration file."""
    return CalibrationRecord(str(file.path), file.sha256, file.calibration.made_utc) if file else None


def board_record(board: Board) -> BoardRecord:
    """Return the record of a board."""
    if not board.answers_requests:
        return BoardRecord(
            kind=str(board.kind),
            description=board.description,
            firmware=board.firmware or "not offered",
            version="",
            protocol_version=0,
            build_id=board.elf_build_id,
            unique_id="",
            firmware_sha256=board.firmware_sha256,
            compiler="",
            placement="",
            core_clock_hz=board.core_clock_hz,
            cycle_model=board.cycle_model,
            clock=board.clock,
            calibrators=(),
            sensors=(),
            compiler_flags=board.compiler_flags,
            elf_build_id=board.elf_build_id,
        )
    identity = board.identity
    return BoardRecord(
        kind=str(board.kind),
        description=board.description,
        firmware=identity.name,
        version=identity.version,
        protocol_version=identity.protocol_version,
        build_id=identity.build_id,
        unique_id=identity.unique_id.hex(),
        firmware_sha256=board.firmware_sha256,
        compiler=identity.compiler,
        placement=identity.placement,
        core_clock_hz=identity.core_clock_hz,
        cycle_model=board.cycle_model,
        clock=board.clock,
        calibrators=tuple(identity.calibrators),
        sensors=tuple(
            SensorRecord(
                sensor.name,
                sensor.kind.name.lower(),
                sensor.bus,
                sensor.address,
                bool(sensor.present),
                bool(sensor.selected),
            )
            for sensor in board.sensors
        ),
        compiler_flags=board.compiler_flags,
        elf_build_id=board.elf_build_id,
    )
