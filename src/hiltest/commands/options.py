"""Parts that several commands share: options, exit codes and files to write."""

from __future__ import annotations

import argparse
import contextlib
import functools
import io
import math
import sys
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any, TextIO

import click

from hiltest.errors import ConfigError
from hiltest.json_files import json_text
from hiltest.session.settings import file_path, jobs, seed, setting

if TYPE_CHECKING:
    from hiltest.rig import Rig

if TYPE_CHECKING:
    from _typeshed import DataclassInstance

EXIT_CODES = """
\b
Exit codes:
  0   every test passed and every limit holds
  1   a test failed or a limit does not hold
  2   interrupted
  3   internal error
  4   usage: an option, a port, a rig file or a firmware file is wrong,
      or the baseline does not exist
  5   no tests were collected
  20  connection lost: link, cable, board or sensor, or firmware that hangs
  21  regression: worse than the baseline by more than a tolerance
  22  not evaluated: limit not measured or baseline not comparable
  23  wrong firmware, or another protocol version
  24  cut short: a process was killed, or memory, files or disk space ran out
"""

_SAID_MOST = 10_000
#: Keys of `hiltest.measurement.units.RATE_WORDS`, repeated since commands import that module only when they run.
RATE_UNITS = ("deg/s", "dps", "mdps", "rad/s", "deg/h", "counts")


@dataclass(frozen=True, slots=True)
class Failed:
    """Error of any command, which replaces its document; standard error has the same text."""

    error: str
    """Class of the error, as in ``hiltest.errors``."""
    message: str
    """Description of the error, its place, and the next step."""
    exit_code: int
    """Exit code of the command."""


class NumberRange(click.FloatRange):
    """A number in a range that rejects NaN, which click's own accepts."""

    def convert(self, value: Any, param: click.Parameter | None, ctx: click.Context | None) -> float:
        """Return the number."""
        number = float(super().convert(value, param, ctx))
        if math.isnan(number):
            self.fail(f"{value} is not a number.", param, ctx)
        return number


def parsed(parse: Callable[[str], Any]) -> Callable[[click.Context, click.Parameter, Any], Any]:
    """Return a callback that parses a value, or each of several values."""

    def callback(_context: click.Context, _parameter: click.Parameter, value: Any) -> Any:
        """Return the parsed value; a value that is refused is a wrong parameter of the command."""
        try:
            if isinstance(value, tuple):
                return tuple(map(parse, value))
            return None if value is None else parse(value)
        except argparse.ArgumentTypeError as error:
            raise click.BadParameter(str(error)) from error

    return callback


def setting_option(
    name: str, *parameter: str, help: str | None = None, fallback: str | None = None, **attributes: Any
) -> Callable[[Callable[..., Any]], Callable[..., Any]]:
    """Return the option of a command for a row of `hiltest.session.settings.OPTIONS`.

    Parameters
    ----------
    parameter
        Name of the command's parameter, if it is not that of the option.
    help, fallback
        Help and description of the default, if they are not those of the row.
    attributes
        Further arguments of `click.option`.
    """
    option = setting(name)
    unset = option.default or option.fallback if fallback is None else fallback
    text = help or option.help
    return click.option(
        f"--{name}",
        *parameter,
        metavar=option.metavar,
        type=click.Path() if option.parse is file_path else str,
        callback=parsed(option.parse),
        help=text if attributes.get("required") or not unset else f"{text}  [default: {unset}]",
        **attributes,
    )


def load_named_rig(name: str | None) -> Rig:
    """Return the rig that ``--rig`` names; None stands for the default rig."""
    from hiltest.rig.bench_files import rig_file
    from hiltest.rig.rig_file import load_rig

    return load_rig(rig_file(Path.cwd(), name))


def pytest_options(values: Mapping[str, object]) -> list[str]:
    """Return options of pytest from the values of settings by name; None stands for a setting without value."""
    return [f"{setting(name).flag}={value}" for name, value in values.items() if value is not None]


def seed_range(_context: click.Context | None, _parameter: click.Parameter | None, text: str | None) -> range | None:
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


def jobs_option(begins: str = "Use this many processes") -> Callable[[Callable[..., Any]], Callable[..., Any]]:
    """Return the option ``--jobs``, whose value is a number or a scheduler's address; `begins` its help."""
    return click.option(
        "--jobs",
        metavar="J",
        callback=parsed(jobs),
        help=f"{begins}, or a dask scheduler, tcp://HOST:PORT.  [default: one per core]",
    )


def json_option(schema: str) -> Callable[[Callable[..., Any]], Callable[..., Any]]:
    """Return the option ``--json`` of a command that prints its document by itself."""
    return click.option("--json", "as_json", is_flag=True, help=f"Print JSON ({schema}) and nothing else.")


def documented(schema: str) -> Callable[[Callable[..., tuple[int, DataclassInstance]]], Callable[..., int]]:
    """Return a decorator that gives a command ``--json``.

    Such a command prints text, and returns its exit code and its document. With the option the text
    goes to standard error, and only the document to standard output.
    """

    def decorated(command: Callable[..., tuple[int, DataclassInstance]]) -> Callable[..., int]:
        @functools.wraps(command)
        def command_with_json(*, as_json: bool, **arguments: Any) -> int:
            if not as_json:
                return command(**arguments)[0]
            with contextlib.redirect_stdout(sys.stderr):
                code, document = command(**arguments)
            print_document(schema, document)
            return code

        return json_option(schema)(command_with_json)

    return decorated


def print_document(schema: str, document: DataclassInstance) -> None:
    """Print a document on standard output."""
    click.echo(json_text(document, schema))


def print_error(error: str, message: str, exit_code: int) -> None:
    """Print the document of an error on standard output."""
    print_document("hiltest.error/1", Failed(error, message, exit_code))


class CapturedErrors(io.TextIOBase):
    """Standard error, which remembers its latest output."""

    def __init__(self) -> None:
        self._to = sys.stderr
        self._text = ""

    def write(self, text: str) -> int:
        """Write a text."""
        self._text = (self._text + text)[-_SAID_MOST:]
        return self._to.write(text)

    def flush(self) -> None:
        """Flush standard error."""
        self._to.flush()

    def isatty(self) -> bool:
        """Return whether standard error is a terminal."""
        return self._to.isatty()

    def fileno(self) -> int:
        """Return the file descriptor of standard error."""
        return self._to.fileno()

    @property
    def last_words(self) -> str:
        """The last line."""
        lines = self._text.strip().splitlines()
        return lines[-1].removeprefix("ERROR: ") if lines else "no output"


class ErrorOutput:
    """Output of progress on standard error, since standard output is for the result."""

    def write(self, msg: str, *, flush: bool = False) -> None:
        """Write a text."""
        click.echo(msg, nl=False, err=True)


@contextlib.contextmanager
def opened(out: Path) -> Iterator[TextIO]:
    """Open a text file for writing, or raise an error that names it."""
    try:
        file = out.open("w", encoding="utf-8", newline="")
    except OSError as error:
        raise ConfigError(f"cannot write {out}: {error.strerror or error}") from error
    with file:
        yield file
