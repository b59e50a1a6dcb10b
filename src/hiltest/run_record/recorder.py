"""Writer of the record while tests finish: first the journal, then the files."""

from __future__ import annotations

import os
import platform
from collections.abc import Callable, Iterable, Mapping
from dataclasses import asdict, replace
from importlib.metadata import PackageNotFoundError, version
from typing import Any, Literal

from hiltest.measurement import Measurement, Outcome
from hiltest.run_record.comparison import Comparison, Revision
from hiltest.run_record.journal import Journal
from hiltest.run_record.outcomes import TestOutcome
from hiltest.run_record.run import (
    SCHEMA,
    BoardRecord,
    CalibrationRecord,
    Environment,
    Findings,
    RigRecord,
    Run,
    Table,
    TestResult,
    Verdict,
    utc_now,
)
from hiltest.run_record.run_json import write_run

# Packages that numbers in the record can depend on, besides the firmware.
_PACKAGES = ("hiltest", "pytest", "cffi", "capstone", "pyelftools", "numpy", "scipy", "pyserial")


class Recorder:
    """Collects the findings of a session and writes them into the folder of its journal.

    The record of the previous run stays in the folder until `begin`, since this run may not take place.
    """

    def __init__(
        self, journal: Journal, *, suite: Literal["gate", "full"], poses: str, revision: Revision | None = None
    ) -> None:
        self.folder = journal.folder
        self.findings = Findings(describe_host(), suite, poses, utc_now(), revision=revision)
        self._unwritten_measurements: list[Measurement] = []
        self._unwritten_tables: list[Table] = []
        self._journal = journal
        self._has_steps = False
        journal.announce(
            {
                "schema": SCHEMA,
                "started_utc": self.findings.started_utc,
                "suite": suite,
                "poses": poses,
                "environment": asdict(self.findings.environment),
                "revision": revision and asdict(revision),
            }
        )

    def earlier(self, kind: str) -> tuple[str, list[dict[str, Any]]]:
        """Return the start of the last run in this folder with steps of a kind, and these steps."""
        start, entries = self._journal.earlier(kind)
        return str(start.get("started_utc", "")), entries

    def keep(self, kind: str, content: Mapping[str, Any]) -> None:
        """Write a step through to the disk; the journal of an unfinished run then stays."""
        self._journal.append(kind, content)
        self._has_steps = True

    def begin(self, calibration: CalibrationRecord | None = None) -> None:
        """Remove the record of the previous run, and note the calibration file under test."""
        self._journal.begin()
        self.findings.calibration = calibration
        self._journal.append("calibration", {"calibration": calibration and asdict(calibration)})

    def rig(self, rig: RigRecord, seed: int | None) -> None:
        """Note the rig of the run."""
        self.findings.rig, self.findings.seed = rig, seed
        self._journal.append("rig", {"rig": asdict(rig), "seed": seed})

    def board(self, board: BoardRecord, seed: int | None) -> None:
        """Note the board that answered."""
        self.findings.board, self.findings.seed = board, seed
        self._journal.append("board", {"board": asdict(board), "seed": seed})

    def add(self, measurements: Iterable[Measurement], tables: Iterable[Table]) -> None:
        """Add measurements and tables, rounded as in the file; the next `finish_test` writes them to the disk."""
        self._unwritten_measurements += (measurement.rounded() for measurement in measurements)
        self._unwritten_tables += (table.rounded() for table in tables)

    def finish_test(self, test: TestResult | None) -> None:
        """Write a finished test through to the disk; with None the session's own findings."""
        if test is not None:
            self.findings.tests.append(test)
            if test.outcome is TestOutcome.XFAILED:
                self._unwritten_measurements = [
                    _as_expected(measurement, test) for measurement in self._unwritten_measurements
                ]
        names = dict.fromkeys(unwritten_measurement.name for unwritten_measurement in self._unwritten_measurements)
        others = len(self.findings.other_attempts)
        for unwritten_measurement in self._unwritten_measurements:
            self.findings.take(unwritten_measurement)
        self.findings.tables.update((table.name, table) for table in self._unwritten_tables)
        self._journal.append(
            "test",
            {
                "utc": utc_now(),
                "test": test and asdict(test),
                "measurements": [asdict(self.findings.measurements[name]) for name in names],
                "other_attempts": [asdict(other_attempt) for other_attempt in self.findings.other_attempts[others:]],
                "tables": [asdict(unwritten_table) for unwritten_table in self._unwritten_tables],
            },
        )
        self._unwritten_measurements, self._unwritten_tables = [], []

    def compare(self, compared: Callable[[Run], Comparison], verdict: Verdict) -> None:
        """Compare the run with a base; `verdict` is its verdict apart from the comparison."""
        self.findings.comparison = compared(self.findings.finish(verdict, utc_now()))

    def finish(self, verdict: Verdict) -> Run:
        """Write ``run.json``; `release` then removes the journal if it has no other content."""
        run = self.findings.finish(verdict, utc_now())
        comparison = run.comparison and asdict(run.comparison)
        self._journal.append(
            "end",
            {
                "verdict": asdict(verdict),
                "finished_utc": run.finished_utc,
                "comparison": comparison,
                "chosen": run.chosen,
                "tests_left_out": run.tests_left_out,
                "crash": run.crash,
                "coverage": run.coverage and asdict(run.coverage),
                "suites": run.suites,
            },
        )
        write_run(run, self.folder)
        if verdict.complete or not self._has_steps:
            self._journal.finish()
        return run

    def release(self) -> None:
        """Release the folder after every file is written."""
        self._journal.release()


def _as_expected(measurement: Measurement, test: TestResult) -> Measurement:
    """Return a measurement; out of its limit in a test that was expected to fail, it does not fail the run."""
    if measurement.test != test.id or measurement.outcome is not Outcome.FAIL:
        return measurement
    return replace(measurement, outcome=Outcome.EXPECTED_FAIL, note=measurement.note or "its test is marked xfail")


def describe_host() -> Environment:
    """Return the host, and the versions that the numbers depend on."""
    versions = {}
    for package in _PACKAGES:
        try:
            versions[package] = version(package)
        except PackageNotFoundError:
            versions[package] = "not installed"
    return Environment(
        host=f"{platform.node()}, {os.cpu_count()} cores",
        platform=platform.platform(),
        python=platform.python_version(),
        versions=versions,
    )
