"""Known angles that a hand sets, with firmware that speaks its own language: whether the board stands is heard, too."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence

import numpy as np

from hiltest.angles import Pose, circular_mean_deg, wrap_180
from hiltest.boards.compass import CompassBoard
from hiltest.device.frames import Frame
from hiltest.device.quantities import Moment, Observation, Quantity
from hiltest.procedures.hand_poses import STILL_WITHIN_S, Readings, Reals, moved, said_beside, walk_by_hand
from hiltest.procedures.settling import Settled, wait_until_settled
from hiltest.procedures.turntables import Achieved, OperatorTurntable

SAY = "A run that is stopped begins anew: this firmware does not say whether it is then the same.\n"
"""Said before the first question: nothing tells one build of such firmware, or its own calibration, from another."""
_STOPPED = "the same command begins anew"
_FIELD = (Quantity.MAGNETOMETER, Quantity.MAGNETOMETER_CALIBRATED)
_GRAVITY = (Quantity.ACCELEROMETER, Quantity.ACCELEROMETER_CALIBRATED)
# One look at the board while a question waits [s]: three lines of ten a second.
_LOOK_S = 0.3
# Between two looks a heading of a table that turns by 3 degrees a second changes so; noise of three lines makes 0.3.
_TURNED_DEG = 1.0


def hold_by_hand(
    board: CompassBoard, table: OperatorTurntable, poses: Sequence[Pose], frame: Frame,
    hold: Callable[[int, Achieved, Settled], object], *, longest_s: float | None = None,
) -> None:
    """Ask for each pose, wait until the board stands still there and its heading has settled; as `walk_by_hand`.

    Parameters
    ----------
    frame
        Of the firmware.
    hold
        Gets each pose as it is taken, by its index.
    longest_s
        Longest that a heading is waited for; by default the rig's.
    """
    def take(at: int, heading_deg: float) -> str:
        settled, moves = settle_where_still(board, frame, longest_s)
        if settled is not None:
            hold(at, table.achieved(poses[at], heading_deg), settled)
        return moves

    look = _Look(board, frame) if board.may_be_overheard else None
    walk_by_hand(table, poses, (), take=take, look=look, now_s=board.now_s, say=SAY, stopped=_STOPPED)


def settle_where_still(
    board: CompassBoard, frame: Frame, longest_s: float | None = None
) -> tuple[Settled | None, str]:
    """Wait until the board stands still, and then until its heading has settled; return None and what still moves.

    Field and gravity show whether it stands, each as far as the firmware says it. The heading does not: it is what is
    under test, and one that creeps on in a filter, or never settles, is a finding.
    """
    window_s, ends_s = board.device.window_s, board.now_s() + STILL_WITHIN_S
    before = board.observe(window_s)
    while True:
        after = board.observe(window_s)
        moves = movement_heard(board, before, after)
        if not moves:
            board.send(Moment.POSE)
            settled = wait_until_settled(board, frame, longest_s)
            moves = movement_heard(board, after, settled.window)
            if not moves:
                return settled, ""
            after = list(settled.window)
        if board.now_s() > ends_s:
            return None, moves
        before = after


def movement_heard(board: CompassBoard, before: Sequence[Observation], after: Sequence[Observation]) -> str:
    """Describe how the board moved in two times, by what it said; empty where it stood, or does not say it.

    Notes
    -----
    Noise of the field is the declared one of one reading: firmware that averages has less. With 0.4 uT, ten readings a
    window and a horizontal field of 22.8 uT a turn by 2 degrees from one window to the next shows.
    """
    pair = _readings(before), _readings(after)
    return moved(*pair, board.rig.sensors.magnetometer_noise_ut) if min(each.n for each in pair) else ""


def _readings(said: Sequence[Observation]) -> Readings:
    field, gravity = _vectors(said, _FIELD), _vectors(said, _GRAVITY)
    known = [each for each in (field, gravity) if each is not None]
    spread_g = gravity.std(axis=0, ddof=1).max() if gravity is not None and len(gravity) > 1 else 0.0
    return Readings(
        min((len(each) for each in known), default=0), None if field is None else field.mean(axis=0),
        None if gravity is None else gravity.mean(axis=0), 1000.0 * float(spread_g),
    )  # fmt: skip


def _vectors(said: Sequence[Observation], of: Sequence[Quantity]) -> Reals | None:
    """Return what was said of the first quantity that was, shape (n, 3); None where nothing was."""
    for quantity in of:
        found = [each.values[quantity] for each in said if quantity in each.values]
        if found:
            return np.array(found, dtype=np.float64)
    return None


class _Look:
    """The board's heading while a question waits, and whether it moves: by its vectors, or else by its heading."""

    def __init__(self, board: CompassBoard, frame: Frame) -> None:
        self._board, self._frame = board, frame
        self._before: Sequence[Observation] = ()

    def __call__(self) -> str:
        """Listen, and say it in few words."""
        before, self._before = self._before, self._board.observe(_LOOK_S)
        pair = self._headings(before), self._headings(self._before)
        mean_deg = circular_mean_deg(pair[1]) if pair[1] else math.nan
        if min(_readings(each).n for each in (before, self._before)):
            moves = bool(movement_heard(self._board, before, self._before))
        else:
            moves = not all(pair) or abs(wrap_180(mean_deg - circular_mean_deg(pair[0]))) > _TURNED_DEG
        return said_beside(mean_deg if pair[1] else None, moves=moves)

    def _headings(self, said: Sequence[Observation]) -> list[float]:
        values = [each.values[Quantity.HEADING] for each in said if Quantity.HEADING in each.values]
        return [self._frame.heading_deg(float(each[0])) for each in values]
