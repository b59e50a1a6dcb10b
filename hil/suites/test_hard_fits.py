"""Fits of data that barely determine a result must be right or refused. The board's points and poses are replaced."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace

import numpy as np
import pytest
from numpy.typing import NDArray

from hiltest.boards import Board
from hiltest.calibration import REFERENCES
from hiltest.calibration.accelerometer import COUNTS_PER_G, NOMINAL, AccelerometerStatus
from hiltest.calibration.fit import LARGEST_DIRECTION_ERROR_DEG, FitStatus
from hiltest.calibration.gyroscope import GyroscopeTurn, TurnsStatus
from hiltest.calibration.sphere import fit_sphere
from hiltest.calibration.still_pose import FACES as FACES_DOWN
from hiltest.calibration.still_pose import Face, StillPose
from hiltest.link.accelerometer import FitAccelerometer
from hiltest.link.dpi import DpiSource, FitDpi
from hiltest.link.gyroscope import FitGyroscope
from hiltest.link.messages import Calibrate, ClearCalibration
from hiltest.link.poses import MAX_TRANSFER, ClearPoses, UploadPoses
from hiltest.link.replies import CalibrateReply, CalibrationReply
from hiltest.link.streams import StreamReset, StreamState, StreamStateReply
from hiltest.procedures import upload_pairs, upload_points
from hiltest.procedures.golden_points import golden_pairs
from hiltest.procedures.streams import feed

pytestmark = [pytest.mark.hil, pytest.mark.full]

Reals = NDArray[np.float64]
Counts = NDArray[np.int16]

FIELD_COUNTS, NOISE_COUNTS = 485.0, 4.0
SOFT_IRON = np.array([[1.1, 0.08, -0.05], [0.08, 0.95, 0.06], [-0.05, 0.06, 1.0]])
HARD_IRON = np.array([300.0, -200.0, 100.0])
# Field that spans -32768 to 32767 on the x axis.
LARGEST = 32768.0 / SOFT_IRON[0, 0]
FAR_HARD_IRON = np.array([-6_000.0, 24_000.0, 6_000.0])
# Largest error of a right fit, as a part of the field. Noise is 0.008 of the field; points from half of a sphere give
# an error of 0.03 on the other half.
LARGEST_ERROR = 0.06
# Largest difference between float32 and float64 if the points barely determine the fit: 0.003 measured.
FLOAT64_DIFFERENCE = 0.01


def directions(n: int) -> Reals:
    """Return evenly spread directions over the sphere."""
    height = 1.0 - (2.0 * np.arange(n) + 1.0) / n
    turn = np.pi * (3.0 - np.sqrt(5.0)) * np.arange(n)
    across = np.sqrt(1.0 - height**2)
    return np.column_stack([across * np.cos(turn), across * np.sin(turn), height])


def sensed(
    along: Reals, *, field: float = FIELD_COUNTS, hard_iron: Reals = HARD_IRON, noise: float = NOISE_COUNTS
) -> Counts:
    """Return readings of a distorted sensor for a field along the directions [counts]."""
    random = np.random.default_rng(1).normal(0.0, 1.0, along.shape)
    return np.rint(field * along @ SOFT_IRON + hard_iron + noise * random).clip(-32768, 32767).astype(np.int16)


ALL_ROUND = directions(120)
MANY = directions(400)
FACES = np.vstack([np.eye(3), -np.eye(3)])
CORNERS = np.array([[x, y, z] for x in (-1, 1) for y in (-1, 1) for z in (-1, 1)]) / np.sqrt(3.0)
TURN = np.arange(100) * 2.0 * np.pi / 100
RING = np.column_stack([np.cos(TURN), np.sin(TURN), 0.0 * TURN])
AROUND, ALONG = np.tile(np.arange(12) * np.pi / 6, 10), np.repeat(np.linspace(-1.0, 1.0, 10), 12)


def surface(across: Reals, height: Reals) -> Counts:
    """Return points of a surface of revolution [counts]."""
    return np.rint(np.column_stack([across * np.cos(AROUND), across * np.sin(AROUND), height])).astype(np.int16)


# Points, with the true field and hard iron.
DETERMINED: dict[str, tuple[Counts, float, Reals]] = {
    "all round": (sensed(ALL_ROUND), FIELD_COUNTS, HARD_IRON),
    "half a sphere": (sensed(MANY[MANY[:, 2] > 0.0]), FIELD_COUNTS, HARD_IRON),
    "fifteen points": (sensed(directions(15)), FIELD_COUNTS, HARD_IRON),
    "an odd number of points": (sensed(directions(101)), FIELD_COUNTS, HARD_IRON),
    "three rings": (sensed(np.vstack([np.roll(RING, by, axis=1) for by in range(3)])), FIELD_COUNTS, HARD_IRON),
    "faces and corners, again and again": (
        sensed(np.repeat(np.vstack([FACES, CORNERS]), 8, axis=0)),
        FIELD_COUNTS,
        HARD_IRON,
    ),
    "a hard iron of 2.5 mT": (sensed(ALL_ROUND, hard_iron=FAR_HARD_IRON), FIELD_COUNTS, FAR_HARD_IRON),
    "a field of 2 uT": (sensed(ALL_ROUND, field=20.0, noise=0.0), 20.0, HARD_IRON),
    "the largest counts": (
        sensed(np.vstack([ALL_ROUND, FACES]), field=LARGEST, hard_iron=np.zeros(3), noise=0.0),
        LARGEST,
        np.zeros(3),
    ),
}
# Points that determine no ellipsoid, whatever the fit.
UNDETERMINED: dict[str, Counts] = {
    "eight points": sensed(directions(8)),
    "one point again and again": np.repeat(sensed(ALL_ROUND[:1]), 100, axis=0),
    "two points again and again": np.repeat(sensed(ALL_ROUND[:2]), 50, axis=0),
    "a line": sensed(np.outer(np.linspace(-1.0, 1.0, 100), [1.0, 0.5, 0.2])),
    "an axis": sensed(np.outer(np.linspace(-1.0, 1.0, 100), [1.0, 0.0, 0.0]), noise=0.0),
    "a plane": np.rint(FIELD_COUNTS * ALL_ROUND * [0.0, 1.0, 1.0]).astype(np.int16),
    "about a plane": sensed(ALL_ROUND * [1.0, 1.0, 0.0]),
    "a ring": sensed(RING),
    "the six faces, again and again": sensed(np.repeat(FACES, 15, axis=0)),
}
# Points that several ellipsoids fit closely; a calibrator that reports its coverage must refuse them, unless its
# directions are right.
TOO_LITTLE: dict[str, Counts] = {
    "a ring and a point": sensed(np.vstack([RING, [[0.0, 0.0, 1.0]]])),
    "two rings": sensed(np.vstack([RING, np.roll(RING, 1, axis=1)])),
    "the corners of a cube": sensed(np.repeat(CORNERS, 12, axis=0)),
    "a cap of 45 degrees": sensed(MANY[MANY[:, 2] > 0.7]),
    "a tilted cap of 60 degrees": sensed(MANY[MANY @ [0.6, 0.64, 0.48] > 0.5]),
}
# Points of other surfaces, or with one outlier: a calibrator may fit them, and the residual shows the misfit.
OTHER_SHAPES: dict[str, Counts] = {
    "a hyperboloid": surface(500.0 * np.cosh(ALONG), 500.0 * np.sinh(ALONG)),
    "two sheets": surface(300.0 * np.sinh(ALONG + 1.1), 300.0 * np.sign(ALONG) * np.cosh(ALONG + 1.1)),
    "a cylinder": surface(np.full(120, 500.0), 500.0 * ALONG),
    "a cone": surface(500.0 * ALONG, 500.0 * ALONG),
    "one point far out": sensed(ALL_ROUND) + np.outer(np.arange(120) == 60, [0, 5000, 0]).astype(np.int16),
    "one point very far out": sensed(ALL_ROUND) + np.outer(np.arange(120) == 60, [0, 20_000, 0]).astype(np.int16),
    "noise as large as the field": sensed(ALL_ROUND, noise=FIELD_COUNTS),
    "a box": np.random.default_rng(3).integers(-500, 500, (100, 3)).astype(np.int16),
    "thin as a disc": np.rint(sensed(ALL_ROUND) * [1.0, 0.02, 1.0]).astype(np.int16),
    "long as a needle": (sensed(ALL_ROUND) * np.array([10, 1, 1])).astype(np.int16),
}


def calibrated(reply: CalibrationReply, points: Counts | Reals) -> Reals:
    """Return the points after calibration, in units of the field."""
    return np.asarray((points - reply.hard_iron) @ reply.soft_iron.reshape(3, 3).T, dtype=np.float64)


def largest_norm_error(reply: CalibrationReply, field: float, hard_iron: Reals) -> float:
    """Return the largest deviation from 1 of the calibrated norm, over the sphere."""
    everywhere = field * directions(500) @ SOFT_IRON + hard_iron
    return float(np.abs(np.linalg.norm(calibrated(reply, everywhere), axis=1) - 1.0).max())


def direction_error_deg(reply: CalibrationReply) -> float:
    """Return the rms error of directions over the sphere [deg]."""
    true = directions(500)
    vectors = calibrated(reply, FIELD_COUNTS * true @ SOFT_IRON + HARD_IRON)
    cosines = (vectors * true).sum(axis=1) / np.linalg.norm(vectors, axis=1)
    return float(np.degrees(np.sqrt((np.arccos(np.clip(cosines, -1.0, 1.0)) ** 2).mean())))


def is_confident(reply: CalibrateReply | StreamStateReply) -> bool:
    """Return whether the reply is an ellipsoid, and not the sphere that replaces one."""
    return reply.fit is FitStatus.ELLIPSOID and not reply.is_sphere


def replies(board: Board, points: Counts) -> Iterator[tuple[str, CalibrateReply]]:
    """Yield each calibrator's reply; a sphere is compared with the least-squares sphere first."""
    upload_points(board, points)
    for name in board.identity.calibrators:
        reply = board.session.request(Calibrate(len(points), name))
        assert not (reply.fit is FitStatus.ELLIPSOID and reply.is_sphere), f"{name}: a sphere passes for an ellipsoid"
        if reply.is_sphere:
            sphere = fit_sphere(points)
            error = np.abs(calibrated(reply.calibration, points) - sphere.corrected(points)).max()
            assert error < FLOAT64_DIFFERENCE, (
                f"{name}: the sphere is {error:.2g} of the field off the least-squares one"
            )
        yield name, reply


@pytest.mark.parametrize("name", DETERMINED)
def test_points_that_determine_an_ellipsoid_are_fitted(board: Board, name: str) -> None:
    points, field, hard_iron = DETERMINED[name]
    for calibrator, reply in replies(board, points):
        assert is_confident(reply), f"{calibrator} answers {reply.fit.name}"
        error = largest_norm_error(reply.calibration, field, hard_iron)
        assert error < LARGEST_ERROR, (
            f"{calibrator} fits an ellipsoid that is {error:.2g} of the field off the true one"
        )


@pytest.mark.parametrize("name", UNDETERMINED)
def test_points_that_determine_nothing_are_refused(board: Board, name: str) -> None:
    for calibrator, reply in replies(board, UNDETERMINED[name]):
        assert not is_confident(reply), f"{calibrator} fits an ellipsoid to {name}"


@pytest.mark.parametrize("name", [*TOO_LITTLE, *OTHER_SHAPES])
def test_what_is_fitted_all_the_same_is_the_fit_of_float64(board: Board, name: str) -> None:
    points = TOO_LITTLE[name] if name in TOO_LITTLE else OTHER_SHAPES[name]
    for calibrator, reply in replies(board, points):
        if not is_confident(reply):
            continue
        if name in TOO_LITTLE and reply.coverage:
            error = direction_error_deg(reply.calibration)
            # The limit is one for the predicted rms error, and a single fit may err by twice as much.
            assert error <= 2.0 * LARGEST_DIRECTION_ERROR_DEG, f"{calibrator}: {name} errs by {error:.2g} deg rms"
        if calibrator in REFERENCES and (reference := REFERENCES[calibrator](points)).status is FitStatus.ELLIPSOID:
            error = np.abs(calibrated(reply.calibration, points) - reference.corrected(points)).max()
            assert error < FLOAT64_DIFFERENCE, f"{calibrator}: {name} is {error:.2g} of the field off float64"


# Points for a stream, and the true field; 0 if the points determine no ellipsoid.
STREAMED: dict[str, tuple[Counts, float]] = {
    "all round": (np.random.default_rng(2).permutation(sensed(directions(500))), FIELD_COUNTS),
    "a field of 0.5 uT": (sensed(directions(60), field=5.0, noise=0.0), 5.0),
    "a field of 150 uT": (sensed(directions(180), field=1500.0), 1500.0),
    "a plane": (np.rint(FIELD_COUNTS * directions(180) * [1.0, 1.0, 0.01]).astype(np.int16), 0.0),
    "one point": (np.repeat(sensed(ALL_ROUND[:1]), 60, axis=0), 0.0),
    "eight points": (sensed(directions(8)), 0.0),
    "a hyperboloid": (np.tile(OTHER_SHAPES["a hyperboloid"], (3, 1)), 0.0),
}


@pytest.mark.parametrize(("name", "times"), [*((name, 1) for name in STREAMED), ("all round", 4)])
def test_a_stream_is_right_or_knows_that_it_is_not(board: Board, name: str, times: int) -> None:
    # A solver that runs one slice per point needs some thousand points for an ellipsoid.
    points, field = STREAMED[name]
    upload_points(board, points)
    for stream in board.identity.stream_calibrators:
        board.session.request(StreamReset(stream, sliced=times > 1))
        for _ in range(times):
            feed(board, stream, 0, len(points))
        state = board.session.request(StreamState(stream))
        board.session.request(StreamReset(stream))
        if is_confident(state):
            assert field, f"{stream} fits an ellipsoid to {name}"
            error = largest_norm_error(state.calibration, field, HARD_IRON)
            assert error < LARGEST_ERROR, f"{stream}: {name} is {error:.2g} of the field off the truth"
        assert is_confident(state) or name != "all round", f"{stream} answers {state.fit.name} to points all round"


def pose(
    gravity_g: Reals,
    *,
    face: Face = Face.NONE,
    spread: float = 8.0,
    readings: int = 64,
    field: Reals = FIELD_COUNTS * ALL_ROUND[0],
) -> StillPose:
    """Return a still pose of an accelerometer with 8192 counts per g."""
    spreads = np.full(3, spread)
    return StillPose(field, spreads, COUNTS_PER_G * np.asarray(gravity_g), spreads, readings, face)


SIX = [pose(np.array(face.gravity_g), face=face) for face in FACES_DOWN]
# Readings of the six faces, each near its axis and of 0.6 to 1.6 g; no gains and offsets turn all of them into 1 g.
CONTRADICTORY = [
    pose(np.array(gravity_g), face=face)
    for face, gravity_g in zip(
        FACES_DOWN,
        (
            (0.62, 0.0, 0.0),
            (-0.62, 0.0, 0.0),
            (0.0, 1.49, 0.5),
            (0.0, -1.49, 0.5),
            (-0.5, 0.0, 1.49),
            (-0.2, 0.0, -0.59),
        ),
        strict=True,
    )
]
POSED: list[tuple[str, str, list[StillPose], AccelerometerStatus]] = [
    ("six-position", "in order", SIX, AccelerometerStatus.OK),
    ("six-position", "with another pose among them", [pose(ALL_ROUND[0]), *SIX], AccelerometerStatus.OK),
    (
        "six-position",
        "of an 8 g part",
        [pose(np.array(still.face.gravity_g) / 2.0, face=still.face) for still in SIX],
        AccelerometerStatus.MISPLACED_FACE,
    ),
    (
        "six-position",
        "of a 2 g part",
        [pose(np.array(still.face.gravity_g) * 2.0, face=still.face) for still in SIX],
        AccelerometerStatus.MISPLACED_FACE,
    ),
    (
        "six-position",
        "without a spread",
        [*SIX[:5], replace(SIX[5], accelerometer_spread=None)],
        AccelerometerStatus.MOVED,
    ),
    ("ellipsoid", "all round", [pose(direction) for direction in directions(20)], AccelerometerStatus.OK),
    ("ellipsoid", "eight", [pose(direction) for direction in directions(8)], AccelerometerStatus.TOO_FEW_POSES),
    (
        "ellipsoid",
        "one moved",
        [pose(gravity_g, spread=50.0 if i == 9 else 8.0) for i, gravity_g in enumerate(directions(20))],
        AccelerometerStatus.MOVED,
    ),
    ("ellipsoid", "on a plane", [pose(gravity_g) for gravity_g in RING[::5]], AccelerometerStatus.POOR_COVERAGE),
    ("ellipsoid", "in one place", [pose(ALL_ROUND[0])] * 20, AccelerometerStatus.POOR_COVERAGE),
    ("ellipsoid", "far out", [pose(gravity + 100.0) for gravity in directions(20)], AccelerometerStatus.POOR_COVERAGE),
    (
        "ellipsoid",
        "far below",
        [pose(gravity - 100.0) for gravity in directions(20)],
        AccelerometerStatus.POOR_COVERAGE,
    ),
    (
        "ellipsoid",
        "on a hyperboloid",
        [pose(point / 500.0) for point in OTHER_SHAPES["a hyperboloid"][::2]],
        AccelerometerStatus.NOT_AN_ELLIPSOID,
    ),
    ("six-position", "contradictory", CONTRADICTORY, AccelerometerStatus.NOT_AN_ELLIPSOID),
]


@pytest.mark.parametrize(
    ("method", "condition", "poses", "status"), POSED, ids=[f"{method} {condition}" for method, condition, *_ in POSED]
)
def test_poses_are_fitted_or_refused_by_name(
    board: Board, method: str, condition: str, poses: list[StillPose], status: AccelerometerStatus
) -> None:
    board.session.request(ClearPoses())
    for first in range(0, len(poses), MAX_TRANSFER):
        board.session.request(UploadPoses(first, poses[first : first + MAX_TRANSFER]))
    solution = board.session.request(FitAccelerometer(len(poses), method)).solution
    board.session.request(ClearPoses())
    assert solution.status is status, f"poses {condition} are answered {solution.status.name}"
    # The poses are those of a perfect part, and a refusal returns the nominal calibration.
    assert np.abs(solution.fit.gain - NOMINAL.gain).max() < 1e-5 * NOMINAL.gain[0, 0]
    assert np.abs(solution.fit.offset).max() < 0.1


def turn(turned_deg: Reals, *, n: int = 2001, sensitivity: float = 1.0) -> GyroscopeTurn:
    """Return a turn of 10 s as a perfect gyroscope measures it, times a sensitivity."""
    total = np.rint(sensitivity * np.asarray(turned_deg) * 16.0 * 200.0).astype(np.int64)
    return GyroscopeTurn(np.asarray(turned_deg, dtype=np.float64), total, n, 10.0, np.zeros(3), np.zeros(3))


TURNS = [turn(degrees) for degrees in 360.0 * np.eye(3)]
TURNED: list[tuple[str, list[GyroscopeTurn], TurnsStatus, int | None]] = [
    ("in order", TURNS, TurnsStatus.OK, None),
    (
        "in other lengths and directions",
        [turn(degrees) for degrees in np.diag([-360.0, 720.0, 100.0])],
        TurnsStatus.OK,
        None,
    ),
    ("two", TURNS[:2], TurnsStatus.TOO_FEW, None),
    ("one short", [*TURNS, turn(np.array([0.0, 89.0, 0.0]))], TurnsStatus.TOO_SMALL, 3),
    ("one of a sample", [TURNS[0], turn(np.array([0.0, 360.0, 0.0]), n=1), TURNS[2]], TurnsStatus.TOO_SMALL, 1),
    ("about axes of a plane", [*TURNS[:2], turn(np.array([360.0, 360.0, 0.0]))], TurnsStatus.NOT_SPANNING, None),
    (
        "that the gyroscope did not see",
        [turn(degrees, sensitivity=0.0) for degrees in 360.0 * np.eye(3)],
        TurnsStatus.SINGULAR,
        None,
    ),
]


@pytest.mark.parametrize(("condition", "turns", "status", "at_fault"), TURNED, ids=[row[0] for row in TURNED])
def test_turns_are_fitted_or_refused_by_name(
    board: Board, condition: str, turns: list[GyroscopeTurn], status: TurnsStatus, at_fault: int | None
) -> None:
    fit = board.session.request(FitGyroscope(turns)).fit
    assert (fit.status, fit.at_fault) == (status, at_fault), f"turns {condition} are answered {fit.status.name}"
    expected = np.eye(3) / 16.0 if status is TurnsStatus.OK else np.zeros((3, 3))
    assert np.abs(fit.matrix - expected).max() < 1e-5


MAGNETIC, GRAVITY = golden_pairs(300)
LEVEL_FIELD = directions(300)
FIRST_ACROSS = np.cross(LEVEL_FIELD, np.roll(LEVEL_FIELD, 1, axis=1))
FIRST_ACROSS /= np.linalg.norm(FIRST_ACROSS, axis=1)[:, None]
# Gravity perpendicular to the field, turned about the field by 2.6 rad from pair to pair.
ABOUT = 2.6 * np.arange(300)[:, None]
LEVEL = np.cos(ABOUT) * FIRST_ACROSS + np.sin(ABOUT) * np.cross(LEVEL_FIELD, FIRST_ACROSS)
PAIRS: list[tuple[str, Counts, Counts, float | None, FitStatus]] = [
    ("all round", MAGNETIC, GRAVITY, None, FitStatus.ELLIPSOID),
    ("of a dip that is given", MAGNETIC, GRAVITY, 62.0, FitStatus.ELLIPSOID),
    ("too few", MAGNETIC[:299], GRAVITY[:299], None, FitStatus.TOO_FEW_POINTS),
    ("of a dip of the wrong sign", MAGNETIC, GRAVITY, -62.0, FitStatus.MIRRORED),
    ("of a dip of zero", MAGNETIC, GRAVITY, 0.0, FitStatus.HORIZONTAL_FIELD),
    ("whose gravity is mirrored", MAGNETIC, -GRAVITY, 62.0, FitStatus.MIRRORED),
    ("with two axes swapped", MAGNETIC, GRAVITY[:, [1, 0, 2]], 62.0, FitStatus.MIRRORED),
    (
        "of a horizontal field",
        sensed(LEVEL_FIELD),
        np.rint(8192.0 * LEVEL).astype(np.int16),
        None,
        FitStatus.HORIZONTAL_FIELD,
    ),
    (
        "that never tilt",
        sensed(np.tile(RING, (3, 1))),
        np.tile(np.array([[0, 0, 8192]], np.int16), (300, 1)),
        None,
        FitStatus.SINGULAR,
    ),
    (
        "of one attitude",
        np.repeat(MAGNETIC[:1], 300, axis=0),
        np.repeat(GRAVITY[:1], 300, axis=0),
        None,
        FitStatus.SINGULAR,
    ),
    ("without gravity", MAGNETIC, 0 * GRAVITY, None, FitStatus.SINGULAR),
]


@pytest.mark.parametrize(
    ("condition", "magnetic", "gravity", "dip_deg", "status"), PAIRS, ids=[row[0] for row in PAIRS]
)
def test_pairs_are_fitted_or_refused_by_name(
    board: Board, condition: str, magnetic: Counts, gravity: Counts, dip_deg: float | None, status: FitStatus
) -> None:
    slot = board.identity.slots - 1
    board.session.request(ClearCalibration(slot))
    upload_pairs(board, magnetic, gravity)
    reply = board.session.request(FitDpi(len(magnetic), slot, dip_deg=dip_deg))
    assert reply.fit is status, f"pairs {condition} are answered {reply.fit.name}"
    if status is FitStatus.ELLIPSOID:
        assert reply.dip_deg == pytest.approx(62.0, abs=0.5)  # noise of 0.008 of the field, over 300 pairs


@pytest.mark.parametrize(
    ("count", "few", "status"),
    [(38, 16, FitStatus.ELLIPSOID), (38, 15, FitStatus.TOO_FEW_POINTS), (37, 16, FitStatus.TOO_FEW_POINTS)],
)
def test_poses_for_a_magnetometer_must_be_enough_and_of_enough_readings(
    board: Board, count: int, few: int, status: FitStatus
) -> None:
    board.session.request(ClearPoses())
    poses = [
        pose(gravity / COUNTS_PER_G, field=field.astype(np.float64), readings=few if i == 1 else 16)
        for i, (field, gravity) in enumerate(zip(MAGNETIC[::7], GRAVITY[::7], strict=True))
    ][:count]
    for first in range(0, count, MAX_TRANSFER):
        board.session.request(UploadPoses(first, poses[first : first + MAX_TRANSFER]))
    reply = board.session.request(FitDpi(count, board.identity.slots - 1, source=DpiSource.POSES))
    board.session.request(ClearPoses())
    assert reply.fit is status, f"{count} poses, one of {few} readings, are answered {reply.fit.name}"
