"""Calibrations from points of a disturbed field, and their recovery afterwards."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from hiltest.boards.board import Board
from hiltest.calibration.fit import MagnetometerFit
from hiltest.calibration.quality import residual_percent
from hiltest.errors import BenchError
from hiltest.link.streams import StreamReset
from hiltest.procedures.calibrate import calibrate_once
from hiltest.procedures.cycles import upload_pairs
from hiltest.procedures.driving import DISTURBED_UT
from hiltest.procedures.progress import Progress, silent
from hiltest.procedures.streams import StreamStage, feed, stage
from hiltest.procedures.tumble import Tumble, collect_tumble
from hiltest.procedures.turntables import Turntable

# Number of tumbles in a longer disturbance, and after its end. A solver of the firmware that runs once per 750 points
# runs once and twice in these, of 300 points each.
_MOST_TUMBLES = 4
_TUMBLES_AFTER = 6
_LOOK_S = 0.1
_PATIENCE_S = 600.0


@dataclass(frozen=True, slots=True, eq=False)
class DrivenStage:
    """Result of a streaming calibrator at the end of a tumble."""

    disturbed: bool
    """True if the field was disturbed when the tumble began."""
    time_s: float
    """Time since the start of the disturbance, or since its end."""
    stage: StreamStage


@dataclass(frozen=True, slots=True, eq=False)
class DrivenCalibrations:
    """Calibrations from points of a disturbed field."""

    fit: MagnetometerFit
    """Calibration from the first points of the first disturbed tumble."""
    residual_percent: float
    """Its heading errors."""
    begun_before: Mapping[str, list[DrivenStage]]
    """Stages of each streaming calibrator that received an undisturbed tumble first, one per later tumble."""
    begun_disturbed: Mapping[str, list[DrivenStage]]
    """Stages of each streaming calibrator that started with the disturbed tumbles."""


class _TimedTumble(NamedTuple):
    """A tumble, whether its field was disturbed, and its end since the disturbance began or ended [s]."""

    tumble: Tumble
    disturbed: bool
    time_s: float


def calibrate_while_driving(
    board: Board,
    turntable: Turntable,
    *,
    tumble: Tumble,
    calibrator: str,
    n: int,
    progress: Progress | None = None,
) -> DrivenCalibrations:
    """Tumble a virtual board while its field is disturbed, and again when that is over.

    Parameters
    ----------
    board
        Board whose buffer holds an undisturbed tumble, which is restored afterwards.
    tumble
        Undisturbed tumble in the board's buffer.
    calibrator
        Calibrator for the first n points of the first disturbed tumble.

    Returns
    -------
    DrivenCalibrations
        Results; the streaming calibrators receive the same points twice, once after those of the undisturbed tumble.

    Raises
    ------
    BenchError
        When no disturbance starts within ten minutes, or none ends.
    """
    tell = progress or silent
    steps = _MOST_TUMBLES + _TUMBLES_AFTER + 2
    tumbles: list[_TimedTumble] = []

    def take(began_s: float, *, disturbed: bool) -> None:
        tell("driving, calibrations", len(tumbles), steps)
        collected = collect_tumble(board, turntable, points=len(tumble.points))
        tumbles.append(_TimedTumble(collected, disturbed, board.now_s() - began_s))

    began_s = _wait(board, disturbed=True)
    take(began_s, disturbed=True)
    fit, _ = calibrate_once(board, calibrator, n)
    while is_disturbed(board) and len(tumbles) < _MOST_TUMBLES:
        take(began_s, disturbed=True)
    ended_s = _wait(board, disturbed=False)
    for _ in range(_TUMBLES_AFTER):
        take(ended_s, disturbed=False)
    tell("driving, calibrations", steps - 2, steps)
    begun_disturbed = _stream_tumbles(board, tumbles)
    tell("driving, calibrations", steps - 1, steps)
    begun_before = _stream_tumbles(board, [_TimedTumble(tumble, False, 0.0), *tumbles])
    upload_pairs(board, tumble.points, tumble.accelerometer)
    tell("driving, calibrations", steps, steps)
    return DrivenCalibrations(
        fit,
        residual_percent(tumbles[0].tumble.points[:n], fit),
        {name: stages[1:] for name, stages in begun_before.items()},
        begun_disturbed,
    )


def _stream_tumbles(board: Board, tumbles: Sequence[_TimedTumble]) -> dict[str, list[DrivenStage]]:
    """Feed the points to the streaming calibrators in the order of time, and read their results after each tumble."""
    by_name: dict[str, list[DrivenStage]] = {name: [] for name in board.identity.stream_calibrators}
    for name in by_name:
        board.session.request(StreamReset(name))
    for entry in tumbles:
        in_time = np.argsort(entry.tumble.taken)
        upload_pairs(board, entry.tumble.points[in_time], entry.tumble.accelerometer[in_time])
        for name, stages in by_name.items():
            feed(board, name, 0, len(in_time))
            stages.append(DrivenStage(entry.disturbed, entry.time_s, stage(board, name, len(in_time))))
    return by_name


def is_disturbed(board: Board) -> bool:
    """Return whether the field of a virtual board is disturbed now."""
    table, now_s = board.stage, board.virtual_seconds
    if table is None or now_s is None:
        raise BenchError("disturbances of the field are known only for a virtual board")
    fields_ut = board.true_disturbances_ut(round(1e6 * (now_s - table.firmware_clock_began_s))) or {}
    return any(float(np.linalg.norm(field_ut)) > DISTURBED_UT for field_ut in fields_ut.values())


def _wait(board: Board, *, disturbed: bool) -> float:
    """Let time pass until the field is disturbed, or undisturbed; return that time by the board's clock [s]."""
    began_s = board.now_s()
    while is_disturbed(board) is not disturbed:
        if board.now_s() > began_s + _PATIENCE_S:
            raise BenchError(
                f"the field of this world is {'not ' * disturbed}disturbed for {_PATIENCE_S:g} s on end: calibrating "
                "while driving needs a disturbance that begins after the filter's run, and that ends"
            )
        board.sleep(_LOOK_S)
    return board.now_s()
