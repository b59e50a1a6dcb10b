"""The command ``hiltest``, whose subcommands are imported when they are called."""

from __future__ import annotations

import errno
import io
import sys
from collections.abc import Callable, Sequence
from importlib import import_module
from typing import Any

import click

from hiltest import __version__
from hiltest.commands.options import EXIT_CODES
from hiltest.errors import BenchError, ConfigError, HiltestError, ProtocolError

_FAILED, _INTERRUPTED, _USAGE_ERROR = 1, 2, 4
_CODES = {ConfigError: _USAGE_ERROR, BenchError: 20, ProtocolError: 23}
_SAID_OF_OUTPUT = {errno.ENOSPC: "cannot write the output", errno.ENAMETOOLONG: "no file can have this name"}
# In the order of the help, each with its line there, so that the help waits for the imports of no command.
# Each is a function of this name in a module of this name in hiltest.commands.
_GROUPS = {
    "Run and judge": {
        "run": "Run the suites on a board and end with a verdict.",
        "compare": "Compare runs with a baseline or an earlier run.",
        "baseline": "Keep the numbers of a run as a baseline, and accept changes.",
        "trend": "Show each measurement over the runs in a folder.",
        "report": "Render the reports of a run again.",
        "export": "Write the numbers of a run for tools that keep histories.",
    },
    "Firmware": {
        "profile": "Call one function of an ELF and show where its cycles go.",
        "timing": "Show the cycle model, or measure it on a board.",
    },
    "Bench": {
        "init": "Copy suites, rigs, benchmarks and a baseline into a folder.",
        "calibrate": "Calibrate a board's whole IMU and write one file.",
        "serve": "Put the virtual board and its turntable behind real ports.",
    },
    "Recordings": {
        "log": "Record the samples of a board at rest to a CSV file.",
        "fit": "Calibrate a magnetometer from recorded samples.",
        "fit-imu": "Calibrate accelerometer and gyroscope from a recorded log.",
        "allan": "Read random walk and bias instability off a gyroscope log.",
    },
}
_COMMANDS = tuple(name for group in _GROUPS.values() for name in group)


class _Commands(click.Group):
    """Subcommands by name: a command waits for the imports of no other."""

    def list_commands(self, _context: click.Context) -> list[str]:
        return list(_COMMANDS)

    def format_commands(self, _context: click.Context, formatter: click.HelpFormatter) -> None:
        """Write the commands group by group."""
        for title, commands_of_group in _GROUPS.items():
            with formatter.section(title):
                width = max(map(len, _COMMANDS))
                formatter.write_dl([(name.ljust(width), line) for name, line in commands_of_group.items()])

    def get_command(self, _context: click.Context, name: str) -> click.Command | None:
        if name not in _COMMANDS:
            return None
        place = name.replace("-", "_")
        command: click.Command = getattr(import_module(f"hiltest.commands.{place}"), place)
        return command


@click.group(
    cls=_Commands, epilog=EXIT_CODES,
    context_settings={"help_option_names": ["-h", "--help"], "max_content_width": 110},
)
@click.version_option(__version__, prog_name="hiltest")
def commands() -> None:
    """Hardware-in-the-loop tests for compass and IMU calibration firmware."""


def main(arguments: Sequence[str] | None = None) -> None:
    """Run the command and exit with its code; a wrong option is 4, as it is for pytest."""
    # Not click's own exit: it would leave with 2 for a wrong option, which means "interrupted" here.
    command: Callable[..., Any] = commands.main
    for stream in (sys.stdout, sys.stderr):
        if isinstance(stream, io.TextIOWrapper):  # a file's name may hold what no encoding has
            stream.reconfigure(errors="backslashreplace")
    try:
        code = command(args=arguments, prog_name="hiltest", standalone_mode=False)
    except click.ClickException as error:
        error.show()
        code = _USAGE_ERROR
    except HiltestError as error:
        click.echo(f"ERROR: {error}", err=True)
        code = next((code for kind, code in _CODES.items() if isinstance(error, kind)), _FAILED)
    except OSError as error:
        if error.errno not in _SAID_OF_OUTPUT:
            raise
        click.echo(f"ERROR: {_SAID_OF_OUTPUT[error.errno]}: {error.strerror}", err=True)
        code = _USAGE_ERROR
    except (click.Abort, KeyboardInterrupt):
        click.echo("interrupted", err=True)
        code = _INTERRUPTED
    sys.exit(code or 0)
