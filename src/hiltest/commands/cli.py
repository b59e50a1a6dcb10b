"""The command ``hiltest``; its subcommands are imported when they are called."""

from __future__ import annotations

import errno
import re
import sys
import traceback
from collections.abc import Callable, Iterator, Sequence
from difflib import get_close_matches
from importlib import import_module
from typing import Any

import click

from hiltest import __version__
from hiltest.commands.options import EXIT_CODES, print_error
from hiltest.errors import BenchError, CalibrationError, ConfigError, DeviceError, HiltestError, ProtocolError
from hiltest.processes import follow_parent, guard_output, interrupt_by_signals, lacks_resources, output_fault

_INTERRUPTED, _INTERNAL_ERROR, _USAGE_ERROR, _CUT_SHORT = 2, 3, 4, 24
_CODES = {CalibrationError: 1, ConfigError: 4, BenchError: 20, DeviceError: 20, ProtocolError: 23}
_NO_CHOICE = re.compile(r"'(?P<word>[^']*)' is not one of (?P<choices>.*)")
# Commands under the headings of the help. "fit imu" is the function fit_imu in hiltest.commands.fit_imu.
_HEADINGS = {
    "Commands": ("run", "judge", "compare", "fit", "profile", "doctor", "flash", "start", "init", "report"),
    "Judge changes": ("baseline", "bisect", "explain", "report trend", "report export"),
    "Count cycles": ("profile worst", "timing"),
    "Work with a board": ("ports", "serve", "listen", "calibrate", "log"),
    "Work with recordings": ("fit imu", "fit noise", "play", "decode"),
    "Work with an agent": ("mcp",),
    "Repeat published experiments": ("study",),
}
_COMMANDS = tuple(name for names in _HEADINGS.values() for name in names)
_LONGEST_LINE = 70
_OLD_COMMANDS = {
    "allan": "fit noise",
    "device try": "listen",
    "export": "report export",
    "fit-imu": "fit imu",
    "trend": "report trend",
    "worst": "profile worst",
}
_MEANT_COMMANDS = {"check": "run", "ci": "start", "setup": "start", "test": "run", "verify": "run"}
"""Command that a word of another tool means: it is suggested, and not run."""
_SHORT_COMMANDS = {"bench": ["run", "--page"]}
_OLD_OPTIONS = {"--hil-port": "--port", "--for": "--seconds", "--pty": ""}
"""New spelling of each option that had another one; empty for an option that is no longer needed."""


class _Commands(click.Group):
    """Commands of one word or two: a command imports only its own module."""

    def parse_args(self, context: click.Context, words: list[str]) -> list[str]:
        """Parse a command line, in which old spellings are replaced."""
        return super().parse_args(context, _replace_old_spellings(words))

    def resolve_command(
        self, context: click.Context, words: list[str]
    ) -> tuple[str | None, click.Command | None, list[str]]:
        """Return the name, the command and its arguments; a name of two words takes precedence."""
        if short := _SHORT_COMMANDS.get(words[0]):
            return words[0], self.get_command(context, short[0]), [*short[1:], *words[1:]]
        for count in (2, 1):
            name = " ".join(words[:count])
            if name in _COMMANDS:
                return name, self.get_command(context, name), words[count:]
        meant = [_MEANT_COMMANDS[words[0]]] if words[0] in _MEANT_COMMANDS else []
        nearest = meant or get_close_matches(" ".join(words[:2]), _COMMANDS, 1)
        nearest = nearest or get_close_matches(words[0], _COMMANDS, 1)
        context.fail(f"No such command {words[0]!r}." + "".join(f" Did you mean {name!r}?" for name in nearest))

    def list_commands(self, _context: click.Context) -> list[str]:
        return [name for name in _COMMANDS if " " not in name]

    def format_commands(self, context: click.Context, formatter: click.HelpFormatter) -> None:
        """Write the commands under their headings, with the first sentence of their help."""
        for heading, names in _HEADINGS.items():
            commands = {name: self.get_command(context, name) for name in names}
            with formatter.section(heading):
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
        place = name.replace(" ", "_")
        command: click.Command = getattr(import_module(f"hiltest.commands.{place}"), place)
        return command


def _replace_old_spellings(words: list[str]) -> list[str]:
    """Return a command line with the new spelling of command and options, and print a hint for each old one."""
    end = words.index("--") if "--" in words else len(words)
    arguments, rest = words[:end], words[end:]
    for old, new in _OLD_COMMANDS.items():
        if " ".join(arguments[: len(old.split())]) == old:
            click.echo(f"hint: hiltest {old} is now hiltest {new}", err=True)
            arguments[: len(old.split())] = new.split()
    renamed = []
    for word in arguments:
        option, equals, value = word.partition("=")
        new = _OLD_OPTIONS.get(option, option)
        if new != option:
            click.echo(f"hint: {option} is now {new or 'the default: leave it out'}", err=True)
        if new or not option:
            renamed.append(new + equals + value)
    return [*renamed, *rest]


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
    for word in _COMMANDS if command is commands else command.list_commands(context):
        if (subcommand := command.get_command(context, word)) is not None:
            yield from every_command(subcommand, f"{name} {word}".strip())


def main(arguments: Sequence[str] | None = None) -> None:
    """Run the command and exit with its code; a wrong option is 4, as for pytest."""
    # click's own exit code for a wrong option is 2, which means "interrupted" here.
    command: Callable[..., Any] = commands.main
    sys.stdout, sys.stderr = guard_output(sys.stdout), guard_output(sys.stderr)
    interrupt_by_signals()
    follow_parent()
    words = list(sys.argv[1:] if arguments is None else arguments)
    as_json = "--json" in words[: words.index("--") if "--" in words else None]
    try:
        code = command(args=words, prog_name="hiltest", standalone_mode=False)
    except click.ClickException as error:
        if isinstance(error, click.UsageError) and error.ctx is not None:
            click.echo(error.ctx.get_usage(), err=True)
            click.echo(f"Try '{error.ctx.command_path} --help' for help.\n", err=True)
        message = _add_nearest_choice(error.format_message())
        click.echo(f"ERROR: {message}", err=True)
        code = _report_failure(error, message, _USAGE_ERROR, as_json=as_json)
    except HiltestError as error:
        click.echo(f"ERROR: {error}", err=True)
        code = next((code for kind, code in _CODES.items() if isinstance(error, kind)), _CUT_SHORT)
        _report_failure(error, str(error), code, as_json=as_json)
    except (click.Abort, KeyboardInterrupt) as error:
        click.echo("interrupted", err=True)
        code = _report_failure(error, "interrupted", _INTERRUPTED, as_json=as_json)
    except Exception as error:
        code, message = _unexpected_end(error)
        click.echo(f"ERROR: {message}", err=True)
        _report_failure(error, message, code, as_json=as_json)
    if (fault := output_fault(sys.stdout)) is not None:
        click.echo(f"ERROR: cannot write the output: {fault.strerror}", err=True)
        if words[:1] not in (["run"], ["bench"]):  # the result of a run is its record, and not its output
            code = _USAGE_ERROR
    sys.exit(code or 0)


def _unexpected_end(error: Exception) -> tuple[int, str]:
    """Return exit code and message of an error that no command expects; print where an internal error came from."""
    if lacks_resources(error):
        return _CUT_SHORT, f"cut short: {getattr(error, 'strerror', None) or str(error) or 'memory ran out'}"
    if isinstance(error, OSError) and error.errno == errno.ENAMETOOLONG:
        return _USAGE_ERROR, f"no file can have this name: {error.strerror}"
    traceback.print_exc()
    return _INTERNAL_ERROR, f"internal error: {type(error).__name__}: {error}"


def _add_nearest_choice(message: str) -> str:
    """Return a message about a choice, of click or of a setting, with the choice that is nearest to the given word."""
    if (match := _NO_CHOICE.search(message)) is None:
        return message
    choices = {choice.lower(): choice for choice in re.findall(r"'(.*?)'", match["choices"])}
    nearest = get_close_matches(match["word"].lower(), choices, 1)
    return message + "".join(f" Did you mean {choices[word]!r}?" for word in nearest)


def _report_failure(error: BaseException, message: str, code: int, *, as_json: bool) -> int:
    """Return the exit code; with ``--json``, print the document of an error instead of the command's."""
    if as_json:
        print_error(type(error).__name__, message, code)
    return code
