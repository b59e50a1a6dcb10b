"""Commands: stored, cleared and refused data. These tests replace the board's points and one slot."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from hiltest.boards import Board
from hiltest.calibration import REFERENCES
from hiltest.calibration.accelerometer import COUNTS_PER_G, NOMINAL, AccelerometerStatus
from hiltest.calibration.fit import FitStatus
from hiltest.calibration.gyroscope import GyroscopeTurn, TurnsStatus
from hiltest.calibration.still_pose import FACES, Face, StillPose
from hiltest.errors import DeviceError
from hiltest.link.accelerometer import FitAccelerometer, GetAccelerometer, SetAccelerometer
from hiltest.link.dpi import FitDpi
from hiltest.link.framing import Frame
from hiltest.link.fusion import FusionRead, FusionRun, FusionStart
from hiltest.link.gyroscope import (
    FitGyroscope,
    GetGyroscope,
    GyroscopeRest,
    IntegrateGyroscope,
    LogGyroscope,
    SetGyroscope,
)
from hiltest.link.messages import (
    Average,
    Calibrate,
    ClearCalibration,
    ClearPoints,
    Collect,
    GetCalibration,
    Points,
    Read,
    Select,
    SetCalibration,
    TimeRange,
    Upload,
)
from hiltest.link.poses import AddPose, ClearPoses, Poses, UploadPoses
from hiltest.link.replies import Status
from hiltest.link.request import Request
from hiltest.link.streams import StreamFeed, StreamRemove, StreamReset, StreamState, StreamStateReply
from hiltest.procedures import Turntable
from hiltest.procedures.cycles import upload_points
from hiltest.procedures.golden_points import golden_points

pytestmark = pytest.mark.hil

POINTS = [(100, -20, 30), (-40, 500, 60), (70, 80, -900)]
FIRST = (np.diag([1.0, 2.0, 3.0]) + 0.25, [10.0, -20.0, 30.0])
SECOND = (np.diag([3.0, 1.0, 2.0]) - 0.125, [-5.0, 15.0, 40.0])
# Soft iron whose longest axis is three times the shortest.
STRONG = np.array([[1.5, 0.3, -0.2], [0.3, 0.9, 0.25], [-0.2, 0.25, 0.6]])
# Largest difference from float64, as a part of the field. On eight such sets it was 5e-6 at most, and 0.002 with the
# 16-bit sums of direct-fast and corrected.
FLOAT32 = dict.fromkeys(("direct-fast", "corrected"), 0.01)
# Compresses samples to a hundredth along (1, 1, 1).
TILTED_PLANE = np.eye(3) - 0.99 * np.full((3, 3), 1.0 / 3.0)
STREAMED = 120
SPREAD = [4.0, 4.0, 4.0]
# Counts of 1 g along each axis, not symmetric, and an offset.
RESPONSE = COUNTS_PER_G * np.array([[1.02, 0.04, -0.05], [-0.03, 0.97, 0.06], [0.05, -0.02, 1.01]])
OFFSET = np.array([160.0, -240.0, 80.0])


def test_a_slot_answers_by_the_calibration_it_was_given_last(board: Board) -> None:
    slot = board.identity.slots - 1
    for soft_iron, hard_iron in (FIRST, SECOND):
        board.session.request(SetCalibration(slot, soft_iron, hard_iron))
        board.session.request(SetAccelerometer(slot, soft_iron / COUNTS_PER_G, hard_iron))
        magnetometer, accelerometer = (
            board.session.request(GetCalibration(slot)),
            board.session.request(GetAccelerometer(slot)),
        )
        assert np.array_equal(magnetometer.soft_iron, soft_iron), (
            f"soft iron {magnetometer.soft_iron} after {soft_iron} was sent"
        )
        assert np.array_equal(magnetometer.hard_iron, hard_iron), (
            f"hard iron {magnetometer.hard_iron} after {hard_iron} was sent"
        )
        assert np.array_equal(accelerometer.gain, soft_iron / COUNTS_PER_G)
        assert np.array_equal(accelerometer.offset, hard_iron)


def test_a_cleared_slot_answers_none(board: Board, turntable: Turntable) -> None:
    slot = board.identity.slots - 1
    board.session.request(SetCalibration(slot, *FIRST))
    board.session.request(SetAccelerometer(slot, 2.0 * NOMINAL.gain, [1.0, 2.0, 3.0]))
    board.session.request(ClearCalibration(slot))
    with pytest.raises(DeviceError) as refused:
        board.session.request(GetCalibration(slot))
    assert refused.value.status == Status.NO_CALIBRATION.name
    turntable.rest()
    assert board.session.request(Average(1, 1 << slot)).headings[slot].status is Status.NO_CALIBRATION
    accelerometer = board.session.request(GetAccelerometer(slot))
    assert np.array_equal(accelerometer.offset, NOMINAL.offset), "a cleared slot keeps its accelerometer calibration"
    assert np.array_equal(accelerometer.gain, NOMINAL.gain), "an empty slot has another scale than the data sheet's"


def valid_requests(board: Board) -> list[Request[Any]]:
    """Return one valid request of each kind with fields that a board has to check."""
    calibrator, pose = board.identity.calibrators[0], faces(board)[0]
    requests: list[Request[Any]] = [
        Select(0),
        Read(0, 1),
        Collect(1),
        Upload(len(POINTS), POINTS),
        Points(0, 1),
        TimeRange(1),
        Average(1),
        Calibrate(1, calibrator),
        SetCalibration(0, *SECOND),
        GetCalibration(0),
        ClearCalibration(0),
        SetAccelerometer(0, *SECOND),
        GetAccelerometer(0),
        AddPose(1),
        Poses(0, 1),
        UploadPoses(0, [pose]),
        FitAccelerometer(1, "six-position"),
        FitDpi(1, 0),
        GyroscopeRest(1),
        IntegrateGyroscope(100),
        LogGyroscope(1),
        SetGyroscope(*SECOND),
        FusionStart(0, 1, 1),
        FusionRun(1),
        FusionRead(0, 1),
    ]
    for stream in board.identity.stream_calibrators[:1]:
        requests += [StreamReset(stream), StreamFeed(stream, 0, 1), StreamRemove(stream, 0, 1), StreamState(stream)]
    return requests


def refused_requests(board: Board) -> list[tuple[Request[Any], Status]]:
    """Return well-formed requests for objects that do not exist, each with the status that refuses it."""
    slots, calibrator, beyond = board.identity.slots, board.identity.calibrators[0], len(POINTS) + 1
    cases: list[tuple[Request[Any], Status]] = [
        (Select(99), Status.NO_SUCH_SENSOR),
        (Read(99, 1), Status.NO_SUCH_SENSOR),
        (Upload(beyond, POINTS), Status.BAD_ARGUMENT),
        (Points(beyond, 1), Status.BAD_ARGUMENT),
        (TimeRange(beyond), Status.TOO_FEW_POINTS),
        (Calibrate(beyond, calibrator), Status.TOO_FEW_POINTS),
        (Calibrate(1, "nobody"), Status.UNKNOWN_CALIBRATOR),
        (SetCalibration(slots, *SECOND), Status.BAD_ARGUMENT),
        (GetCalibration(slots), Status.BAD_ARGUMENT),
        (ClearCalibration(slots), Status.BAD_ARGUMENT),
        (SetAccelerometer(slots, *SECOND), Status.BAD_ARGUMENT),
        (GetAccelerometer(slots), Status.BAD_ARGUMENT),
        (FitAccelerometer(1, "nobody"), Status.UNKNOWN_CALIBRATOR),
        (FitDpi(beyond, 0), Status.TOO_FEW_POINTS),
        (FitAccelerometer(1, "six-position"), Status.TOO_FEW_POINTS),
    ]
    for stream in board.identity.stream_calibrators[:1]:
        cases += [
            (StreamReset("nobody"), Status.UNKNOWN_CALIBRATOR),
            (StreamState("nobody"), Status.UNKNOWN_CALIBRATOR),
            (StreamFeed("nobody", 0, 1), Status.UNKNOWN_CALIBRATOR),
            (StreamFeed(stream, beyond, 1), Status.TOO_FEW_POINTS),
        ]
    return cases


def test_a_request_that_makes_no_sense_is_refused_and_changes_nothing(board: Board) -> None:
    session, slot = board.session, 0
    session.request(ClearPoints())
    session.request(ClearPoses())
    session.request(Upload(0, POINTS))
    session.request(SetCalibration(slot, *FIRST))
    gyroscope = session.request(GetGyroscope())
    for request, status in refused_requests(board):
        with pytest.raises(DeviceError) as refused:
            session.request(request)
        assert refused.value.status == status.name, f"{request} is refused with {refused.value.status}"
    for request in valid_requests(board):
        payload = request.payload()
        # A byte too few, a byte too many, and all bits set: the largest number, or NaN, in each field.
        for wrong in (payload[:-1], payload + b"\0", b"\xff" * len(payload)):
            reply = session.exchange_raw(session.numbered(request.code, wrong))
            assert reply is not None, f"{request} as {wrong.hex(' ')} is not answered"
            assert reply.payload[0] != Status.OK, f"{request} as {wrong.hex(' ')} is not refused"
    assert session.request(Points(0, 10)).magnetometer.tolist() == [list(point) for point in POINTS]
    assert np.array_equal(session.request(GetCalibration(slot)).soft_iron, FIRST[0])
    assert np.array_equal(session.request(GetGyroscope()).matrix, gyroscope.matrix)
    session.request(ClearCalibration(slot))
    session.request(ClearPoints())


def test_another_payload_is_another_request_whatever_its_sequence_number(board: Board) -> None:
    session = board.session
    session.request(ClearPoints())
    frame = session.next_frame(Upload(0, [(1, 2, 3)]))
    other = Frame(frame.type, frame.sequence, Upload(1, [(4, 5, 6)]).payload())
    first, second = session.exchange_raw(frame), session.exchange_raw(other)
    assert first is not None
    assert second is not None
    assert first.payload != second.payload, "another request with the same sequence number got the answer of the first"


@pytest.mark.parametrize("noise_counts", [0.0, 24.0])
def test_strongly_distorted_samples_are_fitted_as_in_float64(board: Board, noise_counts: float) -> None:
    golden = golden_points(150)
    noise = np.random.default_rng(0).normal(0.0, 1.0, golden.shape) * noise_counts
    points = np.rint((golden - golden.mean(axis=0)) @ STRONG.T + [300.0, -200.0, 100.0] + noise).astype(np.int16)
    upload_points(board, points)
    for calibrator in sorted(REFERENCES.keys() & set(board.identity.calibrators)):
        fits = board.session.request(Calibrate(len(points), calibrator)).calibration, REFERENCES[calibrator](points)
        board_field, float64_field = ((points - fit.hard_iron) @ fit.soft_iron.reshape(3, 3).T for fit in fits)
        error = np.abs(board_field - float64_field).max()
        assert error < FLOAT32.get(calibrator, 2e-5), f"{calibrator} differs from float64 by {error:.2g} of the field"


@pytest.mark.parametrize(
    ("samples", "statuses"),
    [
        ("few", {FitStatus.TOO_FEW_POINTS}),
        ("on a plane", {FitStatus.POOR_COVERAGE, FitStatus.SINGULAR, FitStatus.NOT_AN_ELLIPSOID}),
        ("about a tilted plane", {FitStatus.POOR_COVERAGE, FitStatus.SINGULAR, FitStatus.NOT_AN_ELLIPSOID}),
        ("all the same", {FitStatus.POOR_COVERAGE, FitStatus.SINGULAR, FitStatus.NOT_AN_ELLIPSOID}),
    ],
    ids=["few", "on a plane", "about a tilted plane", "all the same"],
)
def test_a_poor_distribution_of_samples_is_refused(board: Board, samples: str, statuses: set[FitStatus]) -> None:
    points = {
        "few": golden_points(8),
        "on a plane": golden_points(100) * np.array([1, 1, 0], dtype=np.int16),
        "about a tilted plane": np.rint(golden_points(100) @ TILTED_PLANE).astype(np.int16),
        "all the same": np.repeat(golden_points(1), 100, axis=0),
    }[samples]
    upload_points(board, points)
    for calibrator in board.identity.calibrators:
        reply = board.session.request(Calibrate(len(points), calibrator))
        assert reply.fit in statuses, f"{calibrator} answers {reply.fit.name} to samples that are {samples}"


def test_a_calibrator_that_knows_its_coverage_refuses_a_cap(board: Board) -> None:
    points = golden_points(300)
    centred = points - points.mean(axis=0)
    cap = points[centred[:, 2] > 0.7 * np.linalg.norm(centred, axis=1)]  # 45 degrees about an axis
    upload_points(board, cap)
    for calibrator in board.identity.calibrators:
        reply = board.session.request(Calibrate(len(cap), calibrator))
        if reply.coverage:
            assert reply.fit is not FitStatus.ELLIPSOID, f"{calibrator} fits a cap of coverage {reply.coverage:.0f}"


def stream_state(board: Board, stream: str, *, first: int, removed: int = 0) -> StreamStateReply | None:
    """Return a stream's state after feeding points and removing the first ones; None if it cannot remove points."""
    session = board.session
    session.request(StreamReset(stream))
    for at in range(first, STREAMED, 20):
        session.request(StreamFeed(stream, at, 20))
    if removed:
        try:
            session.request(StreamRemove(stream, 0, removed))
        except DeviceError as error:
            if error.status != Status.NOT_SUPPORTED.name:
                raise
            return None
    state = session.request(StreamState(stream))
    session.request(StreamReset(stream))
    return state


def test_points_that_a_stream_gives_back_leave_no_trace(board: Board) -> None:
    upload_points(board, golden_points(STREAMED))
    for stream in board.identity.stream_calibrators:
        without_first = stream_state(board, stream, first=20)
        first_removed = stream_state(board, stream, first=0, removed=20)
        if first_removed is None:
            continue
        assert without_first is not None
        assert first_removed.held == without_first.held
        expected, actual = without_first.calibration, first_removed.calibration
        # float32 sums about different anchors, for counts of some hundred and a gain of 1/485.
        assert np.abs(actual.hard_iron - expected.hard_iron).max() < 0.01, f"{stream} keeps traces of removed points"
        assert np.abs(actual.soft_iron - expected.soft_iron).max() < 1e-4 * np.abs(expected.soft_iron).max()


def test_turns_are_fitted_without_their_bias(board: Board) -> None:
    # Counts of one deg/s, not symmetric, and a bias that drifts by a count between the rests around each turn.
    response = np.array([[16.2, 0.15, -0.2], [-0.1, 15.8, 0.1], [0.25, -0.3, 16.3]])
    bias, n, duration_s = np.array([24.0, -33.0, 19.0]), 1001, 5.0
    turns = [
        GyroscopeTurn(
            turned,
            np.rint((n - 1) / duration_s * (response @ turned) + n * bias).astype(np.int64),
            n,
            duration_s,
            bias - 0.5,
            bias + 0.5,
        )
        for turned in 360.0 * np.vstack([np.eye(3), -np.eye(3)])
    ]
    stored = board.session.request(GetGyroscope())
    fit = board.session.request(FitGyroscope(turns)).fit
    board.session.request(SetGyroscope(stored.matrix, stored.bias))
    assert fit.status is TurnsStatus.OK
    # float32, and sums rounded to whole counts: 3e-6 of a turn.
    error = np.abs(fit.matrix @ response - np.eye(3)).max()
    assert error < 1e-4, f"the fitted matrix differs from the inverse of the response by {error:.2g}"


def faces(board: Board) -> list[StillPose]:
    """Clear the board's pose buffer, and return still poses of the six faces."""
    board.session.request(ClearPoses())
    return [
        StillPose(
            np.array([100.0, 200.0, 300.0]),
            np.array(SPREAD),
            RESPONSE @ face.gravity_g + OFFSET,
            np.array(SPREAD),
            64,
            face,
        )
        for face in FACES
    ]


def test_six_faces_give_gain_and_offset(board: Board) -> None:
    board.session.request(UploadPoses(0, faces(board)))
    fit = board.session.request(FitAccelerometer(len(FACES), "six-position")).solution.fit
    board.session.request(ClearPoses())
    # float32: 1e-6 of 1 g.
    error_g = np.abs(fit.gain @ RESPONSE - np.eye(3)).max()
    assert error_g < 1e-5, f"the fitted gain differs from the inverse of the response by {error_g:.2g}"
    assert np.abs(fit.offset - OFFSET).max() < 0.05, f"the fitted offset is {fit.offset}, the true one {OFFSET}"


@pytest.mark.parametrize(
    ("wrong", "status"),
    [
        ("none", AccelerometerStatus.OK),
        ("missing", AccelerometerStatus.MISSING_FACE),
        ("repeated", AccelerometerStatus.REPEATED_FACE),
        ("misplaced", AccelerometerStatus.MISPLACED_FACE),
        ("askew by 30 degrees", AccelerometerStatus.MISPLACED_FACE),
        ("moving", AccelerometerStatus.MOVED),
    ],
    ids=["none", "missing", "repeated", "misplaced", "askew", "moving"],
)
def test_a_face_that_is_wrong_is_refused(board: Board, wrong: str, status: AccelerometerStatus) -> None:
    poses = faces(board)
    changed_pose = poses[Face.MINUS_X]
    changed = {
        "none": poses,
        "missing": [pose for pose in poses if pose is not changed_pose],
        "repeated": [*poses, changed_pose],
        "misplaced": [
            with_gravity(pose, poses[Face.PLUS_Y].accelerometer) if pose is changed_pose else pose for pose in poses
        ],
        "askew by 30 degrees": [
            with_gravity(pose, COUNTS_PER_G * np.array([-np.sqrt(0.75), 0.5, 0.0])) if pose is changed_pose else pose
            for pose in poses
        ],
        "moving": [
            with_gravity(pose, pose.accelerometer, spread=100.0) if pose is changed_pose else pose for pose in poses
        ],
    }[wrong]
    board.session.request(UploadPoses(0, changed))
    solution = board.session.request(FitAccelerometer(len(changed), "six-position")).solution
    board.session.request(ClearPoses())
    assert solution.status is status, f"the status is {solution.status.name} if one face is {wrong}"


def with_gravity(pose: StillPose, counts: np.ndarray, *, spread: float = SPREAD[0]) -> StillPose:
    """Return the pose with other accelerometer readings."""
    return StillPose(pose.magnetometer, pose.magnetometer_spread, counts, np.full(3, spread), pose.readings, pose.face)
