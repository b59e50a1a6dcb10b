"""Known angles set by hand, with firmware that has its own protocol; its output also shows whether the board stands."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence

import numpy as np

from hiltest.boards.compass import CompassBoard
from hiltest.interfaces.frames import Frame
from hiltest.interfaces.quantities import Moment, Observation, Quantity
from hiltest.orientation.angles import Pose, circular_mean_deg, wrap_180
from hiltest.procedures.hand_poses import STILL_WITHIN_S, Readings, Reals, moved, said_beside, walk_by_hand
from hiltest.procedures.settling import Settled, wait_until_settled
from hiltest.procedures.turntables import Achieved, OperatorTurntable

SAY = "A run that is stopped begins anew: this firmware does not say whether it is then the same.\n"
"""Note before the first question, because such firmware does not identify its build or its calibration."""
_STOPPED = "the same command begins anew"
_FIELD = (Quantity.MAGNETOMETER, Quantity.MAGNETOMETER_CALIBRATED)
_GRAVITY = (Quantity.ACCELEROMETER, Quantity.ACCELEROMETER_CALIBRATED)
# Duration of one reading while a question waits [s]: three lines at ten per second.
_LOOK_S = 0.3
# Change of heading between two readings on a table that turns at 3 degrees per second; the noise of three lines is 0.3.
_TURNED_DEG = 1.0


def hold_by_hand(
    board: CompassBoard,
    table: OperatorTurntable,
    poses: Sequence[Pose],
    frame: Frame,
    hold: Callable[[int, Achieved, Settled], object],
    *,
    longest_s: float | None = None,
) -> None:
    """Ask for each pose, and wait until the board stands still and its heading has settled; see `walk_by_hand`.

    Parameters
    ----------
    frame
        Convention of the firmware.
    hold
        Receives each completed pose, by its index.
    longest_s
        Longest wait for a heading; by default the rig's.
    """

    def take(at: int, heading_deg: float) -> str:
        settled, moves = settle_where_still(board, frame, longest_s)
        if settled is not None:
            hold(at, table.achieved(poses[at], heading_deg), settled)
        return moves

    look = _Look(board, frame) if board.may_be_overheard else None
    walk_by_hand(table, poses, (), take=take, look=look, now_s=board.now_s, say=SAY, stopped=_STOPPED)


def settle_where_still(board: CompassBoard, frame: Frame, longest_s: float | None = None) -> tuple[Settled | None, str]:
    """Wait until the board stands still, and then until its heading has settled; on a timeout describe the motion.

    Field and gravity show whether it stands, if the firmware reports them. The heading cannot, because it is under
    test: if it drifts in a filter or never settles, that is a finding.
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
    """Describe how the board moved between two windows of observations; empty if it stood, or reports no vectors.

    Notes
    -----
    The noise of the field is the declared one of one reading; firmware that averages has less. With 0.4 uT, ten
    readings per window and a horizontal field of 22.8 uT, a turn by 2 degrees between windows is detected.
    """
    pair = _readings(before), _readings(after)
    return moved(*pair, board.rig.sensors.magnetometer_noise_ut) if min(readings.n for readings in pair) else ""


def _readings(observations: Sequence[Observation]) -> Readings:
    field, gravity = _vectors(observations, _FIELD), _vectors(observations, _GRAVITY)
    vectors = [vector for vector in (field, gravity) if vector is not None]
    spread_g = gravity.std(axis=0, ddof=1).max() if gravity is not None and len(gravity) > 1 else 0.0
    return Readings(
        min((len(vector) for vector in vectors), default=0),
        None if field is None else field.mean(axis=0),
        None if gravity is None else gravity.mean(axis=0),
        1000.0 * float(spread_g),
    )


def _vectors(observations: Sequence[Observation], of: Sequence[Quantity]) -> Reals | None:
    """Return the values of the first quantity that has any, shape (n, 3); None if none has."""
    for quantity in of:
        values = [observation.values[quantity] for observation in observations if quantity in observation.values]
        if values:
            return np.array(values, dtype=np.float64)
    return None


class _Look:
    """Display of the board's heading while a question waits, and of motion, by vectors or else by heading."""

    def __init__(self, board: CompassBoard, frame: Frame) -> None:
        self._board, self._frame = board, frame
        self._before: Sequence[Observation] = ()

    def __call__(self) -> str:
        """Listen, and return the text to show."""
        before, self._before = self._before, self._board.observe(_LOOK_S)
        pair = self._headings(before), self._headings(self._before)
        mean_deg = circular_mean_deg(pair[1]) if pair[1] else math.nan
        if min(_readings(observations).n for observations in (before, self._before)):
            moves = bool(movement_heard(self._board, before, self._before))
        else:
            moves = not all(pair) or abs(wrap_180(mean_deg - circular_mean_deg(pair[0]))) > _TURNED_DEG
        return said_beside(mean_deg if pair[1] else None, moves=moves)

    def _headings(self, observations: Sequence[Observation]) -> list[float]:
        values = [
            observation.values[Quantity.HEADING]
            for observation in observations
            if Quantity.HEADING in observation.values
        ]
        return [self._frame.heading_deg(float(value[0])) for value in values]
