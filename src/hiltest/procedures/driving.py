"""Heading in a disturbed field: of the attitude filter, and of each of its two halves alone."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from functools import partial

import numpy as np
from numpy.typing import NDArray

from hiltest.boards.board import Board
from hiltest.errors import BenchError
from hiltest.link.gyroscope import Axis
from hiltest.procedures.fusion import FusionResult, finite_rms, follow_motion
from hiltest.procedures.rest import rest_gyroscope
from hiltest.procedures.turntables import Turntable

Reals = NDArray[np.float64]
Flags = NDArray[np.bool_]

#: Threshold of a disturbance's field [uT]: about the noise of one reading, and 1 degree of heading.
DISTURBED_UT = 0.5
#: Error of a wrong heading [deg]: five times the noise of one reading of accelerometer and magnetometer.
WRONG_DEG = 5.0
# Run time of the filter before the first disturbance.
_BEFORE_S = 5.0
# Maximum run time of the filter is 60 s, including the rest after a motion.
_LONGEST_S = 59.5
# Two turns, so that each disturbance comes from many directions.
_TURN_DEG = 720.0
_TURN_DPS = _TURN_DEG / (_LONGEST_S - 2.0)


@dataclass(frozen=True, slots=True, eq=False)
class DrivenHeadings:
    """Errors of one source's headings through the disturbances."""

    error_deg: Reals
    """Shape (n,). NaN without a heading."""
    quiet_rms_deg: float
    """rms before the first disturbance."""
    rms_deg: float
    max_deg: float
    """rms during any disturbance."""
    rms_by_cause_deg: Mapping[str, float]
    """rms during the disturbance by each cause."""
    recovery_s: float
    """Longest time from the end of a disturbance until the heading is right and stays so until the next one."""
    recovered: bool
    """True if the heading recovered after every disturbance."""
    unsaid_s: float
    """Total time with a wrong heading."""


@dataclass(frozen=True, slots=True, eq=False)
class DrivingResult:
    """A run of the filter through the disturbances of a world."""

    motion: FusionResult
    field_ut: Mapping[str, Reals]
    """Shape (n, 3). Disturbing field at each record, by cause, body frame."""
    headings: Mapping[str, DrivenHeadings]
    """Headings of ``fusion``, of the ``magnetometer`` with the accelerometer alone, and of the ``gyroscope`` alone."""


def measure_driving(
    board: Board,
    turntable: Turntable,
    *,
    begins_s: float,
    slot: int,
    readings: int = 16,
    bias_s: float = 2.5,
) -> DrivingResult:
    """Turn a level virtual board twice round through the disturbances of its world, while it runs its filter.

    Parameters
    ----------
    board
        Board whose truth is known.
    begins_s
        Start of the first disturbance [virtual s].
    slot
        Slot of an undisturbed calibration.
    readings
        Number of readings that are averaged at rest, for the filter's first attitude.
    bias_s
        Length of the rest before, for the gyroscope's bias.

    Raises
    ------
    BenchError
        When the disturbances begin before the board is ready for them, or its truth is unknown.
    """
    turntable.rest()
    rest_gyroscope(board, seconds=bias_s, store=True)
    now_s = board.virtual_seconds
    if now_s is None:
        raise BenchError("disturbances of the field are known only for a virtual board")
    wait_s = begins_s - _BEFORE_S - now_s
    if wait_s < 0.0:
        raise BenchError(
            f"the field is disturbed from {begins_s:g} s on, and the board was ready for it at {now_s + _BEFORE_S:.1f} "
            "s: let the disturbances of the rig's world begin later"
        )
    board.sleep(wait_s)
    turn = partial(turntable.turn, Axis.Z, _TURN_DEG, rate_dps=_TURN_DPS)
    motion = follow_motion(board, turn, slot=slot, readings=readings, longest_s=_LONGEST_S)
    field_ut = _fields_ut(board, motion)
    sources = {
        "fusion": motion.fused,
        "magnetometer": motion.accelerometer_magnetometer,
        "gyroscope": motion.gyroscope,
    }
    return DrivingResult(
        motion,
        field_ut,
        {
            name: driven_headings(motion.time_s, errors.heading_deg, field_ut)
            for name, errors in sources.items()
            if errors is not None
        },
    )


def _fields_ut(board: Board, motion: FusionResult) -> dict[str, Reals]:
    clock_us = [motion.summary.began_us + round(1e6 * time_s) for time_s in motion.time_s.tolist()]
    disturbances = [board.true_disturbances_ut(time_us) or {} for time_us in clock_us]
    return (
        {cause: np.array([by_cause[cause] for by_cause in disturbances]) for cause in disturbances[0]}
        if disturbances
        else {}
    )


def driven_headings(time_s: Reals, error_deg: Reals, field_ut: Mapping[str, Reals]) -> DrivenHeadings:
    """Summarise the errors of a source's headings, given the disturbing field at each time, by cause."""
    by_cause = {cause: np.linalg.norm(field, axis=1) > DISTURBED_UT for cause, field in field_ut.items()}
    disturbed = np.any([*by_cause.values(), np.zeros(len(time_s), dtype=bool)], axis=0)
    quiet = np.arange(len(time_s)) < (int(disturbed.argmax()) if disturbed.any() else len(time_s))
    wrong = np.abs(error_deg) > WRONG_DEG
    recovery_s, recovered = _recovery(time_s, wrong, disturbed)
    step_s = float(np.median(np.diff(time_s))) if len(time_s) > 1 else 0.0
    return DrivenHeadings(
        error_deg,
        finite_rms(error_deg[quiet]),
        finite_rms(error_deg[disturbed]),
        _largest(error_deg[disturbed]),
        {cause: finite_rms(error_deg[at]) for cause, at in by_cause.items()},
        recovery_s,
        recovered,
        step_s * int(wrong.sum()),
    )


def _recovery(time_s: Reals, wrong: Flags, disturbed: Flags) -> tuple[float, bool]:
    """Return the longest time from a disturbance's end to the last wrong heading, and whether all recovered."""
    changes = np.flatnonzero(np.diff(disturbed.astype(int))) + 1
    longest_s, recovered = 0.0, True
    for end in changes[~disturbed[changes]].tolist():
        following = changes[changes > end]
        until = int(following[0]) if len(following) else len(time_s)
        still_wrong = end + np.flatnonzero(wrong[end:until])
        if len(still_wrong):
            last = int(still_wrong[-1])
            longest_s = max(longest_s, float(time_s[last] - time_s[end - 1]))
            recovered &= last + 1 < until
    return longest_s, recovered


def _largest(errors_deg: Reals) -> float:
    answered = errors_deg[np.isfinite(errors_deg)]
    return float(np.abs(answered).max()) if len(answered) else math.nan
