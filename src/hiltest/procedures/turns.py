"""Whole turns about the mounted axes: the gyroscope's scale and axes against a table's angle."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from hiltest.boards.board import Board
from hiltest.calibration.gyroscope import (
    NOMINAL_DPS_PER_COUNT,
    GyroscopeFit,
    GyroscopeTurn,
    TurnsStatus,
    misalignment_deg,
    scale_error_percent,
)
from hiltest.errors import CalibrationError
from hiltest.link.gyroscope import (
    EDGE_SAMPLES,
    Axis,
    FitGyroscope,
    GyroscopeRestReply,
    IntegrateGyroscope,
    IntegrateGyroscopeReply,
    SetGyroscope,
)
from hiltest.link.replies import DPS_PER_COUNT, SAMPLE_RATE_HZ, RunCost
from hiltest.measurement import CycleRange
from hiltest.procedures.progress import Progress, silent
from hiltest.procedures.rest import BoardMovedError, noise_counts, rest_gyroscope
from hiltest.procedures.turntables import Turntable

Reals = NDArray[np.float64]

# The data sheet states no tolerance of the sensitivity; a larger deviation means that the turn was not as requested.
_PLAUSIBLE = 0.2
_EDGE_SIGMAS = 8.0  # at 24 edges a run, once in 10^13 runs
_LARGEST_WORD = 32_767
_TURNS = 3
# Longest integration of a board, 60 s, minus time for the FIFO to start.
_LONGEST_S = 59.0


class TurnInvalidError(CalibrationError):
    """A turn that cannot calibrate the gyroscope; the message has the turn and the reason."""


@dataclass(frozen=True, slots=True, eq=False)
class MeasuredTurn:
    """A turn with the rests before and after it."""

    axis: Axis
    """Axis that was down."""
    before: GyroscopeRestReply
    after: GyroscopeRestReply
    """Rests before and after; the first stored the bias that the second excludes."""
    turn: GyroscopeTurn

    @property
    def bias_error_dps(self) -> float:
        """Largest axis of the second rest's mean without the stored bias [deg/s]."""
        return float(np.abs(self.after.corrected_mean).max()) * DPS_PER_COUNT

    @property
    def uncorrected_error_dps(self) -> float:
        """Largest axis of the second rest's mean [deg/s]."""
        return float(np.abs(self.after.rate.mean).max()) * DPS_PER_COUNT

    @property
    def sensitivity_error_percent(self) -> float:
        """Difference of the sensitivity about the axis from the data sheet's [%]."""
        return scale_error_percent(self.turn.response, self.turn.direction / NOMINAL_DPS_PER_COUNT)

    def scale_error_percent(self, true_response: Reals) -> float:
        """Return the error of the measured scale against a world's ``felt_dps = true_response @ rate_dps`` [%]."""
        return scale_error_percent(self.turn.response, true_response @ self.turn.direction / NOMINAL_DPS_PER_COUNT)

    def misalignment_deg(self, true_response: Reals) -> float:
        """Return the angle between the measured axis and that of a world [deg]."""
        return misalignment_deg(self.turn.response, true_response @ self.turn.direction)


@dataclass(frozen=True, slots=True, eq=False)
class FittedTurns:
    """Calibration that the board computed from turns and stored."""

    fit: GyroscopeFit
    residual_deg: float
    """rms difference between the calibrated gyroscope and the table; 0 for three turns."""
    cost: RunCost | None
    """Cost; None without a cycle counter."""
    scale_uncertainty_percent: float
    misalignment_uncertainty_deg: float
    """Standard uncertainties from noise and the table's declared angle together."""
    band: CycleRange | None = None
    """Uncertainty range of its cycles; None if unknown."""

    def scale_errors_percent(self, true_response: Reals) -> tuple[float, ...]:
        """Return the error of the scale of each axis, against a world's ``felt_dps = true_response @ rate_dps`` [%]."""
        return tuple(
            scale_error_percent(estimated, felt / NOMINAL_DPS_PER_COUNT)
            for estimated, felt in zip(self.fit.response.T, true_response.T, strict=True)
        )

    def misalignments_deg(self, true_response: Reals) -> tuple[float, ...]:
        """Return the angle between each axis and that of a world [deg]."""
        return tuple(
            misalignment_deg(estimated, felt)
            for estimated, felt in zip(self.fit.response.T, true_response.T, strict=True)
        )


def measure_turn(
    board: Board,
    turntable: Turntable,
    axis: Axis,
    *,
    degrees: float = 360.0,
    rate_dps: float,
    rest_s: float,
    progress: Progress | None = None,
) -> MeasuredTurn:
    """Rest, turn about a mounted axis, and rest again; an operator who slips is asked for the turn up to three times.

    Parameters
    ----------
    turntable
        Turntable whose angle is the reference.
    axis
        Axis that points straight down.
    degrees
        Angle; positive is clockwise seen from above, so positive about the axis, which points down.
    rate_dps
        Rate of the table, 36 to 90.
    rest_s
        Length of each rest. The first stores the board's bias.

    Raises
    ------
    BoardMovedError
        When the board was moved in a rest.
    TurnInvalidError
        When samples were lost, or the turn was not as requested.
    """
    # An operator may slip, and a simulated table does not wait for a line with faults. Faulty firmware fails each time.
    may_be_late = board.stage is not None and not board.line_is_exact
    for _ in range(_TURNS - 1):
        try:
            return _one_turn(board, turntable, axis, degrees, rate_dps, rest_s, progress or silent)
        except (BoardMovedError, TurnInvalidError) as error:
            if not (turntable.again(str(error)) or may_be_late):
                raise
    return _one_turn(board, turntable, axis, degrees, rate_dps, rest_s, progress or silent)


def _one_turn(
    board: Board, turntable: Turntable, axis: Axis, degrees: float, rate_dps: float, rest_s: float, tell: Progress
) -> MeasuredTurn:
    task = f"gyroscope, turn about {axis.name.lower()}"
    tell(task, 0, 3)
    turntable.mount(axis)
    before = rest_gyroscope(board, seconds=rest_s, store=True)
    tell(task, 1, 3)
    takes_s = turntable.turn(axis, degrees, rate_dps=rate_dps)
    n = math.ceil(takes_s * SAMPLE_RATE_HZ)
    if takes_s > _LONGEST_S:
        raise TurnInvalidError(
            f"the turn about {axis.name.lower()} is invalid: the table takes {takes_s:.0f} s for it, and the board "
            f"adds up {_LONGEST_S:g} s at most. Let the table turn faster"
        )
    turning = board.session.request(IntegrateGyroscope(n, timeout_us=min(round(2e6 * takes_s + 1e6), 60_000_000)))
    _refuse_unusable(axis, turning, before.rate.mean, noise_counts(board))
    tell(task, 2, 3)
    after = rest_gyroscope(board, seconds=rest_s)
    tell(task, 3, 3)
    turn = _turn(axis, degrees, before, turning, after)
    _refuse_wrong_turn(axis, turn)
    return MeasuredTurn(axis, before, after, turn)


def _turn(
    axis: Axis, degrees: float, before: GyroscopeRestReply, turning: IntegrateGyroscopeReply, after: GyroscopeRestReply
) -> GyroscopeTurn:
    turned_deg = np.zeros(3)
    turned_deg[axis] = degrees
    between_s = after.span.middle_s - before.span.middle_s
    return GyroscopeTurn(
        turned_deg,
        turning.total,
        turning.n,
        turning.span.duration_s,
        before.rate.mean,
        after.rate.mean,
        (turning.span.middle_s - before.span.middle_s) / between_s,
    )


def _refuse_unusable(axis: Axis, turning: IntegrateGyroscopeReply, bias: Reals, noise: float) -> None:
    invalid = f"the turn about {axis.name.lower()} is invalid"
    if turning.span.lost:
        raise TurnInvalidError(f"{invalid}: samples of the gyroscope were lost (overrun). Run again")
    if (turning.highest >= _LARGEST_WORD).any() or (turning.lowest <= -_LARGEST_WORD).any():
        raise TurnInvalidError(f"{invalid}: the gyroscope was beyond its range. Turn more slowly")
    limit = _EDGE_SIGMAS * noise / math.sqrt(EDGE_SAMPLES)
    for total, when in ((turning.begin, "it had begun before the first"), (turning.end, "it was not over at the last")):
        if (np.abs(total / EDGE_SAMPLES - bias) > limit).any():
            raise TurnInvalidError(f"{invalid}: {when} sample. Begin after Enter, and be back in time")


def _refuse_wrong_turn(axis: Axis, turn: GyroscopeTurn) -> None:
    felt_deg = NOMINAL_DPS_PER_COUNT * turn.integral
    degrees = float(turn.turned_deg[axis])
    if np.linalg.norm(felt_deg - turn.turned_deg) > _PLAUSIBLE * abs(degrees):
        measured, name = ", ".join(f"{angle_deg:+.0f}" for angle_deg in felt_deg), axis.name.lower()
        raise TurnInvalidError(
            f"the turn about {name} is invalid: the gyroscope measured ({measured}) deg about x, y, z, and the table "
            f"was to turn by {degrees:+g} about {name}. Check that {name} points down, that the table turned by this "
            "angle (+ is clockwise from above), and the firmware's axes and signs of the gyroscope"
        )


def fit_on_board(board: Board, turns: Sequence[MeasuredTurn], *, uncertainty_deg: float) -> FittedTurns:
    """Let the board fit its gyroscope's matrix to turns, and store it with the bias of the last rest.

    Parameters
    ----------
    turns
        At least three turns, about axes that span.
    uncertainty_deg
        Declared uncertainty of the table's angle, at either end of a turn, and of the mounted axis.

    Raises
    ------
    CalibrationError
        When the turns do not determine the matrix.
    """
    reply = board.session.request(FitGyroscope([turn.turn for turn in turns]))
    if reply.fit.status is not TurnsStatus.OK:
        named = "" if reply.fit.at_fault is None else f", turn {reply.fit.at_fault + 1}"
        raise CalibrationError(f"turns do not calibrate the gyroscope: {reply.fit.status.name}{named}")
    band = board.cycle_range(reply.cost)
    fit = GyroscopeFit(reply.fit.matrix, turns[-1].after.rate.mean)
    board.session.request(SetGyroscope(fit.matrix, fit.bias))
    noise_deg = max(_noise_deg(board, turn) for turn in turns)
    smallest_deg = min(float(np.linalg.norm(turn.turn.turned_deg)) for turn in turns)
    return FittedTurns(
        fit,
        reply.fit.residual_deg,
        reply.cost,
        100.0 * math.hypot(noise_deg, math.sqrt(2.0) * uncertainty_deg) / smallest_deg,
        math.hypot(math.degrees(noise_deg / smallest_deg), uncertainty_deg),
        band,
    )


def _noise_deg(board: Board, measured: MeasuredTurn) -> float:
    """Return the rms error of a turn's angle on one axis from noise: in the turn, and in the bias of two rests."""
    # White noise of one-sided density d, integrated over T, has the rms d sqrt(T/2).
    turn_s = measured.turn.duration_s
    rests_s = measured.before.span.duration_s + measured.after.span.duration_s
    return board.declared.gyroscope_density_dps * math.sqrt(0.5 * turn_s * (1.0 + turn_s / rests_s))
