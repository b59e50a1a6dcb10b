"""Attitudes under calibrations that turn the board over, stretch what it senses or leave nothing of it; it rests."""

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
# Seen so, a level board lies on each of its sides, on its back, or somewhere between.
TURNED = [
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
# All of gravity, or of the field, on the x axis: exactly straight up or down, and parallel.
ON_X = np.outer([1.0, 0.0, 0.0], [0.0, 0.0, 1.0])
GRAVITY, FIELD = NOMINAL.gain, SOFT_IRON
# The largest and the smallest that float32 has room for, and beyond.
STRETCHED = {
    "gravity straight down": (ON_X @ GRAVITY, FIELD),
    "gravity straight up": (-ON_X @ GRAVITY, FIELD),
    "huge gravity": (2.2e34 * np.eye(3), FIELD),
    "tiny gravity": (1e-36 * np.eye(3), FIELD),
    "huge field": (GRAVITY, 1e34 * np.eye(3)),
    "tiny field": (GRAVITY, 1e-36 * np.eye(3)),
}
NOWHERE = {
    "no gravity": (0.0 * GRAVITY, FIELD),
    "no field": (GRAVITY, 0.0 * FIELD),
    "gravity along the field": (ON_X @ GRAVITY, ON_X @ FIELD),
    "infinite gravity": (3e38 * np.eye(3), FIELD),
    "infinite field": (GRAVITY, 3e38 * np.eye(3)),
}


@pytest.fixture
def slot(board: Board, turntable: Turntable) -> Iterator[int]:
    """The last slot, for calibrations of a resting board; the gyroscope's is put back."""
    turntable.rest()
    gyroscope = board.session.request(GetGyroscope())
    yield board.identity.slots - 1
    board.session.request(SetGyroscope(gyroscope.matrix, gyroscope.bias))
    board.session.request(ClearCalibration(board.identity.slots - 1))


def calibrate(board: Board, slot: int, gain: Reals, soft_iron: Reals) -> None:
    board.session.request(SetAccelerometer(slot, gain, np.zeros(3)))
    board.session.request(SetCalibration(slot, soft_iron, np.zeros(3)))


def test_headings_are_those_of_float64_whatever_the_calibration(board: Board, slot: int) -> None:
    turned = {str(each): rotation_body_from_ned(each) for each in TURNED}
    every = {name: (turn @ GRAVITY, turn @ FIELD) for name, turn in turned.items()} | STRETCHED | NOWHERE
    for name, (gain, soft_iron) in every.items():
        calibrate(board, slot, gain, soft_iron)
        reply = board.session.request(Average(1, 1 << slot))
        found = reply.headings[slot]
        with np.errstate(over="ignore"):
            seen = [
                (matrix @ mean).astype(np.float32)
                for matrix, mean in ((gain, reply.accelerometer.mean), (soft_iron, reply.magnetometer.mean))
            ]
        try:
            wanted = tilt_heading(*seen)
        except DegenerateFieldError:
            assert found.status is Status.DEGENERATE_FIELD, f"{name}: {found.attitude}"
            continue
        assert name not in NOWHERE
        assert found.status is Status.OK, f"{name}: {found.status.name}"
        assert found.attitude is not None
        off = np.abs(rotation_body_from_ned(found.attitude) - rotation_body_from_ned(wanted)).max()
        assert off < 1e-4, f"{name}: {found.attitude} where float64 has {wanted}"  # float32: 2e-6


def start(slot: int, *, gate_g: float = 0.5) -> FusionStart:
    return FusionStart(slot, 1, 16, 0.2, 1.0, 1.0, gate_g)


def run(board: Board, seconds: float = 0.06) -> tuple[FusionSummary, FusionRecords]:
    """Run the filter for a moment, and return what it kept."""
    summary = board.session.request(FusionRun(round(1e6 * seconds)))
    return summary, board.session.request(FusionRead(0))


def test_fusion_begins_and_stays_in_any_attitude(board: Board, slot: int, rig: Rig) -> None:
    rest = board.session.request(Average(16))
    gravity, field_counts = rest.accelerometer.mean, rest.magnetometer.mean
    level_counts = np.linalg.norm(np.cross(gravity, field_counts)) / np.linalg.norm(gravity)
    noise_deg = np.degrees(10.0 * rig.sensors.magnetometer_noise_ut / level_counts)
    calibrate(board, slot, GRAVITY, FIELD)
    level = rotation_ned_from_body(board.session.request(start(slot)))
    for each in TURNED:
        turn = rotation_body_from_ned(each)
        calibrate(board, slot, turn @ GRAVITY, turn @ FIELD)
        first = board.session.request(start(slot))
        summary, records = run(board)
        wanted = from_ned_axes(level @ turn.T)
        # Two degrees are the accelerometer's noise and what a gyroscope of 25 deg/s of bias turns by meanwhile.
        for name, attitudes, readings in (
            ("first", first, 16),
            ("fused", records.fused, 16),
            ("turned", records.turned, 16),
            ("measured", records.measured, 1),
        ):
            off_deg = 2.0 * np.degrees(np.arccos(np.clip(np.abs(attitudes @ wanted), 0.0, 1.0))).max()
            limit_deg = 2.0 + 6.0 * noise_deg * np.sqrt(1.0 / readings + 1.0 / 16.0)
            assert off_deg < limit_deg, f"{each}: the {name} attitude is {off_deg:.1f} degrees off the board's"
        assert summary.no_attitude == summary.accelerated == summary.bad_steps == 0


@pytest.mark.parametrize(
    "what",
    [
        "no gravity",
        "no field",
        "gravity along the field",
        "gravity of a million g",
        "a field too large",
        "acceleration",
    ],
)
def test_fusion_leaves_out_what_is_no_attitude(board: Board, slot: int, what: str) -> None:
    more = {
        "gravity of a million g": (1e8 * GRAVITY, FIELD),
        "a field too large": (GRAVITY, 1e8 * FIELD),
        "acceleration": (2.0 * GRAVITY, FIELD),
    }
    gain, soft_iron = (NOWHERE | more)[what]
    calibrate(board, slot, gain, soft_iron)
    if what != "acceleration":  # a start looks for the direction alone
        with pytest.raises(DeviceError) as refused:
            board.session.request(start(slot))
        assert refused.value.status == Status.DEGENERATE_FIELD.name
    calibrate(board, slot, GRAVITY, FIELD)
    first = board.session.request(start(slot))
    calibrate(board, slot, gain, soft_iron)
    summary, records = run(board)
    left_out = (summary.no_attitude, summary.accelerated)
    assert left_out == ((0, summary.updated.steps) if what == "acceleration" else (summary.updated.steps, 0))
    assert np.isnan(records.measured).all() == (what != "acceleration")
    # 25 deg/s of the gyroscope's bias turn it by 1.5 degrees.
    assert np.abs(records.fused @ first).min() > np.cos(np.radians(1.0)), "nothing was measured, and the attitude moves"


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
    along = (records.turned[:-1] * records.turned[1:]).sum(axis=1)
    # Of half the angle; either sign of a quaternion is the same attitude. The resting gyroscope drifts and is noisy.
    wanted = np.cos(np.radians(0.5 * rate_dps * seconds))
    off_deg = np.degrees(np.abs(np.arccos(np.clip(np.abs(along), 0, 1)) - np.arccos(np.abs(wanted)))).max()
    assert off_deg < 0.5, f"turned by another angle than {rate_dps} deg/s make: {off_deg:.2f} degrees off"
