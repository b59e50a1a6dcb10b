"""The command ``hiltest``; its subcommands are imported when they are called."""

from __future__ import annotations

import errno
import io
import sys
from collections.abc import Callable, Iterator, Sequence
from importlib import import_module
from typing import Any

import click

from hiltest import __version__
from hiltest.commands.options import ERROR_SCHEMA, EXIT_CODES, print_document
from hiltest.errors import BenchError, ConfigError, HiltestError, ProtocolError

_FAILED, _INTERRUPTED, _USAGE_ERROR = 1, 2, 4
_CODES = {ConfigError: _USAGE_ERROR, BenchError: 20, ProtocolError: 23}
_OUTPUT_ERRORS = {errno.ENOSPC: "cannot write the output", errno.ENAMETOOLONG: "no file can have this name"}
# Groups in the order of the help. Each command is a function in a module of the same name in hiltest.commands.
_GROUPS = {
    "Run and judge": ("run", "compare", "baseline", "bisect", "trend", "report", "export"),
    "Firmware": ("profile", "worst", "timing"),
    "Bench": ("ports", "doctor", "flash", "init", "device", "serve", "calibrate", "log"),
    "Recordings": ("fit", "fit-imu", "allan", "decode", "play"),
    "Papers": ("study",),
}
_COMMANDS = tuple(name for names in _GROUPS.values() for name in names)
_LONGEST_LINE = 70
_OLD_OPTIONS = {"--hil-port": "--port"}
"""New spelling of each option that had another one."""


class _Commands(click.Group):
    """Subcommands by name: a command imports only its own module."""

    def parse_args(self, context: click.Context, words: list[str]) -> list[str]:
        """Parse a command line, in which old spellings are replaced."""
        return super().parse_args(context, _replace_old_options(words))

    def list_commands(self, _context: click.Context) -> list[str]:
        return list(_COMMANDS)

    def format_commands(self, context: click.Context, formatter: click.HelpFormatter) -> None:
        """Write the commands in groups, with the first sentence of their help."""
        for title, names in _GROUPS.items():
            commands = {name: self.get_command(context, name) for name in names}
            with formatter.section(title):
                formatter.write_dl(
                    [
                        (f"{name:<{len(max(_COMMANDS, key=len))}}", command.get_short_help_str(limit=_LONGEST_LINE))
                        for name, command in commands.items()
                        if command
                    ]
                )

    def get_command(self, _context: click.Context, name: str) -> click.Command | None:
        if name not in _COMMANDS:
            return None
        place = name.replace("-", "_")
        command: click.Command = getattr(import_module(f"hiltest.commands.{place}"), place)
        return command


def _replace_old_options(words: list[str]) -> list[str]:
    """Return a command line with the new spelling of each option, and print a hint for each old one."""
    end = words.index("--") if "--" in words else len(words)
    renamed = []
    for word in words[:end]:
        option, *value = word.split("=", 1)
        if new := _OLD_OPTIONS.get(option):
            click.echo(f"hint: {option} is now {new}", err=True)
        renamed.append("=".join([new or option, *value]))
    return [*renamed, *words[end:]]


@click.group(
    cls=_Commands,
    epilog=EXIT_CODES,
    context_settings={"help_option_names": ["-h", "--help"], "max_content_width": 110},
)
@click.version_option(__version__, prog_name="hiltest")
def commands() -> None:
    """Hardware-in-the-loop tests for compass and IMU calibration firmware."""


def every_command(command: click.Command = commands, name: str = "") -> Iterator[tuple[str, click.Command]]:
    """Yield name, without ``hiltest``, and command of each subcommand that is no group."""
    if not isinstance(command, click.Group):
        yield name, command
        return
    context = click.Context(command)
    for word in command.list_commands(context):
        if (subcommand := command.get_command(context, word)) is not None:
            yield from every_command(subcommand, f"{name} {word}".strip())


def main(arguments: Sequence[str] | None = None) -> None:
    """Run the command and exit with its code; a wrong option is 4, as for pytest."""
    # click's own exit code for a wrong option is 2, which means "interrupted" here.
    command: Callable[..., Any] = commands.main
    for stream in (sys.stdout, sys.stderr):
        if isinstance(stream, io.TextIOWrapper):  # a file's name may not be encodable
            stream.reconfigure(errors="backslashreplace")
    words = list(sys.argv[1:] if arguments is None else arguments)
    as_json = "--json" in words[: words.index("--") if "--" in words else None]
    try:
        code = command(args=words, prog_name="hiltest", standalone_mode=False)
    except click.ClickException as error:
        error.show()
        code = _report_failure(error, error.format_message(), _USAGE_ERROR, as_json=as_json)
    except HiltestError as error:
        click.echo(f"ERROR: {error}", err=True)
        code = next((code for kind, code in _CODES.items() if isinstance(error, kind)), _FAILED)
        _report_failure(error, str(error), code, as_json=as_json)
    except OSError as error:
        if error.errno not in _OUTPUT_ERRORS:
            raise
        click.echo(f"ERROR: {_OUTPUT_ERRORS[error.errno]}: {error.strerror}", err=True)
        # No document is printed, since the output itself cannot be written.
        code = _USAGE_ERROR
    except (click.Abort, KeyboardInterrupt) as error:
        click.echo("interrupted", err=True)
        code = _report_failure(error, "interrupted", _INTERRUPTED, as_json=as_json)
    sys.exit(code or 0)


def _report_failure(error: BaseException, message: str, code: int, *, as_json: bool) -> int:
    """Return the exit code; with ``--json``, print the document of an error instead of the command's."""
    if as_json:
        print_document(ERROR_SCHEMA, {"error": type(error).__name__, "message": message, "exit_code": code})
    return code
