"""Cycles of accelerometer fits, tilt-compensated heading and updates of the attitude filter, over random attitudes."""

from __future__ import annotations

import numpy as np
import pytest
from numpy.typing import NDArray

from hiltest.boards import Board
from hiltest.calibration.still_pose import FACES, Face, StillPose
from hiltest.errors import ConfigError
from hiltest.link.accelerometer import FitAccelerometer
from hiltest.link.poses import MAX_TRANSFER, ClearPoses, UploadPoses
from hiltest.orientation.angles import Pose, rotation_body_from_ned, sin_cos_deg
from hiltest.orientation.quaternions import from_pose, normalised, pose_of
from hiltest.procedures import spread_poses
from hiltest.session.benchmark_hooks import BenchmarkCycles
from hiltest.session.fixtures import Cycles
from hiltest.virtual.calls.procedure_call import Argument
from hiltest.virtual.counts.profiling import CallProfile
from hiltest.virtual.profiling.image import ProfiledImage

COUNTS_PER_G = 8192.0
FIELD_UT, DIP_DEG = 48.5, 62.0
# Random attitudes, as in firmware_stub/DESIGN.md. At multiples of 90 degrees arc tangents return early, and a heading
# takes half of the usual cycles.
ATTITUDES = [pose_of(normalised(quaternion)) for quaternion in np.random.default_rng(1).normal(size=(300, 4))]
RATE_RAD_S = np.array([0.1, -0.2, 0.5], np.float32)
STEP_S = 0.005


@pytest.mark.hil
@pytest.mark.parametrize(
    ("method", "poses"),
    [("six-position", [face.pose for face in FACES]), ("ellipsoid", spread_poses(12)), ("ellipsoid", spread_poses(40))],
    ids=["six faces", "ellipsoid of 12", "ellipsoid of 40"],
)
def test_accelerometer_fit(board: Board, method: str, poses: list[Pose], benchmark_cycles: BenchmarkCycles) -> None:
    faces = FACES if method == "six-position" else [Face.NONE] * len(poses)
    still = [still_pose(pose, face) for pose, face in zip(poses, faces, strict=True)]
    board.session.request(ClearPoses())
    for first in range(0, len(still), MAX_TRANSFER):
        board.session.request(UploadPoses(first, still[first : first + MAX_TRANSFER]))
    reply = board.session.request(FitAccelerometer(len(still), method))
    assert reply.solution.status == 0, reply.solution.status.name
    if reply.cost is None:
        pytest.skip("this core counts no cycles")
    benchmark_cycles("accelerometer fit", reply.cost.cycles, cycle_model=board.cycle_model)


@pytest.fixture(scope="module")
def firmware(cycles: Cycles) -> ProfiledImage:
    """The firmware under test, whose functions are called on a virtual board of their own."""
    return cycles()


def test_tilt_heading(firmware: ProfiledImage, benchmark_cycles: BenchmarkCycles) -> None:
    headings = [call(firmware, "tilt_heading", *body_vectors(pose), *angles()) for pose in ATTITUDES]
    benchmark_cycles("heading", headings)


def test_attitude_filter_turn(firmware: ProfiledImage, benchmark_cycles: BenchmarkCycles) -> None:
    turns = [call(firmware, "attitude_filter_turn", state(pose), RATE_RAD_S, STEP_S) for pose in ATTITUDES]
    benchmark_cycles("attitude filter", turns)


def test_attitude_filter_update(firmware: ProfiledImage, benchmark_cycles: BenchmarkCycles) -> None:
    # The state is a few degrees off the measured attitude.
    inputs = [(state(nearby(pose)), RATE_RAD_S, *body_vectors(pose), STEP_S) for pose in ATTITUDES]
    benchmark_cycles("attitude filter", [call(firmware, "attitude_filter_update", *arguments) for arguments in inputs])


def call(firmware: ProfiledImage, function: str, *arguments: Argument) -> CallProfile:
    """Call a function, check that it returns 0, and skip the test if the firmware has no function of this name."""
    try:
        profile = firmware.call(function, *arguments)
    except ConfigError as error:
        if "no function" not in str(error):
            raise
        pytest.skip(str(error))
    assert profile.value == 0, f"{function} returns {profile.value}"
    return profile


def body_vectors(pose: Pose) -> tuple[NDArray[np.float32], NDArray[np.float32]]:
    """Return gravity [g] and the field [uT] in the body frame."""
    sine, cosine = sin_cos_deg(DIP_DEG)
    down, field = (0.0, 0.0, 1.0), (FIELD_UT * cosine, 0.0, FIELD_UT * sine)
    gravity, body_field = (rotation_body_from_ned(pose) @ np.array(vector) for vector in (down, field))
    return gravity.astype(np.float32), body_field.astype(np.float32)


def still_pose(pose: Pose, face: Face) -> StillPose:
    """Return the averages of a perfect board at a pose, with the spread of noisy readings [counts]."""
    gravity_g, field_ut = body_vectors(pose)
    magnetometer, accelerometer = (10.0 * field_ut).astype(np.float64), np.rint(COUNTS_PER_G * gravity_g)
    return StillPose(magnetometer, np.full(3, 4.0), accelerometer.astype(np.float64), np.full(3, 8.0), 16, face)


def state(pose: Pose) -> NDArray[np.uint8]:
    """Return the filter's state (attitude_filter_t) at an attitude, long after its start."""
    sine, cosine = sin_cos_deg(DIP_DEG)
    no_bias, no_tilt_rate, age_s, uncorrected_s = (0.0, 0.0, 0.0), (0.0, 0.0), 100.0, 0.0
    field_ut = (FIELD_UT * cosine, FIELD_UT * sine)
    words = np.array([*from_pose(pose), *no_bias, *no_tilt_rate, *field_ut, age_s, uncorrected_s], np.float32)
    return np.append(np.frombuffer(words.tobytes(), np.uint8), np.array([1, 0, 0, 0], np.uint8))


def nearby(pose: Pose) -> Pose:
    """Return a pose a few degrees away."""
    return Pose(pose.heading_deg + 5.0, pose.pitch_deg + 2.0, pose.roll_deg - 2.0)


def angles() -> tuple[bytearray, bytearray, bytearray]:
    """Return output buffers for heading, pitch and roll."""
    return bytearray(4), bytearray(4), bytearray(4)
