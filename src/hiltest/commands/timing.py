"""``hiltest timing``: show or measure the cycle costs of the virtual board, and their sources."""

from __future__ import annotations

import os
import sys
from dataclasses import dataclass
from datetime import date
from pathlib import Path
from typing import TYPE_CHECKING

import click

from hiltest.commands.options import (
    ErrorOutput,
    documented,
    json_option,
    load_named_rig,
    print_document,
    setting_option,
)
from hiltest.errors import ConfigError

if TYPE_CHECKING:
    from hiltest.boards import Board
    from hiltest.virtual.silicon.contributed_profile import MeasuredOn

_EXIT_CODES = """
\b
Exit codes:
  0   shown
  4   usage: the profile does not exist, or the file is not a timing profile
"""
_MEASURE_EXIT_CODES = """
\b
Exit codes:
  0   measured, and written
  1   the firmware has no timing sequences, or its core counts no cycles
  2   interrupted
  4   usage: an option, a port or a rig file is wrong, or the file cannot be
      written
  20  connection lost: link, cable or board
  23  wrong firmware, or another protocol version
"""
_CHECK_EXIT_CODES = """
\b
Exit codes:
  0   complete, and its rows follow from its clocks
  1   a part is missing or inconsistent; the output lists each
  4   usage: the file is not a timing profile
"""


@dataclass(frozen=True, slots=True)
class Measured:
    """A timing profile that was measured."""

    file: str
    """File that was written; ``hiltest timing show --profile FILE --json`` has its rows."""
    name: str
    """Name of the profile."""
    rows: int
    """Number of measured rows."""
    remarks: tuple[str, ...]
    """Deviations from the rules."""


@dataclass(frozen=True, slots=True)
class ProfileChecked:
    """A measured timing profile, checked before it is sent in."""

    file: str
    name: str
    """Name of the profile."""
    objections: tuple[str, ...]
    """Reasons why it cannot be accepted unchanged; empty if it can."""
    remarks: tuple[str, ...]
    """Deviations from the rules."""


@click.group()
def timing() -> None:
    """Show, measure or check the cycle costs of instructions."""


@timing.command(epilog=_EXIT_CODES)
@click.option(
    "--profile",
    "named",
    metavar="NAME|FILE",
    help="Show this timing profile, a name or a file (.toml).  [default: cortex-m4-trm/3]",
)
@click.option(
    "--part", metavar="NAME|FILE", help="Show the timing of this chip, or of a part file, at its highest clock."
)
@json_option("hiltest.timing/1")
def show(named: str | None, part: str | None, as_json: bool) -> int:
    """Print a timing profile: cycles, range and source of each row."""
    from hiltest.virtual.model.profile_file import DEFAULT_PROFILE, load_profile, place_of
    from hiltest.virtual.part.part_file import load_part
    from hiltest.virtual.profiling.timing_table import print_table, timing_document

    if part is not None:
        if named is not None:
            raise click.UsageError("--profile and --part exclude each other: leave one of them out")
        chip = load_part(part)
        profile, file = chip.timing(), chip.file
    else:
        profile, file = load_profile(named or DEFAULT_PROFILE), place_of(named or DEFAULT_PROFILE)
    if as_json:
        print_document("hiltest.timing/1", timing_document(profile, file))
        return 0
    from hiltest.report.console import standard_output

    print_table(standard_output(), profile, file)
    return 0


@timing.command(epilog=_MEASURE_EXIT_CODES)
@documented("hiltest.timing-measure/1")
@setting_option("port")
@setting_option("rig")
@click.option(
    "--out",
    metavar="FILE",
    type=click.Path(dir_okay=False, path_type=Path),
    help="Write the profile to this file; an earlier profile of this board is replaced.  "
    "[default: silicon-<board id>.toml, for a virtual board virtual-<board id>.toml]",
)
def measure(port: str | None, rig: str | None, out: Path | None) -> tuple[int, Measured]:
    """Time instructions on a board and write its timing profile.

    The firmware runs sequences of one kind of instruction, from SRAM and from flash, and needs only its cycle counter,
    neither sensors nor a turntable. The measurement takes some seconds.
    """
    from hiltest.boards import open_board
    from hiltest.boards.bench import default_firmware
    from hiltest.procedures.sequences import measure_sequences
    from hiltest.report.console import standard_output
    from hiltest.run_record.files import write_asked_for
    from hiltest.session.progress_line import ProgressLine
    from hiltest.virtual.profiling.timing_table import print_judgements, print_measured, print_places
    from hiltest.virtual.program.elf import load_image
    from hiltest.virtual.silicon.contributed_profile import about, board_lines
    from hiltest.virtual.silicon.measured_profile import profile_text, solve

    with open_board(load_named_rig(rig), port=port) as board:
        name = _name(board)
        file = out or Path(f"{name}.toml")
        measured_on = _measured_on(board, _manual_fields(file, name))
        clocks_by_place = measure_sequences(board, progress=ProgressLine(ErrorOutput(), shown=sys.stderr.isatty()))
    raw = {place.name.lower(): clocks for place, clocks in clocks_by_place.items()}
    measured = solve(raw["sram"], about(measured_on), load_image(default_firmware()))
    write_asked_for(file, profile_text(name, measured, raw, board_lines(measured_on)))
    print_measured(standard_output(), measured)
    print_judgements(standard_output(), measured.judgements)
    print_places(standard_output(), raw)
    click.echo(f"{file}: {name}, {len(measured.rows)} rows")
    return 0, Measured(str(file), name, len(measured.rows), measured.remarks)


@timing.command(epilog=_CHECK_EXIT_CODES)
@documented("hiltest.timing-check/1")
@click.argument("file", type=click.Path(dir_okay=False, path_type=Path))
def check(file: Path) -> tuple[int, ProfileChecked]:
    """Check a measured profile before it is sent in.

    FILE is the output of measure for a real board, completed with the board's name and revision and your signature.
    Its rows are solved again from its clocks.
    """
    from hiltest.boards.bench import default_firmware
    from hiltest.link.sequences import SEQUENCES
    from hiltest.virtual.program.elf import load_image
    from hiltest.virtual.silicon.contributed_profile import check

    result = check(file, load_image(default_firmware()), SEQUENCES)
    for objection in result.objections:
        click.echo(f"{file}: {objection}")
    for remark in result.remarks:
        click.echo(f"{file}: remark: {remark}")
    if not result.objections and result.board:
        click.echo(
            f"{file}: {result.board.name} {result.board.revision}, signed off by {result.board.signed_off_by}: "
            "complete, and its rows follow from its clocks"
        )
    return int(bool(result.objections)), ProfileChecked(str(file), result.name, result.objections, result.remarks)


def _measured_on(board: Board, by_hand: dict[str, str]) -> MeasuredOn:
    """Return the properties of a measured board and of its firmware."""
    from hiltest.virtual.silicon.contributed_profile import MeasuredOn

    identity = board.identity
    return MeasuredOn(
        **({"name": "", "revision": "", "signed_off_by": ""} | by_hand),
        unique_id=identity.unique_id.hex(),
        core_clock_hz=identity.core_clock_hz,
        firmware=f"{identity.name} {identity.version}",
        build_id=identity.build_id,
        compiler=identity.compiler,
        date=date.today().isoformat(),
    )


def _manual_fields(file: Path, name: str) -> dict[str, str]:
    """Return the manually filled fields of an earlier measurement of this board, whose file will be replaced.

    Raises
    ------
    ConfigError
        If the file has other content; a device can be written to.
    """
    from hiltest.virtual.model.profile_file import measured_file
    from hiltest.virtual.silicon.contributed_profile import filled_in

    if not os.path.isfile(file):
        return {}
    try:
        content, stored_name, _ = measured_file(file)
    except ConfigError:
        content, stored_name = {}, ""
    if "measured" not in content or stored_name != name:
        raise ConfigError(
            f"{file} exists, is not a measured profile {name}, and is not overwritten; remove it, or name another "
            "file with --out"
        )
    return filled_in(content)


def _name(board: Board) -> str:
    """Name a board's profile after its chip; a board without one is not called silicon."""
    from hiltest.boards.real import is_silicon

    kind = "silicon" if is_silicon(board.identity.unique_id) else "virtual"
    return f"{kind}-{board.identity.unique_id.hex()}"
