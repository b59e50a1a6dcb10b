"""``hiltest play``: play a rig's recording to firmware, and compare its results with hiltest's calibrators."""

from __future__ import annotations

import sys
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING

import click

from hiltest.commands.options import (
    ErrorOutput,
    NumberRange,
    json_option,
    load_named_rig,
    print_document,
    setting_option,
)
from hiltest.errors import ConfigError

if TYPE_CHECKING:
    import numpy as np
    from numpy.typing import NDArray

    from hiltest.procedures.recorded_motion import Played
    from hiltest.world.recorded_motion import Playback

_EXIT_CODES = """
\b
Exit codes:
  0   played; the results are shown without a verdict
  2   interrupted
  4   usage: an option, a rig file, a recording or a firmware file is wrong
  20  the firmware does not answer
  23  wrong firmware
"""
# Number of headings over a recording without --every.
_MOMENTS = 12
_MOST_MOMENTS = 10_000


@click.command(epilog=_EXIT_CODES)
@setting_option("rig", required=True)
@setting_option("firmware", fallback="the rig's, else the packaged one")
@click.option(
    "--recording",
    metavar="FILE",
    type=click.Path(exists=True, dir_okay=False, path_type=Path),
    help="Play this recording.  [default: the rig's, world.playback]",
)
@click.option(
    "--every",
    "every_s",
    metavar="SECONDS",
    type=NumberRange(min=0.1, max=3600.0),
    help="Compute a heading at this interval.  [default: twelve over the recording]",
)
@json_option("hiltest.play/1")
def play(rig: str, firmware: Path | None, recording: Path | None, every_s: float | None, as_json: bool) -> int:
    """Play a recording to firmware, and compare its results.

    The results are hard iron, field, fit error and headings. The sensors of a virtual board measure the recorded
    motion. If the rig's firmware does not speak hiltest's protocol, hiltest's firmware gets the same recording, and the
    results of its calibrators are shown beside. A recording with true attitudes is calibrated: hiltest's firmware
    follows it with its filter, and the errors are shown. There is no verdict: see docs/playback.md.
    """
    from hiltest.interfaces.sensor_files.recorded_motion import load_playback
    from hiltest.procedures.recorded_motion import follow_recording, play_back
    from hiltest.session.progress_line import ProgressLine
    from hiltest.world.recorded_motion import Sensed

    described = load_named_rig(rig)
    if recording is not None and described.world is not None:
        described = described.playing(recording)
    playback = load_playback(described)
    if playback is None:
        raise ConfigError(
            f"{described.where('world')}: the rig has no recording: name one with --recording, or under [world], "
            'playback = "field.csv"'
        )
    magnetometer = playback.tracks.get(Sensed.MAGNETOMETER)
    if magnetometer is None:
        raise ConfigError(
            f"{described.where('world', 'playback')}: world.playback: {playback.name} has no magnetometer "
            "to calibrate: use it with hiltest log, hiltest listen or hiltest serve"
        )
    if not as_json:
        click.echo(playback.described())
    progress = ProgressLine(ErrorOutput(), shown=sys.stderr.isatty())
    if playback.motion:
        played = follow_recording(described, firmware=firmware, progress=progress)
    else:
        moments_s = _moments_s(playback, every_s)
        played = play_back(
            described,
            playback.described(),
            magnetometer.times_s,
            moments_s,
            begins_s=playback.begins_s,
            firmware=firmware,
            progress=progress,
        )
    if as_json:
        print_document("hiltest.play/1", played)
        return 0
    tables = _attitudes(played) if played.attitudes else [*_calibrations(played), "", *_headings(played)]
    click.echo("\n".join(["", *tables]))
    for remark in played.remarks:
        click.echo(remark, err=True)
    return 0


def _moments_s(playback: Playback, every_s: float | None) -> NDArray[np.float64]:
    """Return the times of headings; empty without an accelerometer, which they need."""
    import numpy as np

    from hiltest.world.recorded_motion import Sensed

    if Sensed.ACCELEROMETER not in playback.tracks:
        return np.empty(0)
    takes_s = playback.ends_s - playback.begins_s
    step_s = takes_s / _MOMENTS if every_s is None else every_s
    if takes_s / step_s > _MOST_MOMENTS:
        raise ConfigError(f"--every {step_s:g} is more than {_MOST_MOMENTS} headings over {takes_s:.0f} s")
    steps = np.arange(1, int(takes_s / step_s * (1.0 + 1e-9)) + 1, dtype=np.float64)
    return playback.begins_s + step_s * steps


def _calibrations(played: Played) -> list[str]:
    """Return the table of calibrations, one column each."""
    from hiltest.text import format_number

    def axis(number: int) -> list[str]:
        return ["-" if row.hard_iron_ut is None else f"{row.hard_iron_ut[number]:.1f}" for row in played.found]

    def rounded(values: Sequence[float | None], digits: int) -> list[str]:
        return ["-" if value is None else f"{value:.{digits}f}" for value in values]

    return _table(
        [
            ["", *(row.name for row in played.found)],
            *([f"hard iron {name} [uT]", *axis(number)] for number, name in enumerate("xyz")),
            ["field strength [uT]", *rounded([row.field_ut for row in played.found], 1)],
            ["error of its fit, as it says [%]", *rounded([row.said_error_percent for row in played.found], 1)],
            [
                f"residual over the same {played.points} points [%]",
                *rounded([row.residual_percent for row in played.found], 1),
            ],
            ["cycles", *(format_number(row.cycles) for row in played.found)],
        ]
    )


def _headings(played: Played) -> list[str]:
    """Return the table of headings, one row per moment of the recording."""
    if not played.moments_s:
        return ["no headings: the recording has no accelerometer"]
    named = [row for row in played.found if row.heading_deg]
    return _table(
        [
            ["heading [deg] at", *(row.name for row in named)],
            *(
                [
                    f"{moment_s:.2f} s",
                    *("-" if heading is None else f"{heading:.1f}" for heading in row),
                ]
                for moment_s, *row in zip(played.moments_s, *(row.heading_deg for row in named), strict=True)
            ),
        ]
    )


def _attitudes(played: Played) -> list[str]:
    """Return the table of errors against true attitudes."""
    rows = [
        [
            f"{row.name}, {row.phase}",
            *(f"{error:.2f}" for error in (row.total_deg, row.heading_deg, row.inclination_deg)),
        ]
        for row in played.attitudes
    ]
    return _table([["error of the attitude [deg rms]", "total", "heading", "inclination"], *rows])


def _table(rows: Sequence[Sequence[str]]) -> list[str]:
    widths = [max(map(len, column)) for column in zip(*rows, strict=True)]
    return [
        "  ".join([first.ljust(widths[0]), *(cell.rjust(width) for cell, width in zip(rest, widths[1:], strict=True))])
        for first, *rest in rows
    ]
