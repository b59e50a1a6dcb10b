"""One thing that was looked at: what was found, and what to do about it."""

from __future__ import annotations

from dataclasses import dataclass
from enum import StrEnum

from hiltest.errors import HiltestError, ProtocolError
from hiltest.record.exit_codes import ExitCode


class Health(StrEnum):
    """What a check came to."""

    OK = "ok"
    WARNING = "warning"
    FAILED = "FAILED"
    NOT_LOOKED_AT = "not looked at"


@dataclass(frozen=True, slots=True)
class Check:
    """One check."""

    name: str
    """What was looked at."""
    health: Health
    found: str
    """What was found; of what was not looked at, why."""
    remedy: str = ""
    """What to do; empty where there is nothing to do."""
    exit_code: ExitCode = ExitCode.OK
    """What this alone ends the command with."""


def ok(name: str, found: str) -> Check:
    """Return a check that found all right."""
    return Check(name, Health.OK, found)


def warning(name: str, found: str, remedy: str) -> Check:
    """Return a check that found what may make numbers wrong, and leaves the bench usable."""
    return Check(name, Health.WARNING, found, remedy)


def failed(name: str, found: str, remedy: str, exit_code: ExitCode = ExitCode.CONNECTION_LOST) -> Check:
    """Return a check that found why no run can be made."""
    return Check(name, Health.FAILED, found, remedy, exit_code)


def not_looked_at(name: str, because: str) -> Check:
    """Return a check that was not made."""
    return Check(name, Health.NOT_LOOKED_AT, because)


def of_error(name: str, error: HiltestError, port: str | None = None) -> Check:
    """Return the check that an error, met at a port, is of: behind what is wrong its message has the next step."""
    found, _, remedy = str(error).partition(". ")
    unknown = "run again; if it comes back, try another cable and another USB port"
    if port is not None and "://" in port:
        unknown = "see that what serves it runs, and that this machine reaches it"
    code = ExitCode.WRONG_FIRMWARE if isinstance(error, ProtocolError) else ExitCode.CONNECTION_LOST
    return failed(name, found, remedy or unknown, code)


def exit_code(checks: list[Check]) -> ExitCode:
    """Return what the command ends with: wrong firmware before a lost connection, warnings do not count."""
    codes = {check.exit_code for check in checks}
    first = (ExitCode.WRONG_FIRMWARE, ExitCode.CONNECTION_LOST)
    return next((code for code in first if code in codes), ExitCode.OK)
