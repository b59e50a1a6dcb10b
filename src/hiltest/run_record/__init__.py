"""The run as data: its measurements, `run.json` and the journal, their reader, the files and the exit codes."""

from __future__ import annotations

from typing import TYPE_CHECKING

from hiltest.lazy_exports import when_used

if TYPE_CHECKING:
    from hiltest.run_record.comparison import Change, Comparison, Difference
    from hiltest.run_record.exit_codes import ExitCode
    from hiltest.run_record.journal import Journal
    from hiltest.run_record.outcomes import TestOutcome
    from hiltest.run_record.reader import read_record
    from hiltest.run_record.recorder import Recorder
    from hiltest.run_record.run import Run, Table, Verdict

__all__ = [
    "Change",
    "Comparison",
    "Difference",
    "ExitCode",
    "Journal",
    "Recorder",
    "Run",
    "Table",
    "TestOutcome",
    "Verdict",
    "read_record",
]

__getattr__ = when_used(
    __name__,
    {
        "Change": "comparison",
        "Comparison": "comparison",
        "Difference": "comparison",
        "ExitCode": "exit_codes",
        "Journal": "journal",
        "Recorder": "recorder",
        "Run": "run",
        "Table": "run",
        "TestOutcome": "outcomes",
        "Verdict": "run",
        "read_record": "reader",
    },
)
