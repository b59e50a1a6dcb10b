"""A single check: the finding, and the remedy."""

from __future__ import annotations

from dataclasses import dataclass
from enum import StrEnum

from hiltest.errors import HiltestError, ProtocolError
from hiltest.run_record.exit_codes import ExitCode


class Health(StrEnum):
    """Result of a check."""

    OK = "ok"
    WARNING = "warning"
    FAILED = "FAILED"
    NOT_LOOKED_AT = "not looked at"


@dataclass(frozen=True, slots=True)
class Check:
    """One check."""

    name: str
    """Subject of the check."""
    health: Health
    finding: str
    """Finding, or the reason why the check was not made."""
    remedy: str = ""
    """Remedy; empty if none is needed."""
    exit_code: ExitCode = ExitCode.OK
    """Exit code of the command if no other check fails."""


def ok(name: str, finding: str) -> Check:
    """Return a check that passed."""
    return Check(name, Health.OK, finding)


def warning(name: str, finding: str, remedy: str) -> Check:
    """Return a check of a usable bench whose numbers may be wrong."""
    return Check(name, Health.WARNING, finding, remedy)


def failed(name: str, finding: str, remedy: str, exit_code: ExitCode = ExitCode.CONNECTION_LOST) -> Check:
    """Return a check of a bench on which no run is possible."""
    return Check(name, Health.FAILED, finding, remedy, exit_code)


def not_looked_at(name: str, because: str) -> Check:
    """Return a check that was not made."""
    return Check(name, Health.NOT_LOOKED_AT, because)


def check_from_error(name: str, error: HiltestError, port: str | None = None) -> Check:
    """Return the check of an error at a port; the message has the finding and then the remedy."""
    finding, _, remedy = str(error).partition(". ")
    unknown = "run again; if the fault returns, try another cable and another USB port"
    if port is not None and "://" in port:
        unknown = "check that its server runs, and that this machine can reach it"
    code = ExitCode.WRONG_FIRMWARE if isinstance(error, ProtocolError) else ExitCode.CONNECTION_LOST
    return failed(name, finding, remedy or unknown, code)


def exit_code(checks: list[Check]) -> ExitCode:
    """Return the command's exit code: the first of wrong usage, wrong firmware and a lost connection."""
    codes = {check.exit_code for check in checks}
    first = (ExitCode.USAGE_ERROR, ExitCode.WRONG_FIRMWARE, ExitCode.CONNECTION_LOST)
    return next((code for code in first if code in codes), ExitCode.OK)
