"""What several commands share: options, exit codes, files to write, and an end by Ctrl-C."""

from __future__ import annotations

import argparse
import contextlib
import math
import signal
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any, TextIO

import click

from hiltest.errors import ConfigError
from hiltest.settings import jobs, seed

EXIT_CODES = """
\b
Exit codes:
  0   every test passed and every limit holds
  1   a test failed or a limit does not hold
  2   interrupted
  3   internal error
  4   usage: an option, a port, a rig file or a firmware file is wrong
  5   no tests were collected
  20  connection lost: link, cable, board or sensor, or firmware that hangs
  21  regression: worse than the baseline by more than a tolerance
  22  not evaluated: limit not measured or baseline missing
  23  wrong firmware, or another protocol version
"""

#: Of `hiltest.units.RATE_WORDS`, which commands import when they run.
RATE_UNITS = ("deg/s", "dps", "mdps", "rad/s", "deg/h", "counts")


class NumberRange(click.FloatRange):
    """A number in a range; click's own accepts NaN."""

    def convert(self, value: Any, param: click.Parameter | None, ctx: click.Context | None) -> float:
        """Return the number."""
        number = float(super().convert(value, param, ctx))
        if math.isnan(number):
            self.fail(f"{value} is no number.", param, ctx)
        return number


def checked(check: Callable[[str], Any]) -> Callable[[click.Context, click.Parameter, str | None], str | None]:
    """Return a callback that refuses what the plugin's option of the same name would refuse."""

    def callback(_context: click.Context, _parameter: click.Parameter, text: str | None) -> str | None:
        """Return the text as it is; what the check refuses is a wrong parameter of the command."""
        if text is not None:
            try:
                check(text)
            except argparse.ArgumentTypeError as error:
                raise click.BadParameter(str(error)) from error
        return text

    return callback


def seed_range(_context: click.Context, _parameter: click.Parameter, text: str | None) -> range | None:
    """Parse ``A..B``, both ends included."""
    if text is None:
        return None
    first, dots, last = text.partition("..")
    try:
        seeds = range(seed(first), seed(last) + 1)
    except argparse.ArgumentTypeError as error:
        reason = str(error) if dots else f"{text!r} is not a range of seeds"
        raise click.BadParameter(f"{reason}; write for example 1..100") from error
    if not seeds:
        raise click.BadParameter(f"{text!r} is not a range of seeds; write for example 1..100")
    return seeds


def jobs_option(begins: str = "Processes") -> Callable[[Callable[..., Any]], Callable[..., Any]]:
    """Return the option ``--jobs``, whose value is a number or a scheduler's address; `begins` its help."""
    return click.option(
        "--jobs", metavar="J", callback=_jobs,
        help=f"{begins}, or the address of a dask scheduler, tcp://HOST:PORT.  [default: one a core]",
    )  # fmt: skip


def _jobs(_context: click.Context, _parameter: click.Parameter, text: str | None) -> int | str | None:
    try:
        return None if text is None else jobs(text)
    except argparse.ArgumentTypeError as error:
        raise click.BadParameter(str(error)) from error


class ErrorOutput:
    """Output of progress: standard error, so that standard output is the result."""

    def write(self, msg: str, *, flush: bool = False) -> None:
        """Write a text."""
        click.echo(msg, nl=False, err=True)


@contextlib.contextmanager
def opened(out: Path) -> Iterator[TextIO]:
    """Open a text file to write, or refuse its name."""
    try:
        file = out.open("w", encoding="utf-8", newline="")
    except OSError as error:
        raise ConfigError(f"cannot write {out}: {error.strerror or error}") from error
    with file:
        yield file


@contextlib.contextmanager
def asked_to_end() -> Iterator[list[int]]:
    """Return a list that gets Ctrl-C instead of its breaking in; a second one does."""
    came: list[int] = []

    def note(number: int, _frame: object) -> None:
        came.append(number)
        signal.signal(signal.SIGINT, before)

    before = signal.signal(signal.SIGINT, note)
    try:
        yield came
    finally:
        signal.signal(signal.SIGINT, before)
