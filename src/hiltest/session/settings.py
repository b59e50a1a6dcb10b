"""The plugin's options, and the source of each value.

One table has name, type and help of each option; the command line takes precedence over the environment, the
environment over the ini file, the ini file over the default. Every pytest run on the machine imports this module, so
that it uses named tuples: defining one takes a seventh of a dataclass' time.
"""

from __future__ import annotations

import argparse
import errno
import os
import re
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from shlex import quote
from typing import TYPE_CHECKING, Any, Literal, NamedTuple

if TYPE_CHECKING:  # the import takes 0.15 s, and commands that run no test do not need it
    import pytest

DEFAULT_OUT = "hil-out"
RUN_COMMAND = "hiltest-run"
"""Name of the pytest plugin of `hiltest run`, whose options have no prefix."""
LONGEST_LABEL = 100
MOST_JOBS = 1000
LONGEST_NAME = 255
"""Longest name of a file in bytes: NAME_MAX of Linux' file systems."""
_PREFIX = "HIL_"
_SCHEDULER = re.compile(r"(?:tcp|tls)://(?:\[[0-9A-Fa-f:.]+\]|[^\s/?#@:\[\]]+):(?P<port>[0-9]{1,5})", re.ASCII)


def seed(text: str) -> int:
    """Parse a seed: a whole number from 0 to 2**32 - 1.

    Raises
    ------
    argparse.ArgumentTypeError
        If it is another text.
    """
    if not text.isascii() or not text.isdigit() or len(text) > 10 or int(text) >= 2**32:
        raise argparse.ArgumentTypeError(f"{text!r} is not a seed: a whole number from 0 to 4294967295")
    return int(text)


def address(text: str) -> int:
    """Parse an address of 32 bits, in decimal or as ``0x8000``."""
    try:
        number = int(text, 0)
    except ValueError:
        number = -1
    if not 0 <= number < 1 << 32:
        raise argparse.ArgumentTypeError(f"{text!r} is not an address: write it as 0x8000")
    return number


def jobs(text: str) -> int | str:
    """Parse the value of jobs: a number of processes, or the address of a dask scheduler, which is returned unchanged.

    Raises
    ------
    argparse.ArgumentTypeError
        If it is neither.
    """
    if text.isascii() and text.isdigit() and len(text) <= len(str(MOST_JOBS)) and 1 <= int(text) <= MOST_JOBS:
        return int(text)
    match = _SCHEDULER.fullmatch(text)
    if match and 1 <= int(match["port"]) < 1 << 16:
        return text
    raise argparse.ArgumentTypeError(
        f"{text!r} is neither a number of processes, 1 to {MOST_JOBS}, nor the address of a dask scheduler, "
        "such as tcp://127.0.0.1:8786"
    )


def choice(*words: str) -> Callable[[str], str]:
    """Return a parser that accepts one of several words."""

    def parse(text: str) -> str:
        if text not in words:
            raise argparse.ArgumentTypeError(f"{text!r} is not one of {', '.join(map(repr, words))}")
        return text

    return parse


def file_name(text: str) -> str:
    """Parse the name of a file or folder, which must be neither empty nor too long for a file system."""
    if not text:
        raise argparse.ArgumentTypeError("the name is empty")
    longest = max((len(os.fsencode(part)) for part in Path(text).parts), default=0)
    if longest > LONGEST_NAME:
        raise argparse.ArgumentTypeError(
            f"a name of {longest} bytes is too long: file names have at most {LONGEST_NAME} bytes"
        )
    return text


def file_path(text: str) -> Path:
    """Parse the name of a file or folder as a path."""
    return Path(file_name(text))


def label(text: str) -> str:
    """Parse the label of a run: one short line, or nothing."""
    if not text.isprintable() or len(text) > LONGEST_LABEL:
        raise argparse.ArgumentTypeError(f"{text!r} is not a label: use one line of at most {LONGEST_LABEL} characters")
    return text


def serial_number(text: str) -> str:
    """Parse the serial number of a board, which is the name of a folder."""
    if not re.fullmatch(r"[A-Za-z0-9][A-Za-z0-9_-]{0,63}", text, re.ASCII):
        raise argparse.ArgumentTypeError(
            f"{text!r} is not a serial number: use 1 to 64 letters, digits, - and _, a letter or digit first"
        )
    return text


def make_folder(folder: Path) -> None:
    """Make the folder of a record before anything runs.

    Raises
    ------
    ConfigError
        If it cannot be made or written to.
    """
    from hiltest.errors import ConfigError

    try:
        folder.mkdir(parents=True, exist_ok=True)
        if not os.access(folder, os.W_OK | os.X_OK):
            raise PermissionError(errno.EACCES, os.strerror(errno.EACCES))
    except OSError as error:
        file = next((parent for parent in (folder, *folder.parents) if parent.is_file()), None)
        reason = f"{file} is a file" if file else error.strerror or str(error)
        raise ConfigError(f"cannot write to the folder {folder}: {reason}; name another folder with --out") from error


class Option(NamedTuple):
    """One setting, in four places.

    It is ``--NAME`` of ``hiltest``, ``--hil-NAME`` of pytest, ``hil_NAME`` in the ini file and ``HIL_NAME`` in the
    environment.
    """

    name: str
    metavar: str
    parse: Callable[[str], Any]
    help: str
    default: str | None = None
    fallback: str = ""
    """Value of an option without default, described for the help; empty without one."""

    @property
    def flag(self) -> str:
        """Name on pytest's command line."""
        return f"--hil-{self.name}"

    def flag_in(self, config: pytest.Config) -> str:
        """Return its name on the command line that was typed: that of ``hiltest run``, or pytest's."""
        return f"--{self.name}" if config.pluginmanager.has_plugin(RUN_COMMAND) else self.flag

    def check(self, text: str) -> str:
        """Return a text unchanged, which pytest can send to its workers.

        Raises
        ------
        argparse.ArgumentTypeError
            If it cannot be parsed.
        """
        self.parse(text)
        return text

    @property
    def ini(self) -> str:
        """Name in the ini file."""
        return f"hil_{self.name}"

    @property
    def variable(self) -> str:
        """Name in the environment."""
        return f"{_PREFIX}{self.name.upper()}"


OPTIONS = (
    Option(
        "rig",
        "FILE",
        file_name,
        "Use this rig: a file, or the name of a rig in hil/rigs.",
        fallback="virtual-k64f; frdm-k64f if a port is named",
    ),
    Option(
        "firmware",
        "FILE",
        file_path,
        "Run this firmware on the virtual board: ELF, Intel HEX or raw binary.",
        fallback="the packaged one",
    ),
    Option("base", "ADDRESS", address, "Load a raw binary at this address.", fallback="0, for a .bin"),
    Option(
        "port",
        "URL",
        file_name,
        "Connect to a real board: a serial device, usb://SERIAL or another pyserial URL.",
        fallback="the rig's",
    ),
    Option("out", "DIR", file_path, "Write run.json and the reports to this folder.", default=DEFAULT_OUT),
    Option("seed", "N", seed, "Set the seed of the simulated world.", fallback="the rig's"),
    Option(
        "poses",
        "all|level",
        choice("all", "level"),
        "Measure at all known angles, or only at the level ones.",
        fallback="the rig's",
    ),
    Option("suite", "gate|full", choice("gate", "full"), "Run the gate set of tests, or the full set.", default="gate"),
    Option("calibration", "FILE", file_path, "Test also this calibration file of the board (hiltest calibrate)."),
    Option("label", "TEXT", label, "Name this run in reports and trends, for example by its version."),
    Option("baseline", "FILE", file_path, "Fail if the run is worse than this baseline, or record of a run."),
    Option("coverage", "FILE", file_path, "Write the coverage of the virtual board's firmware, for LCOV's genhtml."),
    Option(
        "record",
        "FILE",
        file_path,
        "Record everything that the run asks of its bench, with the answers; compress FILE.gz.",
    ),
    Option("replay", "FILE", file_path, "Take the answers from such a recording, without board and firmware."),
)
_SAME_ON_ALL_SEEDS = ("rig", "firmware", "base", "poses", "suite", "calibration", "label")


class Settings(NamedTuple):
    """Settings of a session; `sources` has the source of each value by option name."""

    rig: str | None
    firmware: Path | None
    base: int | None
    port: str | None
    out: Path
    seed: int | None
    poses: Literal["all", "level"] | None
    suite: Literal["gate", "full"]
    calibration: Path | None
    label: str | None
    baseline: Path | None
    coverage: Path | None
    record: Path | None
    replay: Path | None
    sources: Mapping[str, str]

    def as_run_options(self) -> str:
        """Return the options of ``hiltest run`` for the same run on other seeds, as on a command line."""
        named = (name for name in _SAME_ON_ALL_SEEDS if self.sources[name] != "default")
        return _join_options({name: getattr(self, name) for name in named})


def run_options(options: Sequence[str]) -> str:
    """Return the options of ``hiltest run`` for the same run on other seeds, from pytest's options."""
    parser = argparse.ArgumentParser(add_help=False, allow_abbrev=False)
    for option in OPTIONS:
        if option.name in _SAME_ON_ALL_SEEDS:
            parser.add_argument(option.flag, dest=option.name)
    values, _ = parser.parse_known_args(options)
    return _join_options(vars(values))


def _join_options(values: Mapping[str, object]) -> str:
    return " ".join(f"--{name} {quote(str(value))}" for name, value in values.items() if value is not None)


def check_environment() -> None:
    """Refuse an unknown variable with the prefix of hiltest.

    Raises
    ------
    ConfigError
        If a variable is unknown; the message has the nearest known name.
    """
    from hiltest.errors import UnknownKeyError

    variables = [option.variable for option in OPTIONS]
    for name in sorted(os.environ):
        if name.startswith(_PREFIX) and name not in variables:
            raise UnknownKeyError(name, where="the environment", known=variables)


def add_options(parser: pytest.Parser) -> None:
    """Add every option and its ini twin to pytest's parser."""
    group = parser.getgroup("hiltest", "hardware-in-the-loop (each also as ini hil_NAME and environment HIL_NAME)")
    for option in OPTIONS:
        default = option.default or option.fallback
        text = f"{option.help}  (default: {default})" if default else option.help
        group.addoption(option.flag, metavar=option.metavar, type=option.check, default=None, help=text)
        parser.addini(option.ini, type="string", default=None, help=f"same as {option.flag}")


def resolve(config: pytest.Config) -> Settings:
    """Resolve every setting.

    Raises
    ------
    pytest.UsageError
        If the environment or the ini file has a value that the option does not accept.
    """
    values: dict[str, Any] = {}
    sources: dict[str, str] = {}
    for option in OPTIONS:
        values[option.name], sources[option.name] = _resolve_one(option, config)
    for name in ("out", "coverage", "record", "replay"):
        if values[name] is not None:
            values[name] = config.invocation_params.dir / values[name]
    return Settings(**values, sources=sources)


def _resolve_one(option: Option, config: pytest.Config) -> tuple[Any, str]:
    value = config.getoption(option.flag)
    if value is not None:
        return option.parse(value), option.flag_in(config)
    for text, source in ((os.environ.get(option.variable), option.variable), (config.getini(option.ini), option.ini)):
        if text:
            try:
                return option.parse(str(text)), source
            except argparse.ArgumentTypeError as error:
                import pytest

                raise pytest.UsageError(f"{source}: {error}") from None
    return None if option.default is None else option.parse(option.default), "default"


def setting(name: str) -> Option:
    """Return the option of a name."""
    return next(option for option in OPTIONS if option.name == name)
