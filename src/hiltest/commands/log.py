"""``hiltest log``: record samples of a board's sensors to a CSV file."""

from __future__ import annotations

import sys
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, TextIO

import click

from hiltest.commands.options import (
    ErrorOutput,
    NumberRange,
    documented,
    load_named_rig,
    opened,
    setting_option,
)
from hiltest.processes import asked_to_end

if TYPE_CHECKING:
    from hiltest.boards import Board
    from hiltest.link.replies import SensorKind
    from hiltest.procedures.sensor_log import LogPart

_INTERRUPTED = 2
_EXIT_CODES = """
\b
Exit codes:
  0   logged for the requested time
  2   ended by Ctrl-C; the file has all samples until then
  4   usage: an option, a port, a rig file or a firmware file is wrong
  20  connection lost: link, cable, board or sensor; the file has all
      samples until then
  23  wrong firmware, or another protocol version
"""


@dataclass(frozen=True, slots=True)
class Logged:
    """Samples that were logged."""

    file: str
    """File that was written."""
    samples: dict[str, int]
    """Number of samples by sensor."""
    lost: int
    """Number of gaps in the samples of the gyroscope."""
    ended_early: bool
    """True if Ctrl-C ended the log."""


@click.command(epilog=_EXIT_CODES)
@documented("hiltest.log/1")
@click.option(
    "--seconds",
    metavar="N",
    type=NumberRange(min=0.0, max=1e9, min_open=True),
    required=True,
    help="Record for this time by the board's clock.",
)
@click.option(
    "--out", metavar="FILE", required=True, type=click.Path(dir_okay=False, path_type=Path), help="Write this CSV file."
)
@click.option(
    "--sensor",
    "sensors",
    multiple=True,
    default=["gyroscope"],
    show_default=True,
    type=click.Choice(["gyroscope", "accelerometer", "magnetometer"]),
    help="Log this sensor; repeat the option for several.",
)
@setting_option("rig")
@setting_option("port")
@setting_option("firmware")
@setting_option("seed")
def log(
    seconds: float,
    out: Path,
    sensors: Sequence[str],
    rig: str | None,
    port: str | None,
    firmware: Path | None,
    seed: int | None,
) -> tuple[int, Logged]:
    """Record the sensors of a board to a CSV file.

    The file has every sample of the gyroscope, with the board's time. Samples of accelerometer and magnetometer between
    two requests are missing. Ctrl-C ends the log. Read it with hiltest fit noise.
    """
    from hiltest.boards import open_board
    from hiltest.link.replies import SensorKind
    from hiltest.procedures.sensor_log import log_sensors

    kinds = [SensorKind[name.upper()] for name in dict.fromkeys(sensors)]
    described = load_named_rig(rig)
    with (
        asked_to_end() as ending,
        open_board(described, firmware=firmware, port=port, seed=seed) as board,
        opened(out) as file,
    ):
        counts = _write(file, board, kinds, log_sensors(board, kinds, seconds=seconds), seconds, ending)
    words = ", ".join(f"{counts[kind]} of the {kind.name.lower()}" for kind in kinds)
    _print_playback_warnings(board)
    click.echo(f"{out}: {words}" + (f"; {counts[None]} times samples were lost" if counts[None] else ""))
    samples = {kind.name.lower(): counts[kind] for kind in kinds}
    return _INTERRUPTED if ending else 0, Logged(str(out), samples, counts[None], bool(ending))


def _print_playback_warnings(board: Board) -> None:
    for sentence in board.stage.said_of_playback if board.stage else ():
        click.echo(sentence, err=True)


def _write(
    file: TextIO,
    board: Board,
    kinds: Sequence[SensorKind],
    parts: Iterator[LogPart],
    seconds: float,
    ending: list[int],
) -> dict[SensorKind | None, int]:
    """Write the rows; return the number of samples by sensor, and under None the number of times some were lost."""
    from hiltest.procedures.sensor_log import UNITS
    from hiltest.session.progress_line import ProgressLine

    counts: dict[SensorKind | None, int] = dict.fromkeys([*kinds, None], 0)
    progress = ProgressLine(ErrorOutput(), shown=sys.stderr.isatty())
    names = [f"{kind.name.lower()}_{axis}_{UNITS[kind][0]}" for kind in kinds for axis in "xyz"]
    # A recording of a virtual board can be played back at its own times, which need a beginning.
    began = f"clock began {board.stage.firmware_clock_began_s:.9f} s after power-on, " if board.stage else ""
    file.write(
        f"# hiltest log: {board.description}, {began}body frame, uncalibrated; die temperature of the row's sensor\n"
    )
    file.write(",".join(["time_s", *names, "temperature_degc"]) + "\n")
    begin_s: float | None = None
    last_s = 0.0
    for part in parts:
        if part.rows[0].time_s < last_s:
            board.session.refuse_reset()
        last_s = part.rows[-1].time_s
        counts[None] += part.lost
        lines = ["# samples of the gyroscope are missing here\n"] if part.lost else []
        for row in part.rows:
            counts[row.kind] += 1
            cells = [",".join(f"{value:.7g}" for value in row.values) if kind is row.kind else ",," for kind in kinds]
            lines.append(f"{row.time_s:.6f},{','.join(cells)},{row.temperature_degc}\n")
        file.write("".join(lines))
        file.flush()
        begin_s = part.rows[0].time_s if begin_s is None else begin_s
        progress("seconds logged", min(int(part.rows[-1].time_s - begin_s), int(seconds)), max(1, int(seconds)))
        if ending:
            break
    return counts
