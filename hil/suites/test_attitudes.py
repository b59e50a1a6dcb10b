"""Attitudes of a resting board with calibrations that rotate its readings, scale them to extremes or zero them."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
import pytest
from numpy.typing import NDArray

from hiltest.boards import Board
from hiltest.calibration.accelerometer import NOMINAL
from hiltest.errors import DeviceError
from hiltest.link.accelerometer import SetAccelerometer
from hiltest.link.fusion import FusionRead, FusionRecords, FusionRun, FusionStart, FusionSummary
from hiltest.link.gyroscope import GetGyroscope, SetGyroscope
from hiltest.link.messages import Average, ClearCalibration, SetCalibration
from hiltest.link.replies import Status
from hiltest.orientation.angles import Pose, rotation_body_from_ned
from hiltest.orientation.quaternions import from_ned_axes, rotation_ned_from_body
from hiltest.orientation.tilt_heading import DegenerateFieldError, tilt_heading
from hiltest.procedures import Turntable
from hiltest.rig import Rig

pytestmark = [pytest.mark.hil, pytest.mark.full]

Reals = NDArray[np.float64]

SOFT_IRON = np.eye(3) / 500.0
# Rotations of the readings: the level board seems to lie on a side, on its back, or in between.
ROTATIONS = [
    Pose(*angles)
    for angles in (
        (0.0, 0.0, 0.0),
        (0.0, 0.0, 180.0),
        (180.0, 0.0, 180.0),
        (180.0, 0.0, 0.0),
        (0.0, 90.0, 0.0),
        (120.0, 30.0, 150.0),
        (250.0, -70.0, -100.0),
    )
]
# Projects gravity or the field onto the x axis: exactly vertical, or exactly parallel to each other.
ON_X = np.outer([1.0, 0.0, 0.0], [0.0, 0.0, 1.0])
GRAVITY, FIELD = NOMINAL.gain, SOFT_IRON
# Near the largest and the smallest magnitude that float32 can represent.
SCALED = {
    "gravity straight down": (ON_X @ GRAVITY, FIELD),
    "gravity straight up": (-ON_X @ GRAVITY, FIELD),
    "huge gravity": (2.2e34 * np.eye(3), FIELD),
    "tiny gravity": (1e-36 * np.eye(3), FIELD),
    "huge field": (GRAVITY, 1e34 * np.eye(3)),
    "tiny field": (GRAVITY, 1e-36 * np.eye(3)),
}
# Calibrations without an attitude; the last two overflow float32.
DEGENERATE = {
    "no gravity": (0.0 * GRAVITY, FIELD),
    "no field": (GRAVITY, 0.0 * FIELD),
    "gravity along the field": (ON_X @ GRAVITY, ON_X @ FIELD),
    "infinite gravity": (3e38 * np.eye(3), FIELD),
    "infinite field": (GRAVITY, 3e38 * np.eye(3)),
}


@pytest.fixture
def slot(board: Board, turntable: Turntable) -> Iterator[int]:
    """The last slot, for calibrations of a resting board; the gyroscope's calibration is restored at the end."""
    turntable.rest()
    gyroscope = board.session.request(GetGyroscope())
    yield board.identity.slots - 1
    board.session.request(SetGyroscope(gyroscope.matrix, gyroscope.bias))
    board.session.request(ClearCalibration(board.identity.slots - 1))


def calibrate(board: Board, slot: int, gain: Reals, soft_iron: Reals) -> None:
    board.session.request(SetAccelerometer(slot, gain, np.zeros(3)))
    board.session.request(SetCalibration(slot, soft_iron, np.zeros(3)))


def test_headings_are_those_of_float64_whatever_the_calibration(board: Board, slot: int) -> None:
    rotations = {str(pose): rotation_body_from_ned(pose) for pose in ROTATIONS}
    rotated = {name: (rotation @ GRAVITY, rotation @ FIELD) for name, rotation in rotations.items()}
    for name, (gain, soft_iron) in (rotated | SCALED | DEGENERATE).items():
        calibrate(board, slot, gain, soft_iron)
        reply = board.session.request(Average(1, 1 << slot))
        answer = reply.headings[slot]
        with np.errstate(over="ignore"):
            vectors = [
                (matrix @ mean).astype(np.float32)
                for matrix, mean in ((gain, reply.accelerometer.mean), (soft_iron, reply.magnetometer.mean))
            ]
        try:
            reference = tilt_heading(*vectors)
        except DegenerateFieldError:
            assert answer.status is Status.DEGENERATE_FIELD, f"{name}: {answer.attitude}"
            continue
        assert name not in DEGENERATE
        assert answer.status is Status.OK, f"{name}: {answer.status.name}"
        assert answer.attitude is not None
        difference = np.abs(rotation_body_from_ned(answer.attitude) - rotation_body_from_ned(reference)).max()
        assert difference < 1e-4, f"{name}: {answer.attitude}, but float64 gives {reference}"  # float32: 2e-6


def start(slot: int) -> FusionStart:
    return FusionStart(slot, 1, 16)


def run(board: Board, seconds: float = 0.06) -> tuple[FusionSummary, FusionRecords]:
    """Run the filter, and return its summary and its records."""
    summary = board.session.request(FusionRun(round(1e6 * seconds)))
    return summary, board.session.request(FusionRead(0))


def test_fusion_begins_and_stays_in_any_attitude(board: Board, slot: int, rig: Rig) -> None:
    rest = board.session.request(Average(16))
    gravity, field_counts = rest.accelerometer.mean, rest.magnetometer.mean
    level_counts = np.linalg.norm(np.cross(gravity, field_counts)) / np.linalg.norm(gravity)
    noise_deg = np.degrees(10.0 * rig.sensors.magnetometer_noise_ut / level_counts)
    calibrate(board, slot, GRAVITY, FIELD)
    level = rotation_ned_from_body(board.session.request(start(slot)))
    for pose in ROTATIONS:
        rotation = rotation_body_from_ned(pose)
        calibrate(board, slot, rotation @ GRAVITY, rotation @ FIELD)
        first = board.session.request(start(slot))
        summary, records = run(board)
        reference = from_ned_axes(level @ rotation.T)
        # Two degrees cover the accelerometer's noise and the drift of a gyroscope with a bias of 25 deg/s.
        for name, attitudes, readings in (
            ("first", first, 16),
            ("fused", records.fused, 16),
            ("turned", records.turned, 16),
            ("measured", records.measured, 1),
        ):
            error_deg = 2.0 * np.degrees(np.arccos(np.clip(np.abs(attitudes @ reference), 0.0, 1.0))).max()
            limit_deg = 2.0 + 6.0 * noise_deg * np.sqrt(1.0 / readings + 1.0 / 16.0)
            assert error_deg < limit_deg, (
                f"{pose}: the {name} attitude differs from the board's by {error_deg:.1f} degrees"
            )
        assert summary.no_attitude == summary.field_left_out == summary.bad_steps == 0


@pytest.mark.parametrize(
    ("condition", "left_out"),
    [
        ("no gravity", ""),
        ("no field", "field_left_out"),
        ("gravity of a million g", "no_attitude"),
        ("a field too large", "field_left_out"),
        ("acceleration", ""),
    ],
)
def test_fusion_keeps_its_attitude_without_gravity_or_field(
    board: Board, slot: int, condition: str, left_out: str
) -> None:
    gain, soft_iron = (
        DEGENERATE.get(condition)
        or {
            "gravity of a million g": (1e8 * GRAVITY, FIELD),
            "a field too large": (GRAVITY, 1e8 * FIELD),
            "acceleration": (2.0 * GRAVITY, FIELD),
        }[condition]
    )
    calibrate(board, slot, gain, soft_iron)
    if condition != "acceleration":  # a start uses the direction of gravity only
        with pytest.raises(DeviceError) as refused:
            board.session.request(start(slot))
        assert refused.value.status == Status.DEGENERATE_FIELD.name
    calibrate(board, slot, GRAVITY, FIELD)
    first = board.session.request(start(slot))
    calibrate(board, slot, gain, soft_iron)
    summary, records = run(board)
    for name in ("no_attitude", "field_left_out"):
        assert getattr(summary, name) == (summary.costs.updates if name == left_out else 0), name
    assert np.isnan(records.measured).all() == (condition != "acceleration")
    # A gyroscope bias of 25 deg/s turns the attitude by 1.5 degrees.
    assert np.abs(records.fused @ first).min() > np.cos(np.radians(1.0)), "the attitude moves without a measurement"


@pytest.mark.parametrize("rate_dps", [100.0, 8_000.0, -30_000.0, 40_000.0])
def test_fusion_turns_by_the_rate_that_the_calibration_says(board: Board, slot: int, rate_dps: float) -> None:
    calibrate(board, slot, GRAVITY, FIELD)
    board.session.request(start(slot))
    board.session.request(SetGyroscope(np.eye(3) / 16.0, [0.0, 0.0, -16.0 * rate_dps]))
    summary, records = run(board)
    if abs(rate_dps) > 36_000.0:  # half a turn in the 5 ms between two samples
        assert summary.bad_steps > 0
        return
    assert summary.bad_steps == 0
    seconds = 1e-6 * np.diff(records.time_us)
    cosines = (records.turned[:-1] * records.turned[1:]).sum(axis=1)
    # Cosines of half the angle; q and -q are the same attitude. The limit covers the gyroscope's drift and noise.
    expected = np.cos(np.radians(0.5 * rate_dps * seconds))
    error_deg = np.degrees(np.abs(np.arccos(np.clip(np.abs(cosines), 0, 1)) - np.arccos(np.abs(expected)))).max()
    assert error_deg < 0.5, f"at {rate_dps} deg/s the turned angle is wrong by {error_deg:.2f} degrees"
