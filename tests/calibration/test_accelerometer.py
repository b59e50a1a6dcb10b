"""The float64 accelerometer fits: exact in their own class of errors, and wrong by what is stated outside of it."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from hiltest.angles import Pose, rotation_body_from_ned
from hiltest.calibration.accelerometer import (
    COUNTS_PER_G,
    NOMINAL,
    AccelerometerFit,
    AccelerometerStatus,
    axis_error_deg,
    fit_ellipsoid,
    fit_six_position,
    offset_error_mg,
)
from hiltest.calibration.quality import sphere_directions
from hiltest.calibration.still_pose import FACES, Face, StillPose

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
    return [pose_of(each, face) for each, face in zip(counts, FACES, strict=True)]


def truth(part: np.ndarray, offset_g: np.ndarray) -> AccelerometerFit:
    return AccelerometerFit(np.linalg.inv(part) / COUNTS_PER_G, COUNTS_PER_G * offset_g)


@given(part=_gains, offset_g=_offsets, order=st.permutations(range(6)))
def test_six_faces_give_any_linear_error_exactly(part: np.ndarray, offset_g: np.ndarray, order: Sequence[int]) -> None:
    poses = faces_read(part, offset_g)
    found = fit_six_position([poses[index] for index in order] + [pose_of(np.array([5.0, 5.0, 5.0]))])
    wanted = truth(part, offset_g)
    assert (found.status, found.faces, found.pose) == (AccelerometerStatus.OK, (), None)
    assert np.allclose(found.fit.gain, wanted.gain, rtol=0, atol=EXACT / COUNTS_PER_G)
    assert np.allclose(found.fit.offset, wanted.offset, rtol=0, atol=EXACT * COUNTS_PER_G)
    assert found.residual_mg < 1e3 * EXACT
    # An angle from cosine and sine of it: good to an ulp, 1e-14 degrees here.
    assert axis_error_deg(found.fit, wanted) < 1e-8
    assert offset_error_mg(found.fit, wanted) < 1e3 * EXACT


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
    found = fit_six_position(faces_read(part, offset_g, FACE_GRAVITY_G @ turned.T))
    assert found.status is AccelerometerStatus.OK
    assert found.residual_mg < 1e3 * EXACT
    assert np.allclose(found.fit.gain @ part * COUNTS_PER_G, turned.T, atol=EXACT)


@pytest.mark.parametrize("tilted", FACES)
def test_one_face_askew_leaves_a_third_of_it_there_and_opposite_and_a_sixth_on_the_others(tilted: Face) -> None:
    askew = FACE_GRAVITY_G.copy()
    across = np.roll(FACE_GRAVITY_G[tilted], 1)  # another axis, at a right angle
    askew[tilted] += 0.01 * across
    poses = faces_read(np.eye(3), np.zeros(3), askew)
    found = fit_six_position(poses)
    errors = np.array([found.fit.gravity_g(pose.accelerometer) for pose in poses]) - FACE_GRAVITY_G
    opposite = tilted ^ 1
    # To first order; the second is 0.01 of it.
    assert errors[[tilted, opposite]] @ across == pytest.approx([0.01 / 3, 0.01 / 3], rel=0.05)
    others = [face for face in FACES if face not in (tilted, opposite)]
    assert errors[others] @ across == pytest.approx([-0.01 / 6] * 4, rel=0.05)
    assert found.residual_mg == pytest.approx(10.0 * math.sqrt((2 / 9 + 4 / 36) / 6), rel=0.05)


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
            AccelerometerStatus.MISPLACED_FACE, (Face.PLUS_X, Face.MINUS_X), 0,
        ),
        # Forgotten to turn: the board lies as for the face before.
        (
            [*POSES[:5], replace(POSES[4], face=Face.MINUS_Z)], AccelerometerStatus.MISPLACED_FACE, (Face.MINUS_Z,), 5,
        ),
        # 21 degrees between two faces; no gravity at all; the counts of another full scale.
        (
            [pose_of(8192 * np.array([math.cos(0.367), math.sin(0.367), 0]), Face.PLUS_X), *POSES[1:]],
            AccelerometerStatus.MISPLACED_FACE, (Face.PLUS_X,), 0,
        ),
        ([*POSES[:5], pose_of(np.zeros(3), Face.MINUS_Z)], AccelerometerStatus.MISPLACED_FACE, (Face.MINUS_Z,), 5),
        ([replace(each, accelerometer=2 * each.accelerometer) for each in POSES], AccelerometerStatus.MISPLACED_FACE,
         FACES, 0),
        ([POSES[0], replace(POSES[1], accelerometer_spread=SHAKEN), *POSES[2:]], AccelerometerStatus.MOVED,
         (Face.MINUS_X,), 1),
        ([*POSES[:5], replace(POSES[5], accelerometer_spread=None)], AccelerometerStatus.MOVED, (Face.MINUS_Z,), 5),
    ],
)  # fmt: skip
def test_faces_that_are_wrong_are_named(
    poses: list[StillPose], status: AccelerometerStatus, faces: tuple[Face, ...], pose: int | None
) -> None:
    found = fit_six_position(poses)
    assert (found.status, found.faces, found.pose) == (status, faces, pose)
    assert found.fit is NOMINAL


def still_poses(part: np.ndarray, offset_g: np.ndarray, count: int) -> list[StillPose]:
    return [pose_of(each) for each in COUNTS_PER_G * (sphere_directions(count) @ part.T + offset_g)]


@given(part=_gains, offset_g=_offsets, count=st.integers(9, 40))
def test_the_ellipsoid_finds_symmetric_errors_exactly(part: np.ndarray, offset_g: np.ndarray, count: int) -> None:
    symmetric = (part + part.T) / 2.0
    found, wanted = fit_ellipsoid(still_poses(symmetric, offset_g, count)), truth(symmetric, offset_g)
    assert found.status is AccelerometerStatus.OK
    assert np.allclose(found.fit.gain, wanted.gain, rtol=0, atol=EXACT / COUNTS_PER_G)
    assert np.allclose(found.fit.offset, wanted.offset, rtol=0, atol=EXACT * COUNTS_PER_G)
    assert found.residual_mg < 1e3 * EXACT


@given(part=_gains, offset_g=_offsets)
def test_of_any_other_error_the_ellipsoid_leaves_exactly_its_rotation(part: np.ndarray, offset_g: np.ndarray) -> None:
    found = fit_ellipsoid(still_poses(part, offset_g, 30))
    left, _, right = np.linalg.svd(part)
    assert np.allclose(found.fit.gain @ part * COUNTS_PER_G, left @ right, atol=EXACT)  # the polar rotation of part
    assert found.residual_mg < 1e3 * EXACT


def test_three_degrees_of_rotation_are_three_degrees_of_axis_error_for_the_ellipsoid_and_none_for_six_faces() -> None:
    part = rotation_body_from_ned(Pose(0.0, 0.0, 3.0))
    wanted = truth(part, np.zeros(3))
    assert axis_error_deg(fit_ellipsoid(still_poses(part, np.zeros(3), 20)).fit, wanted) == pytest.approx(3.0)
    assert axis_error_deg(fit_six_position(faces_read(part, np.zeros(3))).fit, wanted) < 1e-8


@pytest.mark.parametrize(
    ("directions", "status"),
    [
        (sphere_directions(9)[:8], AccelerometerStatus.TOO_FEW_POSES),
        (FACE_GRAVITY_G.repeat(2, axis=0), AccelerometerStatus.POOR_COVERAGE),  # six places do not make nine unknowns
        (sphere_directions(60)[:15], AccelerometerStatus.POOR_COVERAGE),  # a quarter of the sphere
        (np.tile([[0.0, 0.0, 1.0]], (20, 1)), AccelerometerStatus.POOR_COVERAGE),
        # A hyperboloid of two sheets: the poles pulled out, the equator pushed in.
        (np.array([[x, y, s * math.hypot(0.3, x, y)] for s in (-1, 1) for x in (-1, 0, 1) for y in (-1, 0, 1)]),
         AccelerometerStatus.NOT_AN_ELLIPSOID),
    ],
    ids=["eight", "six faces", "a quarter", "one spot", "a hyperboloid"],
)  # fmt: skip
def test_poses_that_determine_no_ellipsoid_are_refused(
    directions: np.ndarray, status: AccelerometerStatus
) -> None:
    assert fit_ellipsoid([pose_of(8192.0 * each) for each in directions]).status is status


def test_a_pose_that_moved_is_named_by_its_number() -> None:
    poses = still_poses(np.eye(3), np.zeros(3), 12)
    poses[7] = replace(poses[7], accelerometer_spread=SHAKEN)
    found = fit_ellipsoid(poses)
    assert (found.status, found.pose) == (AccelerometerStatus.MOVED, 7)
