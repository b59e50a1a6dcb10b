"""Calibrations whose points are taken while the field is disturbed, and what becomes of them afterwards."""

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

# Of a disturbance that lasts for longer, and after its end. A solver of the firmware that runs once in 750 points runs
# once and twice in these, of 300.
_MOST_TUMBLES = 4
_TUMBLES_AFTER = 6
_LOOK_S = 0.1
_PATIENCE_S = 600.0


@dataclass(frozen=True, slots=True, eq=False)
class DrivenStage:
    """What a streaming calibrator knows at the end of a tumble."""

    disturbed: bool
    """Whether the field was disturbed when the tumble began."""
    time_s: float
    """Since the disturbance began, and once it is over since its end."""
    stage: StreamStage


@dataclass(frozen=True, slots=True, eq=False)
class DrivenCalibrations:
    """Calibrations from points of a disturbed field."""

    fit: MagnetometerFit
    """From the first points of the first tumble that was disturbed."""
    residual_percent: float
    """By these points."""
    begun_before: Mapping[str, list[DrivenStage]]
    """Of each streaming calibrator that had an undisturbed tumble first, after each tumble that followed."""
    begun_disturbed: Mapping[str, list[DrivenStage]]
    """Of each one that began with the disturbed tumbles."""


class _Taken(NamedTuple):
    """A tumble, whether its field was disturbed, and when it was over since that began or ended [s]."""

    tumble: Tumble
    disturbed: bool
    time_s: float


def calibrate_while_driving(
    board: Board, turntable: Turntable, *, tumble: Tumble, calibrator: str, n: int, progress: Progress | None = None,
) -> DrivenCalibrations:
    """Tumble a virtual board while its field is disturbed, and again when that is over.

    Parameters
    ----------
    board
        Its buffer holds an undisturbed tumble, and does so afterwards.
    tumble
        That one.
    calibrator
        Which fits the first n points of the first disturbed tumble.

    Returns
    -------
    DrivenCalibrations
        The streaming calibrators get the same points twice: once behind those of the undisturbed tumble.

    Raises
    ------
    BenchError
        When nothing disturbs the field within ten minutes, or something does for as long.
    """
    tell = progress or silent
    steps = _MOST_TUMBLES + _TUMBLES_AFTER + 2
    taken: list[_Taken] = []

    def take(began_s: float, *, disturbed: bool) -> None:
        tell("driving, calibrations", len(taken), steps)
        found = collect_tumble(board, turntable, points=len(tumble.points))
        taken.append(_Taken(found, disturbed, board.now_s() - began_s))

    began_s = _wait(board, disturbed=True)
    take(began_s, disturbed=True)
    fit, _ = calibrate_once(board, calibrator, n)
    while is_disturbed(board) and len(taken) < _MOST_TUMBLES:
        take(began_s, disturbed=True)
    ended_s = _wait(board, disturbed=False)
    for _ in range(_TUMBLES_AFTER):
        take(ended_s, disturbed=False)
    tell("driving, calibrations", steps - 2, steps)
    begun_disturbed = _stream(board, taken)
    tell("driving, calibrations", steps - 1, steps)
    begun_before = _stream(board, [_Taken(tumble, False, 0.0), *taken])
    upload_pairs(board, tumble.points, tumble.accelerometer)
    tell("driving, calibrations", steps, steps)
    return DrivenCalibrations(
        fit, residual_percent(taken[0].tumble.points[:n], fit),
        {name: stages[1:] for name, stages in begun_before.items()}, begun_disturbed,
    )


def _stream(board: Board, taken: Sequence[_Taken]) -> dict[str, list[DrivenStage]]:
    """Give the points to the streaming calibrators, in the order of their time, and look at these after each tumble."""
    found: dict[str, list[DrivenStage]] = {name: [] for name in board.identity.stream_calibrators}
    for name in found:
        board.session.request(StreamReset(name))
    for each in taken:
        in_time = np.argsort(each.tumble.taken)
        upload_pairs(board, each.tumble.points[in_time], each.tumble.accelerometer[in_time])
        for name, stages in found.items():
            feed(board, name, 0, len(in_time))
            stages.append(DrivenStage(each.disturbed, each.time_s, stage(board, name, len(in_time))))
    return found


def is_disturbed(board: Board) -> bool:
    """Whether anything disturbs the field of a virtual board now."""
    table, now_s = board.stage, board.virtual_seconds
    if table is None or now_s is None:
        raise BenchError("what disturbs the field is known of a virtual board only")
    fields_ut = board.true_disturbances_ut(round(1e6 * (now_s - table.firmware_clock_began_s))) or {}
    return any(float(np.linalg.norm(field_ut)) > DISTURBED_UT for field_ut in fields_ut.values())


def _wait(board: Board, *, disturbed: bool) -> float:
    """Let time pass until the field is disturbed, or no longer; return when that is, by the board's clock [s]."""
    began_s = board.now_s()
    while is_disturbed(board) is not disturbed:
        if board.now_s() > began_s + _PATIENCE_S:
            raise BenchError(
                f"the field of this world is {'not ' * disturbed}disturbed for {_PATIENCE_S:g} s on end: calibrating "
                "while driving needs a disturbance that begins after the filter's run, and that ends"
            )
        board.sleep(_LOOK_S)
    return board.now_s()
