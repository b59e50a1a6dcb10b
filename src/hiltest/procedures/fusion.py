"""The board runs the fusion filter on its own sensors while it is turned and tilted."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from hiltest.angles import Pose, heading_error_deg
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
from hiltest.orientation.fusion import FusionNoise, heading_sigma_deg
from hiltest.orientation.quaternions import Quaternion, from_pose, normalised, pose_of, rotation_ned_from_body
from hiltest.procedures.progress import Progress, silent
from hiltest.procedures.rest import rest_gyroscope
from hiltest.procedures.turntables import Turntable

Reals = NDArray[np.float64]

# Setting of the filter for the gyroscope [deg/s per root hertz]: not its noise, of 0.025, but room for what is no
# noise: 0.02 deg/s of bias left by a short rest, 0.1 % of scale at 60 deg/s, over the 0.6 s that a heading then lasts.
_RATE_DPS_RTHZ = 0.2
# About a level axis: 3 mg of offset, and up to 40 deg/s for the 5 ms that an accelerometer's sample may be old.
_TILT_DEG = 0.3
# No hand keeps gravity at 1 g; beyond this it is no gravity any more.
_GATE_G = 0.1
# No motion is followed for longer: a hand's sway, or a slow table's [s].
_LONGEST_S = 30.0
# Longer than the motion, so that the rest after it is seen as well.
_AFTER_S = 0.3


@dataclass(frozen=True, slots=True, eq=False)
class AttitudeErrors:
    """Errors of attitudes against the truth, at each record; NaN where there was none."""

    heading_deg: Reals
    """Shape (n,). Measured minus true, the short way round."""
    tilt_deg: Reals
    """Shape (n,). Angle between the measured and the true vertical."""

    @property
    def heading_rms_deg(self) -> float:
        """rms heading error over all records that have an attitude."""
        return _rms(self.heading_deg)

    @property
    def heading_max_deg(self) -> float:
        """Largest magnitude of the heading error."""
        return float(np.nanmax(np.abs(self.heading_deg)))

    @property
    def tilt_rms_deg(self) -> float:
        """rms tilt error over all records that have an attitude."""
        return _rms(self.tilt_deg)


@dataclass(frozen=True, slots=True, eq=False)
class FusionResult:
    """Results of the fusion filter while the board was moved."""

    noise: FusionNoise
    """What the filter was told."""
    summary: FusionSummary
    """Summary that the board answered."""
    time_s: Reals
    """Shape (n,). Time of the records since the run began."""
    truth: tuple[Pose, ...] | None
    """At these times; None where it is unknown, and then there are no errors."""
    fused: AttitudeErrors | None
    accelerometer_magnetometer: AttitudeErrors | None
    gyroscope: AttitudeErrors | None
    """Errors of the filter, and of its two halves alone; all began with the same attitude."""
    cycle_model: str
    """What the summary's cycles mean."""
    predict_range: CycleRange | None
    update_range: CycleRange | None
    """Uncertainty range of the largest of them; None where it is unknown, or it was not among the last steps."""


def filter_noise(*, magnetometer_sigma_ut: float, field_ut: float, dip_deg: float) -> FusionNoise:
    """Return the filter's settings for a bench's sensors: the magnetometer's noise as the rig has it."""
    heading_deg = heading_sigma_deg(field_sigma=magnetometer_sigma_ut / field_ut, tilt_deg=_TILT_DEG, dip_deg=dip_deg)
    return FusionNoise(_RATE_DPS_RTHZ, _TILT_DEG, heading_deg, _GATE_G)


def measure_fusion(
    board: Board, turntable: Turntable, *, slot: int, noise: FusionNoise, readings: int = 16,
    bias_s: float = 2.5, progress: Progress | None = None,
) -> FusionResult:
    """Let the board run the filter through a motion, and return its errors where the truth is known.

    Parameters
    ----------
    turntable
        Rests, then sways.
    slot
        Slot of the calibrations of magnetometer and accelerometer that are used.
    readings
        Averaged at rest, for the attitude that all three begin with.
    bias_s
        How long the gyroscope rests before, for its bias.

    Raises
    ------
    BoardMovedError, SamplesLostError
        When the gyroscope's rest was none: its bias is not stored then.
    SensorAbsentError
        When the board has not all three sensors.
    DeviceError
        When the slot is empty, or a sensor delivers nothing.
    """
    tell = progress or silent
    for kind in SensorKind:
        board.sensor(kind)
    tell("fusion", 0, 2)
    turntable.rest()
    rest_gyroscope(board, seconds=bias_s, store=True)
    tell("fusion", 1, 2)
    found = follow_motion(board, turntable.sway, slot=slot, noise=noise, readings=readings)
    tell("fusion", 2, 2)
    return found


def follow_motion(
    board: Board, move: Callable[[], float], *, slot: int, noise: FusionNoise, readings: int = 16,
    longest_s: float = _LONGEST_S,
) -> FusionResult:
    """Let the board at rest begin the filter, and follow a motion; its gyroscope's bias is the one it has.

    Parameters
    ----------
    move
        Begins the motion, comes back at once, and says how long it takes [s].
    longest_s
        The motion is followed for no longer, and the records spread over as much.
    """
    # At the rate of the fastest magnetometer: the board has room for so many records, whichever is selected.
    every = math.ceil(SAMPLE_RATE_HZ * (longest_s + _AFTER_S) / MAX_FUSION_RECORDS)
    board.session.request(FusionStart(
        slot, every, readings, noise.rate_dps_rthz, noise.tilt_deg, noise.heading_deg, noise.gate_g
    ))  # fmt: skip
    takes_s = min(move(), longest_s)
    summary = board.session.request(FusionRun(round(1e6 * (takes_s + _AFTER_S))))
    return _result(board, noise, summary, _read(board, summary.records))


def _read(board: Board, count: int) -> FusionRecords:
    parts = [board.session.request(FusionRead(first)) for first in range(0, count, MAX_FUSION_READ)]
    return FusionRecords.joined(parts)


def _result(board: Board, noise: FusionNoise, summary: FusionSummary, records: FusionRecords) -> FusionResult:
    at = [board.true_attitude(summary.began_us + int(time_us)) for time_us in records.time_us]
    truth = tuple(pose for pose in at if pose is not None)
    known = len(truth) == len(at)
    fused, measured, turned = (
        _errors(attitudes, truth) if known else None for attitudes in (records.fused, records.measured, records.turned)
    )
    time_s = 1e-6 * records.time_us.astype(np.float64)
    return FusionResult(
        noise, summary, time_s, truth if known else None, fused, measured, turned, board.cycle_model,
        board.cycle_range(summary.predicted.largest), board.cycle_range(summary.updated.largest),
    )


def _errors(attitudes: NDArray[np.float64], truth: tuple[Pose, ...]) -> AttitudeErrors:
    pairs = [_error(attitude, pose) for attitude, pose in zip(attitudes, truth, strict=True)]
    heading, tilt = np.array(pairs, dtype=np.float64).reshape(-1, 2).T
    return AttitudeErrors(heading, tilt)


def _error(attitude: Quaternion, truth: Pose) -> tuple[float, float]:
    """Return heading error and tilt error [deg], NaN for no attitude."""
    if np.isnan(attitude).any():
        return math.nan, math.nan
    unit = normalised(attitude)
    down, true_down = rotation_ned_from_body(unit)[2], rotation_ned_from_body(from_pose(truth))[2]
    tilt_rad = math.atan2(float(np.linalg.norm(np.cross(down, true_down))), float(down @ true_down))
    return heading_error_deg(pose_of(unit).heading_deg, truth.heading_deg), math.degrees(tilt_rad)


def _rms(errors: Reals) -> float:
    return math.sqrt(float(np.nanmean(np.square(errors))))
