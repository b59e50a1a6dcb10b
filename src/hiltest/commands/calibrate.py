"""``hiltest calibrate``: calibrate the whole IMU in one guided procedure, and write one file."""

from __future__ import annotations

import os
import sys
from collections.abc import Collection
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING

import click

from hiltest.commands.options import documented, load_named_rig, setting_option
from hiltest.errors import ConfigError
from hiltest.session.operator_prompt import ask
from hiltest.text import format_number

if TYPE_CHECKING:
    from hiltest.boards import Board
    from hiltest.procedures import Turntable
    from hiltest.procedures.imu_calibration import FigureOfMerit, ImuCalibration
    from hiltest.rig import Rig

DEFAULT_FILE = "imu_calibration.json"
_EXIT_CODES = """
\b
Exit codes:
  0   calibrated; the file and the header are written
  1   the data is not sufficient for a calibration; nothing was written
  2   interrupted; nothing was written
  4   usage: an option, a port, a rig file or a firmware file is wrong
  20  connection lost: link, cable, board, sensor or operator
  23  wrong firmware, or another protocol version
"""


@click.command(epilog=_EXIT_CODES)
@documented("hiltest.imu-calibration/1")
@setting_option("rig")
@setting_option("port")
@setting_option("firmware")
@setting_option("seed")
@click.option(
    "--calibrator",
    metavar="NAME",
    default="corrected",
    show_default=True,
    help="Use this magnetometer calibrator of the firmware; dpi also uses gravity.",
)
@click.option(
    "--out",
    metavar="FILE",
    default=DEFAULT_FILE,
    show_default=True,
    type=click.Path(dir_okay=False, path_type=Path),
    help="Write the calibration to this file, a C header and a page beside it, as .h and .html.",
)
def calibrate(
    rig: str | None, port: str | None, firmware: Path | None, seed: int | None, calibrator: str, out: Path
) -> tuple[int, ImuCalibration]:
    """Calibrate the IMU of a board step by step.

    A virtual board needs no operator. If a board is turned by hand, the command asks for each step, shows progress
    and repeats refused steps. Test the file with hiltest run --calibration FILE.
    """
    from hiltest.boards import open_board
    from hiltest.procedures import DPI

    header, page = out.with_suffix(".h"), out.with_suffix(".html")
    _check_before_the_work(out, (header, page))
    described = load_named_rig(rig)
    with open_board(described, firmware=firmware, port=port, seed=seed) as board:
        available = (*board.identity.calibrators, DPI)
        if calibrator not in available:
            raise ConfigError(f"the firmware has no calibrator {calibrator!r}; it has {', '.join(available)}")
        click.echo(f"{board.description}; rig {described.name} ({described.path})")
        calibration = _calibrate_guided(board, described, calibrator)
    _write(calibration, out, header, page)
    click.echo(f"{out}, {header}, {page}")
    return 0, calibration


def _check_before_the_work(out: Path, others: Collection[Path]) -> None:
    """Check that the file can be written, before an operator turns the board for minutes."""
    if out in others:
        raise ConfigError(
            f"{out} would be the C header or the page: give the calibration file another name, such as "
            f"{out.with_suffix('.json')}"
        )
    folder = out.absolute().parent
    if not folder.is_dir():
        raise ConfigError(f"cannot write {out}: the folder {folder} does not exist")
    if not os.access(folder, os.W_OK | os.X_OK):
        raise ConfigError(f"cannot write {out}: the folder {folder} is read-only")


def _calibrate_guided(board: Board, rig: Rig, calibrator: str) -> ImuCalibration:
    from hiltest.procedures import open_table
    from hiltest.procedures.imu_calibration.guided import calibrate_imu
    from hiltest.run_record.run import utc_now
    from hiltest.session.progress_line import ProgressLine, TextOutput

    progress = ProgressLine(TextOutput(sys.stdout), shown=sys.stdout.isatty())
    table = open_table(board, rig, prompt=partial(ask, is_turn=True))
    try:
        return calibrate_imu(
            board,
            table,
            rig,
            guide=_TerminalGuide(table),
            made_utc=utc_now(),
            calibrator=calibrator,
            progress=progress,
        )
    finally:
        progress.clear()
        table.close()


def _write(calibration: ImuCalibration, out: Path, header: Path, page: Path) -> None:
    """Write the files, the calibration file last, so that it never exists without its header."""
    from hiltest.procedures.imu_calibration.calibration_file import to_header, to_json
    from hiltest.report.page import render
    from hiltest.run_record.files import write_asked_for

    parts = [part for part in (calibration.magnetometer, calibration.accelerometer, calibration.gyroscope) if part]
    write_asked_for(page, render("calibration.html.j2", calibration=calibration, parts=parts, number=format_number))
    write_asked_for(header, to_header(calibration))
    write_asked_for(out, to_json(calibration))


class _TerminalGuide:
    """Writes the next step to standard output, and asks the operator."""

    def __init__(self, turntable: Turntable) -> None:
        self._turntable = turntable

    def begin(self, step: int, of: int, action: str) -> None:
        click.echo(f"{step} of {of}: {action}")

    def found(self, part: str, method: str, figures: tuple[FigureOfMerit, ...]) -> None:
        words = ", ".join(f"{figure.name} {format_number(figure.value)} {figure.unit}".rstrip() for figure in figures)
        click.echo(f"   {part} by {method}: {words}")

    def again(self, why: str) -> bool:
        return self._turntable.again(f"   {why}")
