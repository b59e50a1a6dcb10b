"""The part of the plugin that keeps the record; registered only when a test needs hiltest."""

from __future__ import annotations

import pytest

from hiltest.outcomes import TestLog
from hiltest.report.record import Run, measurement_from, table_from
from hiltest.report.recorder import Recorder
from hiltest.session import FOUND_HERE, HilSession


class Recording:
    """Journals each finished test; at the end decides the run and writes every file."""

    def __init__(self, hil: HilSession, recorder: Recorder) -> None:
        self._hil = hil
        self._recorder = recorder
        self._log = TestLog()
        self.run: Run | None = None

    def pytest_runtest_logreport(self, report: pytest.TestReport) -> None:
        """Take what one phase of a test found."""
        self._log.add(report)
        found = getattr(report, FOUND_HERE, None)
        if found is not None:
            self._recorder.found(map(measurement_from, found["measurements"]), map(table_from, found["tables"]))

    def pytest_runtest_logfinish(self, nodeid: str) -> None:
        """Write a finished test through to the disk."""
        result = self._log.finish(nodeid)
        if result is not None:
            self._recorder.finished(result)

    # First of the plain implementations: others, such as junitxml, then see the final exit status.
    @pytest.hookimpl(tryfirst=True)
    def pytest_sessionfinish(self, session: pytest.Session, exitstatus: int) -> None:
        """Close the board, decide the run, write ``run.json`` and the reports."""
        from hiltest.report.render import write_reports
        from hiltest.report.verdict import decide

        self._recorder.found(self._hil.end(), ())
        self._recorder.finished(None)
        verdict = decide(self._recorder.findings, pytest_exit=int(exitstatus))
        self.run = self._recorder.finish(verdict)
        session.exitstatus = verdict.exit_code
        write_reports(self.run, self._recorder.folder)
        session.config.hook.pytest_hil_finished(config=session.config, run=self.run)

    def pytest_terminal_summary(self, terminalreporter: pytest.TerminalReporter, config: pytest.Config) -> None:
        """Print the table of measurements, the files and the verdict."""
        if self.run is None:
            return
        from hiltest.report.terminal import summary

        # `hiltest run` ends with the sentence itself, behind pytest's own last line.
        sentence = not config.pluginmanager.has_plugin("hiltest-run")
        text = summary(
            self.run, self._recorder.folder, every=config.get_verbosity() > 0, sentence=sentence,
            width=terminalreporter._tw.fullwidth, colour=terminalreporter.hasmarkup,
        )
        terminalreporter.section("hiltest")
        terminalreporter.write(text)


