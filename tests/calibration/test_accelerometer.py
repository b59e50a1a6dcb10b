"""The float64 accelerometer fits: exact in their own class of errors, and wrong by what is stated outside of it."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from hiltest.calibration.accelerometer import (
    COUNTS_PER_G,
    CROSS_AXIS,
    NOMINAL,
    AccelerometerFit,
    AccelerometerStatus,
    axes_uncertainty_deg,
    axis_error_deg,
    cross_axis_of_faces,
    fit_ellipsoid,
    fit_six_position,
    offset_error_mg,
)
from hiltest.calibration.quality import sphere_directions
from hiltest.calibration.still_pose import FACES, Face, StillPose
from hiltest.orientation.angles import Pose, rotation_body_from_ned

# Noiseless float64: rounding (2e-16) times the condition of the equations, below 1e4.
EXACT = 1e-11
QUIET = np.full(3, 10.0)  # counts; the limit is 41
FACE_GRAVITY_G = np.array([face.gravity_g for face in FACES])

_error = st.floats(-0.05, 0.05)
_gains = st.lists(_error, min_size=9, max_size=9).map(lambda errors: np.eye(3) + np.reshape(errors, (3, 3)))
_offsets = st.tuples(*[st.floats(-0.1, 0.1)] * 3).map(np.array)


def pose_of(counts: np.ndarray, face: Face = Face.NONE, spread: np.ndarray | None = QUIET) -> StillPose:
    return StillPose(np.zeros(3), np.zeros(3), np.asarray(counts, dtype=np.float64), spread, 64, face)


def faces_read(part: np.ndarray, offset_g: np.ndarray, gravity_g: np.ndarray = FACE_GRAVITY_G) -> list[StillPose]:
    """What a part reads on the six faces: ``counts = 8192 (part @ gravity + offset)``."""
    counts = COUNTS_PER_G * (gravity_g @ part.T + offset_g)
    return [pose_of(count, face) for count, face in zip(counts, FACES, strict=True)]


def truth(part: np.ndarray, offset_g: np.ndarray) -> AccelerometerFit:
    return AccelerometerFit(np.linalg.inv(part) / COUNTS_PER_G, COUNTS_PER_G * offset_g)


@given(part=_gains, offset_g=_offsets, order=st.permutations(range(6)))
def test_six_faces_give_any_linear_error_exactly(part: np.ndarray, offset_g: np.ndarray, order: Sequence[int]) -> None:
    poses = faces_read(part, offset_g)
    result = fit_six_position([poses[index] for index in order] + [pose_of(np.array([5.0, 5.0, 5.0]))])
    expected = truth(part, offset_g)
    assert (result.status, result.faces, result.pose) == (AccelerometerStatus.OK, (), None)
    assert np.allclose(result.fit.gain, expected.gain, rtol=0, atol=EXACT / COUNTS_PER_G)
    assert np.allclose(result.fit.offset, expected.offset, rtol=0, atol=EXACT * COUNTS_PER_G)
    assert result.residual_mg < 1e3 * EXACT
    # An angle from cosine and sine of it: good to an ulp, 1e-14 degrees here.
    assert axis_error_deg(result.fit, expected) < 1e-8
    assert offset_error_mg(result.fit, expected) < 1e3 * EXACT


def test_a_face_is_worked_out_by_hand() -> None:
    """x 2 % too long, 5 mg off, and leaning towards y by 1 %: counts = 8192 (g + ...)."""
    part = np.array([[1.02, 0.0, 0.0], [0.01, 1.0, 0.0], [0.0, 0.0, 1.0]])
    fit = fit_six_position(faces_read(part, np.array([0.005, 0.0, 0.0]))).fit
    assert fit.offset == pytest.approx([40.96, 0.0, 0.0], abs=1e-8)
    assert 8192.0 * fit.gain.ravel() == pytest.approx([1 / 1.02, 0, 0, -0.01 / 1.02, 1, 0, 0, 0, 1], abs=1e-11)


@given(part=_gains, offset_g=_offsets, heading=st.floats(0, 360), pitch=st.floats(-4, 4), roll=st.floats(-4, 4))
def test_faces_that_are_all_turned_alike_leave_that_rotation_and_no_residual(
    part: np.ndarray, offset_g: np.ndarray, heading: float, pitch: float, roll: float
) -> None:
    axis = rotation_body_from_ned(Pose(heading))
    turned = axis.T @ rotation_body_from_ned(Pose(3.0, pitch, roll)) @ axis
    result = fit_six_position(faces_read(part, offset_g, FACE_GRAVITY_G @ turned.T))
    assert result.status is AccelerometerStatus.OK
    assert result.residual_mg < 1e3 * EXACT
    assert np.allclose(result.fit.gain @ part * COUNTS_PER_G, turned.T, atol=EXACT)


@pytest.mark.parametrize("tilted", FACES)
def test_one_face_askew_moves_no_offset_and_is_half_seen_in_the_middle_of_its_pair(tilted: Face) -> None:
    askew = FACE_GRAVITY_G.copy()
    across = np.roll(FACE_GRAVITY_G[tilted], 1)  # another axis, at a right angle
    askew[tilted] = math.cos(0.01) * askew[tilted] + math.sin(0.01) * across
    result = fit_six_position(faces_read(np.eye(3), np.zeros(3), askew))
    # Its norm is 1 g all the same; what is left is of second order. Least squares take a third of 10 mg for offset.
    assert offset_error_mg(result.fit, NOMINAL) < 1000.0 * 0.01**2
    assert result.residual_mg == pytest.approx(10.0 / 2.0 * math.sqrt(2.0 / 6.0), rel=0.01)


def laid_down(random: np.random.Generator, askew_deg: float, noise_mg: float) -> tuple[AccelerometerFit, np.ndarray]:
    """What is true of an untrimmed part (20 mg, 2.5 %, 0.5 % across), and what it reads on faces that are askew [g]."""
    across = 1.0 - np.eye(3)
    part = np.diag(1.0 + random.normal(0.0, 0.025, 3)) @ (np.eye(3) + across * random.normal(0.0, 0.005, (3, 3)))
    offset_g = random.normal(0.0, 0.02, 3)
    slopes = np.repeat(across, 2, axis=0) * np.radians(askew_deg) * random.standard_normal((6, 3))
    gravity_g = FACE_GRAVITY_G + slopes
    gravity_g /= np.linalg.norm(gravity_g, axis=1, keepdims=True)
    return truth(part, offset_g), gravity_g @ part.T + offset_g + random.normal(0.0, 1e-3 * noise_mg, (6, 3))


@pytest.mark.parametrize(
    ("askew_deg", "noise_mg", "offset_mg", "gain_percent"),
    [(0.0, 0.1, 0.1, 0.01), (1.0, 0.1, 0.2, 0.02), (1.0, 0.3, 0.3, 0.03)],
)
def test_norms_keep_offset_and_gain_whatever_the_faces_are(
    askew_deg: float, noise_mg: float, offset_mg: float, gain_percent: float
) -> None:
    random = np.random.default_rng(5)
    offsets, gains, across, askew = [], [], [], []
    for _ in range(400):
        expected, read_g = laid_down(random, askew_deg, noise_mg)
        result = fit_six_position([pose_of(COUNTS_PER_G * g, face) for g, face in zip(read_g, FACES, strict=True)])
        remainder = result.fit.gain @ np.linalg.inv(expected.gain)
        offsets.append(1000.0 / COUNTS_PER_G * (result.fit.offset - expected.offset))
        gains.append(100.0 * (np.diag(remainder) - 1.0))
        across.append(np.degrees(remainder[~np.eye(3, dtype=bool)]))
        askew.append(result.faces_askew_deg)
    # Measured 0.07, 0.14 and 0.24 mg, 0.007, 0.015 and 0.025 %; what 1200 of them scatter by is 2 %. The last mean of
    # a pair is all that the norms leave of the noise: 1 / sqrt(2). Least squares: 5.9 mg at 1 degree.
    assert np.sqrt(np.mean(np.square(offsets))) < offset_mg
    assert np.sqrt(np.mean(np.square(gains))) < gain_percent
    # Noise of the readings is askew, too. 400 times six angles: 1.4 %, here three of it.
    observed = math.hypot(askew_deg, math.degrees(1e-3 * noise_mg) * math.sqrt(2.0))
    assert np.sqrt(np.mean(np.square(askew))) == pytest.approx(observed, rel=0.05 if askew_deg else 0.1)
    # That the angle is itself known from six only makes the axes worse than with a known one, by a tenth.
    assert np.sqrt(np.mean(np.square(across))) < 1.1 * axes_uncertainty_deg(observed) + 0.001


def test_what_askew_faces_leave_of_an_axis_is_their_share_at_first_and_the_parts_own_at_last() -> None:
    assert axes_uncertainty_deg(0.01) == pytest.approx(0.01 / math.sqrt(2.0), rel=1e-3)
    assert axes_uncertainty_deg(30.0) == pytest.approx(math.degrees(CROSS_AXIS), rel=1e-3)


def error_over_stated(hand_deg: float, cross_axis: float, *, estimated: bool) -> float:
    """Return the rms error of gravity's direction over the stated one, in 400 parts laid down by a hand."""
    random, directions = np.random.default_rng(1), sphere_directions(100)
    squares = np.zeros(2)
    for _ in range(400):
        part = np.eye(3) + cross_axis * random.standard_normal((3, 3))
        laid = FACE_GRAVITY_G + math.radians(hand_deg) * np.cross(random.standard_normal((6, 3)), FACE_GRAVITY_G)
        poses = faces_read(part, np.zeros(3), laid / np.linalg.norm(laid, axis=1, keepdims=True))
        result, prior = fit_six_position(poses), CROSS_AXIS
        if estimated:
            prior = cross_axis_of_faces([pose.accelerometer for pose in poses], result.faces_askew_deg)
            result = fit_six_position(poses, prior)
        off = directions @ (result.fit.gain @ part * COUNTS_PER_G - np.eye(3)).T
        off -= (off * directions).sum(axis=1, keepdims=True) * directions
        # Two elements of an axis define its direction.
        stated = math.sqrt(2.0) * math.radians(axes_uncertainty_deg(result.faces_askew_deg, prior))
        squares += np.mean((off * off).sum(axis=1)), stated**2
    return float(math.sqrt(squares[0] / squares[1]))


@pytest.mark.parametrize(
    ("hand_deg", "cross_axis", "by_prior", "by_estimate"),
    [
        (0.3, 0.005, 0.93, 0.92),
        (0.3, 0.01, 1.34, 0.98),
        (0.3, 0.02, 2.32, 0.91),
        (1.0, 0.005, 0.97, 1.06),
        (1.0, 0.01, 1.75, 1.20),
        (1.0, 0.02, 3.30, 1.18),
    ],
)
def test_the_error_of_six_faces_is_as_stated_also_if_the_part_s_axes_are_worse_than_the_prior(
    hand_deg: float, cross_axis: float, by_prior: float, by_estimate: float
) -> None:
    # An rms of 400 draws of six elements scatters by 1.4 %; a few draws with large estimates triple that.
    assert error_over_stated(hand_deg, cross_axis, estimated=False) == pytest.approx(by_prior, rel=0.1)
    assert error_over_stated(hand_deg, cross_axis, estimated=True) == pytest.approx(by_estimate, rel=0.1)


def test_cross_axis_elements_are_estimated_from_straight_faces_and_never_below_the_prior() -> None:
    off = 0.02 * (np.ones((3, 3)) - np.eye(3)) * np.array([[1.0], [-1.0], [1.0]])
    for scale, expected in ((1.0, 0.02), (0.1, CROSS_AXIS)):
        poses = faces_read(np.eye(3) + scale * off, np.array([0.1, 0.0, -0.1]))
        counts = [pose.accelerometer for pose in poses]
        assert cross_axis_of_faces(counts, 0.0) == pytest.approx(expected)
        assert cross_axis_of_faces(counts, 90.0) == CROSS_AXIS


def test_six_readings_that_no_ellipsoid_meets_are_refused() -> None:
    # Each within 20 degrees of its axis and of 0.6 to 1.6 g, so nothing else refuses them.
    leaning = np.array(
        [
            [1.36, -0.32, -0.22],
            [-0.80, 0.14, -0.25],
            [-0.22, 1.40, 0.33],
            [-0.25, -0.74, -0.08],
            [0.08, 0.31, 1.03],
            [0.02, -0.14, -0.73],
        ]
    )
    result = fit_six_position([pose_of(COUNTS_PER_G * item, face) for item, face in zip(leaning, FACES, strict=True)])
    assert (result.status, result.fit) == (AccelerometerStatus.NOT_AN_ELLIPSOID, NOMINAL)


POSES = faces_read(np.eye(3), np.zeros(3))
SHAKEN = np.array([10.0, 10.0, 60.0])


@pytest.mark.parametrize(
    ("poses", "status", "faces", "pose"),
    [
        ([], AccelerometerStatus.MISSING_FACE, FACES, None),
        (POSES[:3] + POSES[4:], AccelerometerStatus.MISSING_FACE, (Face.MINUS_Y,), None),
        (POSES[1:] + POSES[1:2], AccelerometerStatus.MISSING_FACE, (Face.PLUS_X,), None),
        ([*POSES, POSES[4], POSES[2]], AccelerometerStatus.REPEATED_FACE, (Face.PLUS_Y, Face.PLUS_Z), 2),
        (
            [replace(POSES[1], face=Face.PLUS_X), replace(POSES[0], face=Face.MINUS_X), *POSES[2:]],
            AccelerometerStatus.MISPLACED_FACE,
            (Face.PLUS_X, Face.MINUS_X),
            0,
        ),
        # Forgotten to turn: the board lies as for the face before.
        (
            [*POSES[:5], replace(POSES[4], face=Face.MINUS_Z)],
            AccelerometerStatus.MISPLACED_FACE,
            (Face.MINUS_Z,),
            5,
        ),
        # 21 degrees between two faces; no gravity at all; the counts of another full scale.
        (
            [pose_of(8192 * np.array([math.cos(0.367), math.sin(0.367), 0]), Face.PLUS_X), *POSES[1:]],
            AccelerometerStatus.MISPLACED_FACE,
            (Face.PLUS_X,),
            0,
        ),
        ([*POSES[:5], pose_of(np.zeros(3), Face.MINUS_Z)], AccelerometerStatus.MISPLACED_FACE, (Face.MINUS_Z,), 5),
        (
            [replace(pose, accelerometer=2 * pose.accelerometer) for pose in POSES],
            AccelerometerStatus.MISPLACED_FACE,
            FACES,
            0,
        ),
        (
            [POSES[0], replace(POSES[1], accelerometer_spread=SHAKEN), *POSES[2:]],
            AccelerometerStatus.MOVED,
            (Face.MINUS_X,),
            1,
        ),
        ([*POSES[:5], replace(POSES[5], accelerometer_spread=None)], AccelerometerStatus.MOVED, (Face.MINUS_Z,), 5),
    ],
)
def test_faces_that_are_wrong_are_named(
    poses: list[StillPose], status: AccelerometerStatus, faces: tuple[Face, ...], pose: int | None
) -> None:
    result = fit_six_position(poses)
    assert (result.status, result.faces, result.pose) == (status, faces, pose)
    assert result.fit is NOMINAL


def still_poses(part: np.ndarray, offset_g: np.ndarray, count: int) -> list[StillPose]:
    return [pose_of(item) for item in COUNTS_PER_G * (sphere_directions(count) @ part.T + offset_g)]


@given(part=_gains, offset_g=_offsets, count=st.integers(10, 40))
def test_the_ellipsoid_finds_symmetric_errors_exactly(part: np.ndarray, offset_g: np.ndarray, count: int) -> None:
    symmetric = (part + part.T) / 2.0
    ellipsoid, expected = fit_ellipsoid(still_poses(symmetric, offset_g, count)), truth(symmetric, offset_g)
    assert ellipsoid.status is AccelerometerStatus.OK
    assert np.allclose(ellipsoid.fit.gain, expected.gain, rtol=0, atol=EXACT / COUNTS_PER_G)
    assert np.allclose(ellipsoid.fit.offset, expected.offset, rtol=0, atol=EXACT * COUNTS_PER_G)
    assert ellipsoid.residual_mg < 1e3 * EXACT


@given(part=_gains, offset_g=_offsets)
def test_of_any_other_error_the_ellipsoid_leaves_exactly_its_rotation(part: np.ndarray, offset_g: np.ndarray) -> None:
    ellipsoid = fit_ellipsoid(still_poses(part, offset_g, 30))
    remainder, _, right = np.linalg.svd(part)
    assert np.allclose(
        ellipsoid.fit.gain @ part * COUNTS_PER_G, remainder @ right, atol=EXACT
    )  # the polar rotation of part
    assert ellipsoid.residual_mg < 1e3 * EXACT


def test_three_degrees_of_rotation_are_three_degrees_of_axis_error_for_the_ellipsoid_and_none_for_six_faces() -> None:
    part = rotation_body_from_ned(Pose(0.0, 0.0, 3.0))
    expected = truth(part, np.zeros(3))
    assert axis_error_deg(fit_ellipsoid(still_poses(part, np.zeros(3), 20)).fit, expected) == pytest.approx(3.0)
    assert axis_error_deg(fit_six_position(faces_read(part, np.zeros(3))).fit, expected) < 1e-8


@pytest.mark.parametrize(
    ("directions", "status"),
    [
        (sphere_directions(9)[:8], AccelerometerStatus.TOO_FEW_POSES),
        (FACE_GRAVITY_G.repeat(2, axis=0), AccelerometerStatus.POOR_COVERAGE),  # six places do not make nine unknowns
        (sphere_directions(60)[:15], AccelerometerStatus.POOR_COVERAGE),  # a quarter of the sphere
        (np.tile([[0.0, 0.0, 1.0]], (20, 1)), AccelerometerStatus.POOR_COVERAGE),
        # A hyperboloid of two sheets: the poles pulled out, the equator pushed in.
        (
            np.array([[x, y, s * math.hypot(0.3, x, y)] for s in (-1, 1) for x in (-1, 0, 1) for y in (-1, 0, 1)]),
            AccelerometerStatus.NOT_AN_ELLIPSOID,
        ),
    ],
    ids=["eight", "six faces", "a quarter", "one spot", "a hyperboloid"],
)
def test_poses_that_determine_no_ellipsoid_are_refused(directions: np.ndarray, status: AccelerometerStatus) -> None:
    assert fit_ellipsoid([pose_of(8192.0 * direction) for direction in directions]).status is status


def test_a_pose_that_moved_is_named_by_its_number() -> None:
    poses = still_poses(np.eye(3), np.zeros(3), 12)
    poses[7] = replace(poses[7], accelerometer_spread=SHAKEN)
    ellipsoid = fit_ellipsoid(poses)
    assert (ellipsoid.status, ellipsoid.pose) == (AccelerometerStatus.MOVED, 7)
