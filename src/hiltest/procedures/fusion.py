"""Run of the attitude filter on the board's own sensors while it is turned and tilted."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from hiltest.boards.board import Board
from hiltest.link.fusion import (
    MAX_FUSION_READ,
    MAX_FUSION_RECORDS,
    FusionRead,
    FusionRecords,
    FusionRun,
    FusionStart,
    FusionSummary,
)
from hiltest.link.replies import SAMPLE_RATE_HZ, SensorKind
from hiltest.measurement import CycleRange
from hiltest.orientation.angles import Pose, heading_error_deg
from hiltest.orientation.quaternions import Quaternion, from_pose, normalised, pose_of, rotation_ned_from_body
from hiltest.procedures.progress import Progress, silent
from hiltest.procedures.rest import rest_gyroscope
from hiltest.procedures.turntables import Turntable

Reals = NDArray[np.float64]

# Longest motion: a hand's sway, or a slow table's [s].
_LONGEST_S = 30.0
# Time after the motion, so that the rest is recorded as well.
_AFTER_S = 0.3


@dataclass(frozen=True, slots=True, eq=False)
class AttitudeErrors:
    """Errors of attitudes against the truth, at each record; NaN without an attitude."""

    heading_deg: Reals
    """Shape (n,). Measured minus true heading, wrapped."""
    tilt_deg: Reals
    """Shape (n,). Angle between the measured and the true vertical."""

    @property
    def heading_rms_deg(self) -> float:
        """rms heading error over all records that have an attitude."""
        return finite_rms(self.heading_deg)

    @property
    def heading_max_deg(self) -> float:
        """Largest magnitude of the heading error."""
        return float(np.nanmax(np.abs(self.heading_deg)))

    @property
    def tilt_rms_deg(self) -> float:
        """rms tilt error over all records that have an attitude."""
        return finite_rms(self.tilt_deg)


@dataclass(frozen=True, slots=True, eq=False)
class FusionResult:
    """Results of the filter while the board was moved."""

    summary: FusionSummary
    """Summary from the board."""
    time_s: Reals
    """Shape (n,). Time of the records since the run began."""
    truth: tuple[Pose, ...] | None
    """True attitudes at these times; None if unknown, and then there are no errors."""
    fused: AttitudeErrors | None
    accelerometer_magnetometer: AttitudeErrors | None
    gyroscope: AttitudeErrors | None
    """Errors of the filter, and of its two halves alone; all began with the same attitude."""
    cycle_model: str
    """Cycle model of the summary."""
    cycle_range: CycleRange | None
    """Uncertainty range of its largest cycles; None if unknown, or not among the last updates."""


def measure_fusion(
    board: Board,
    turntable: Turntable,
    *,
    slot: int,
    readings: int = 16,
    bias_s: float = 2.5,
    progress: Progress | None = None,
) -> FusionResult:
    """Let the board run the filter through a motion, and return its errors if the truth is known.

    Parameters
    ----------
    turntable
        Turntable, which rests and then sways.
    slot
        Slot of the calibrations of magnetometer and accelerometer.
    readings
        Number of readings that are averaged at rest, for the initial attitude of all three.
    bias_s
        Length of the rest before, for the gyroscope's bias.

    Raises
    ------
    BoardMovedError, SamplesLostError
        When the board moved or samples were lost in the rest; the bias is not stored then.
    SensorAbsentError
        When the board has not all three sensors.
    DeviceError
        When the slot is empty, or a sensor delivers no data.
    """
    tell = progress or silent
    for kind in SensorKind:
        board.sensor(kind)
    tell("fusion", 0, 2)
    turntable.rest()
    rest_gyroscope(board, seconds=bias_s, store=True)
    tell("fusion", 1, 2)
    result = follow_motion(board, turntable.sway, slot=slot, readings=readings)
    tell("fusion", 2, 2)
    return result


def follow_motion(
    board: Board,
    move: Callable[[], float],
    *,
    slot: int,
    readings: int = 16,
    longest_s: float = _LONGEST_S,
) -> FusionResult:
    """Let the board start the filter at rest, and follow a motion, with its stored gyroscope bias.

    Parameters
    ----------
    move
        Starts the motion, and returns its duration [s] at once.
    longest_s
        Longest time to follow, over which the records are spread.
    """
    return _result(board, *record_motion(board, move, slot=slot, readings=readings, longest_s=longest_s))


def record_motion(
    board: Board, move: Callable[[], float], *, slot: int, readings: int = 16, longest_s: float = _LONGEST_S
) -> tuple[FusionSummary, FusionRecords]:
    """Let the board start the filter at rest and follow a motion; parameters as of `follow_motion`."""
    # The rate of the fastest magnetometer: the board has room for that many records with any sensor.
    every = math.ceil(SAMPLE_RATE_HZ * (longest_s + _AFTER_S) / MAX_FUSION_RECORDS)
    board.session.request(FusionStart(slot, every, readings))
    takes_s = min(move(), longest_s)
    summary = board.session.request(FusionRun(round(1e6 * (takes_s + _AFTER_S))))
    return summary, _read(board, summary.records)


def _read(board: Board, count: int) -> FusionRecords:
    parts = [board.session.request(FusionRead(first)) for first in range(0, count, MAX_FUSION_READ)]
    return FusionRecords.joined(parts)


def _result(board: Board, summary: FusionSummary, records: FusionRecords) -> FusionResult:
    at = [board.true_attitude(summary.began_us + int(time_us)) for time_us in records.time_us]
    truth = tuple(pose for pose in at if pose is not None)
    is_complete = len(truth) == len(at)
    fused, measured, turned = (
        _errors(attitudes, truth) if is_complete else None
        for attitudes in (records.fused, records.measured, records.turned)
    )
    time_s = 1e-6 * records.time_us.astype(np.float64)
    return FusionResult(
        summary,
        time_s,
        truth if is_complete else None,
        fused,
        measured,
        turned,
        board.cycle_model,
        board.cycle_range(summary.costs.largest),
    )


def _errors(attitudes: NDArray[np.float64], truth: tuple[Pose, ...]) -> AttitudeErrors:
    pairs = [_error(attitude, pose) for attitude, pose in zip(attitudes, truth, strict=True)]
    heading, tilt = np.array(pairs, dtype=np.float64).reshape(-1, 2).T
    return AttitudeErrors(heading, tilt)


def _error(attitude: Quaternion, truth: Pose) -> tuple[float, float]:
    """Return heading error and tilt error [deg]; NaN without an attitude."""
    if np.isnan(attitude).any():
        return math.nan, math.nan
    unit = normalised(attitude)
    down, true_down = rotation_ned_from_body(unit)[2], rotation_ned_from_body(from_pose(truth))[2]
    tilt_rad = math.atan2(float(np.linalg.norm(np.cross(down, true_down))), float(down @ true_down))
    return heading_error_deg(pose_of(unit).heading_deg, truth.heading_deg), math.degrees(tilt_rad)


def finite_rms(errors: Reals) -> float:
    """Return the root mean square without NaN; NaN if there is nothing else."""
    finite = errors[np.isfinite(errors)]
    return math.sqrt(float(np.mean(np.square(finite)))) if len(finite) else math.nan
