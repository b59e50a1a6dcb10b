"""``hiltest doctor``: check a bench for faults, one by one."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from datetime import UTC, datetime
from typing import TYPE_CHECKING

import click

from hiltest.commands.options import documented, load_named_rig, setting_option
from hiltest.text import legible

if TYPE_CHECKING:
    from hiltest.doctor.check import Check

_EXIT_CODES = """
\b
Exit codes:
  0   no check failed; there may be warnings
  4   usage: an option, a port or a rig file is wrong, or several boards are
      plugged in and none is named
  20  connection lost: a check failed
  23  wrong firmware, or another protocol version
"""
_COLOURS = {"ok": "green", "warning": "yellow", "FAILED": "red"}


@dataclass(frozen=True, slots=True)
class ExaminedCheck:
    """One check of a bench."""

    name: str
    health: str
    """``ok``, ``warning``, ``FAILED`` or ``not looked at``."""
    found: str
    """Finding, or the reason why the check was not made."""
    remedy: str | None
    """Remedy; null if none is needed."""


@dataclass(frozen=True, slots=True)
class Examined:
    """Checks of a bench."""

    rig: str
    exit_code: int
    checks: list[ExaminedCheck]


@click.command(epilog=_EXIT_CODES)
@documented("hiltest.doctor/1")
@setting_option("rig", fallback="frdm-k64f")
@setting_option("port", fallback="the rig's, or the only board that is plugged in")
def doctor(rig: str | None, port: str | None) -> tuple[int, Examined]:
    """Diagnose a bench and suggest remedies.

    The command checks board, DAPLink, permissions, other programs, the port of a motor table, baud rate, firmware,
    sensors, clock, cycle counter, noise at rest, and the field against the World Magnetic Model. Do not move the board
    meanwhile; it takes 5 s. If a check fails, only the checks that depend on it are skipped.
    """
    from hiltest.doctor.check import exit_code
    from hiltest.doctor.examination import examine

    described = load_named_rig(rig or "frdm-k64f")
    checks = [*_print_checks(examine(described, port=port, today=datetime.now(UTC).date()))]
    code = exit_code(checks)
    results = [ExaminedCheck(check.name, check.health.value, check.finding, check.remedy or None) for check in checks]
    return code, Examined(described.name, code, results)


def _print_checks(checks: Iterable[Check]) -> Iterator[Check]:
    """Print each check as it is made, and yield it; checks that were omitted for one reason share a line."""
    left_out: list[Check] = []
    for check in checks:
        if left_out and (check.health, check.finding) != (left_out[0].health, left_out[0].finding):
            _print_left_out(left_out)
            left_out = []
        if check.health == "not looked at":
            left_out.append(check)
        else:
            word = click.style(f"{check.health:<15}", fg=_COLOURS[check.health])
            click.echo(f"{word}{check.name:<21}{legible(check.finding)}")
        if check.remedy:
            click.echo(f"{'':36}-> {legible(check.remedy)}")
        yield check
    if left_out:
        _print_left_out(left_out)


def _print_left_out(checks: list[Check]) -> None:
    names = ", ".join(check.name for check in checks)
    named = f"{names:<21}" if len(checks) == 1 else f"{names}: "
    click.echo(f"{checks[0].health:<15}{named}{legible(checks[0].finding)}")
