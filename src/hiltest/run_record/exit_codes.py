"""Exit codes of a run and of a comparison, and their names."""

from __future__ import annotations

from enum import IntEnum

from hiltest.run_record.comparison import Comparison


class ExitCode(IntEnum):
    """Exit codes that `hiltest run` and pytest with the plugin share; the first that applies wins."""

    INTERRUPTED = 2
    INTERNAL_ERROR = 3
    USAGE_ERROR = 4
    NO_TESTS = 5
    CUT_SHORT = 24
    FAILED = 1
    WRONG_FIRMWARE = 23
    CONNECTION_LOST = 20
    NOT_EVALUATED = 22
    REGRESSION = 21
    OK = 0


WORDS = {
    ExitCode.INTERRUPTED: "interrupted",
    ExitCode.INTERNAL_ERROR: "internal error",
    ExitCode.USAGE_ERROR: "usage error",
    ExitCode.NO_TESTS: "no tests",
    ExitCode.CUT_SHORT: "cut short",
    ExitCode.FAILED: "fail",
    ExitCode.WRONG_FIRMWARE: "wrong firmware",
    ExitCode.CONNECTION_LOST: "connection lost",
    ExitCode.NOT_EVALUATED: "not evaluated",
    ExitCode.REGRESSION: "regression",
    ExitCode.OK: "pass",
}
"""Outcome of a run per exit code."""

PYTEST_WINS = tuple(ExitCode)[: [*ExitCode].index(ExitCode.FAILED)]
"""Codes of a run that did not come to its end."""


def outcome_of(code: int) -> str:
    """Return the outcome of a run by its exit code, which a plugin of pytest may have chosen."""
    return {int(exit_code): word for exit_code, word in WORDS.items()}.get(code, f"exit code {code}")


def comparison_code(comparison: Comparison) -> ExitCode:
    """Return the exit code of a comparison alone: a gate that could not be evaluated does not pass."""
    if comparison.failed:
        return ExitCode.FAILED
    if not comparison.evaluated or comparison.unjudged:
        return ExitCode.NOT_EVALUATED
    return ExitCode.REGRESSION if comparison.regression else ExitCode.OK
