"""The firmware's accelerometer fits, on this machine and on the virtual board, against the float64 references."""

from __future__ import annotations

import ctypes
import math
import struct
from collections.abc import Callable, Sequence
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from hiltest.calibration.accelerometer import (
    COUNTS_PER_G,
    NOMINAL,
    AccelerometerFit,
    AccelerometerSolution,
    AccelerometerStatus,
    fit_ellipsoid,
    fit_six_position,
)
from hiltest.calibration.quality import sphere_directions
from hiltest.calibration.still_pose import FACES, Face, StillPose
from hiltest.link.replies import Status
from hiltest.virtual.board.k64f import VirtualK64F

from .bench import CLEAR_POSES, FIT_ACCELEROMETER, UPLOAD_POSES, Bench
from .conftest import SHIPPED_ELF

POSE = struct.Struct("<12fHBx")
FIT = struct.Struct("<3Bx12f")  # accelerometer_fit_t, the same on both
REPLY = struct.Struct("<3B13fII")
INSTANCES = 600
#: By the names that the board knows them by.
METHODS = {"six-position": fit_six_position, "ellipsoid": fit_ellipsoid}

Fits = Callable[[str, Sequence[StillPose]], AccelerometerSolution]


def packed(pose: StillPose) -> bytes:
    spread = np.full(3, math.nan) if pose.accelerometer_spread is None else pose.accelerometer_spread
    numbers = [*pose.magnetometer, *np.zeros(3), *pose.accelerometer, *spread]
    return POSE.pack(*numbers, pose.readings, pose.face)


def unpacked(status: int, faces: int, pose: int, *numbers: float) -> AccelerometerSolution:
    fit = AccelerometerFit(np.array(numbers[:9]).reshape(3, 3), np.array(numbers[9:12]))
    at_fault = tuple(face for face in FACES if faces >> face & 1)
    residual_mg = numbers[12] if len(numbers) > 12 else math.nan
    return AccelerometerSolution(AccelerometerStatus(status), at_fault, None if pose == 255 else pose, fit, residual_mg)


def c_name(method: str) -> str:
    return "accelerometer_" + method.replace("-", "_")


@pytest.fixture(scope="session")
def host_fits(host_library: ctypes.CDLL) -> Fits:
    def fit(method: str, poses: Sequence[StillPose]) -> AccelerometerSolution:
        held = ctypes.create_string_buffer(b"".join(map(packed, poses)), POSE.size * len(poses) + 1)
        result = ctypes.create_string_buffer(FIT.size)
        getattr(host_library, c_name(method))(struct.pack("PBxxxxxxx", ctypes.addressof(held), len(poses)), result)
        return unpacked(*FIT.unpack(result.raw))

    return fit


@pytest.fixture(scope="session")
def board_fits() -> Fits:
    board = VirtualK64F(SHIPPED_ELF)
    poses_at, argument_at, result_at = 0x20020000, 0x20028000, 0x20028040
    assert max(segment.run_address + segment.run_size for segment in board.image.segments) <= poses_at

    def fit(method: str, poses: Sequence[StillPose]) -> AccelerometerSolution:
        memory = board.processor.memory
        memory.write(poses_at, b"".join(map(packed, poses)))
        memory.write(argument_at, struct.pack("<IB", poses_at, len(poses)))
        board.call(c_name(method), argument_at, result_at)
        return unpacked(*FIT.unpack(memory.read(result_at, FIT.size)))

    return fit


@pytest.fixture(scope="session", params=["host", "board"])
def fits(request: pytest.FixtureRequest) -> Fits:
    result: Fits = request.getfixturevalue(f"{request.param}_fits")
    return result


def drawn(seed: int, directions: np.ndarray, faces: Sequence[Face]) -> list[StillPose]:
    """What an untrimmed part reads: gains to 5 %, skew, offsets to 60 mg, noise of 64 readings, places to 2 deg."""
    rng = np.random.default_rng(seed)
    part = np.eye(3) + rng.uniform(-0.05, 0.05, (3, 3)) * (np.eye(3) + 0.4)
    gravity_g = directions + rng.normal(0.0, 0.01, directions.shape)
    gravity_g /= np.linalg.norm(gravity_g, axis=1, keepdims=True)
    counts = COUNTS_PER_G * (gravity_g @ part.T + rng.uniform(-0.06, 0.06, 3)) + rng.normal(0.0, 1.3, directions.shape)
    poses = [
        StillPose(rng.normal(0, 300, 3), None, mean.astype(np.float32).astype(float), np.full(3, 10.0), 64, face)
        for mean, face in zip(counts, faces, strict=True)
    ]
    return [poses[index] for index in rng.permutation(len(poses))]


def instance(method: str, seed: int) -> list[StillPose]:
    if method == "six-position":
        none = [Face.NONE] * (seed % 3)
        directions = np.array([face.gravity_g for face in FACES] + [(0.6, 0.0, 0.8)] * len(none))
        return drawn(seed, directions, [*FACES, *none])
    count = 9 + seed % 40
    directions = np.random.default_rng(seed).normal(size=(count, 3))
    return drawn(seed, directions / np.linalg.norm(directions, axis=1, keepdims=True), [Face.NONE] * count)


@pytest.mark.parametrize("method", METHODS)
def test_host_and_board_give_the_same_bits(host_fits: Fits, board_fits: Fits, method: str) -> None:
    for seed in range(30):
        poses = instance(method, seed)
        host, board = host_fits(method, poses), board_fits(method, poses)
        assert (host.status, host.faces, host.pose) == (board.status, board.faces, board.pose), f"seed {seed}"
        assert np.array_equal(host.fit.gain, board.fit.gain), f"seed {seed}"
        assert np.array_equal(host.fit.offset, board.fit.offset), f"seed {seed}"


def largest_difference_mg(first: AccelerometerFit, second: AccelerometerFit) -> float:
    """Between the gravities that two calibrations make of what a nominal part reads in any attitude."""
    counts = COUNTS_PER_G * sphere_directions(100)
    return 1000.0 * float(np.linalg.norm(first.gravity_g(counts) - second.gravity_g(counts), axis=1).max())


# A float32 has 24 bits: a sum of some dozen products is good to some 1e-7 of 1 g, 1e-4 mg, and six faces are well
# conditioned. The ellipsoid's condition is that of the normal equations of fourth powers, up to a thousand where the
# coverage figure is 30; still that is a tenth of the 1.3 mg of one reading's noise.
TOLERANCE_MG = {"six-position": 1e-3, "ellipsoid": 0.1}


@pytest.mark.parametrize("method", METHODS)
def test_c_and_float64_agree_over_untrimmed_parts(host_fits: Fits, method: str) -> None:
    differences, fitted = [], 0
    for seed in range(INSTANCES):
        poses = instance(method, seed)
        ours, expected = host_fits(method, poses), METHODS[method](poses)
        assert ours.status is expected.status, f"seed {seed}"
        if expected.status is AccelerometerStatus.OK:
            fitted += 1
            differences.append(largest_difference_mg(ours.fit, expected.fit))
    median, p99, largest = np.percentile(differences, [50, 99, 100])
    print(f"{method}: {fitted} of {INSTANCES} fitted, {median:.2g} / {p99:.2g} / {largest:.2g} mg")
    assert fitted > 0.8 * INSTANCES
    assert largest < TOLERANCE_MG[method]


GOOD = [
    StillPose(np.zeros(3), None, COUNTS_PER_G * np.array(face.gravity_g), np.full(3, 10.0), 64, face) for face in FACES
]
SHAKEN = replace(GOOD[1], accelerometer_spread=np.array([0.0, 41.0, 0.0]))
# What is not good about a face, and whether it is there at all, once or twice.
_face_poses = st.lists(
    st.tuples(
        st.sampled_from(FACES),
        st.sampled_from(FACES),
        st.sampled_from([0.0, 10.0, 40.9, 41.0, math.nan]),
        st.sampled_from([0.0, 0.5, 0.61, 1.0, 1.59, 1.7]),
    ),
    max_size=10,
)


@settings(deadline=None)  # the board decodes each instruction once, at its first use
@given(drawn_faces=_face_poses, keep=st.permutations(GOOD))
def test_c_and_float64_find_the_same_faces_at_fault(
    fits: Fits, drawn_faces: list[tuple[Face, Face, float, float]], keep: list[StillPose]
) -> None:
    changed = [
        replace(
            GOOD[face],
            face=face,
            accelerometer=size * GOOD[lies_on].accelerometer,
            accelerometer_spread=np.full(3, spread),
        )
        for face, lies_on, spread, size in drawn_faces
    ]
    for poses in (changed, [*keep[: 6 - len(drawn_faces) % 6], *changed]):
        ours, expected = fits("six-position", poses), METHODS["six-position"](poses)
        assert (ours.status, ours.faces, ours.pose) == (expected.status, expected.faces, expected.pose)


def test_an_ellipsoid_of_poses_that_tell_too_little_is_refused(fits: Fits) -> None:
    directions = sphere_directions(60)
    for rows, shaken in (
        (directions[::7][:8], None),
        (directions[:15], None),
        (np.tile(directions[:1], (20, 1)), None),
        (directions[::3] * (1.0, 1.0, 0.0), None),
        (directions[::3], 5),
    ):
        poses = [replace(GOOD[0], accelerometer=COUNTS_PER_G * row, face=Face.NONE) for row in rows]
        if shaken is not None:
            poses[shaken] = replace(poses[shaken], accelerometer_spread=np.array([0.0, 0.0, 41.0]))
        ours, expected = fits("ellipsoid", poses), METHODS["ellipsoid"](poses)
        assert (ours.status, ours.pose) == (expected.status, expected.pose)
        assert ours.status is not AccelerometerStatus.OK
        assert np.array_equal(ours.fit.gain, NOMINAL.gain)
        assert np.array_equal(ours.fit.offset, NOMINAL.offset)


_anything = st.floats(width=32, allow_nan=False, allow_infinity=False)


@pytest.mark.parametrize("method", METHODS)
@settings(deadline=None)
@given(
    means=st.lists(st.tuples(_anything, _anything, _anything), max_size=20),
    around=st.sampled_from([0.0, 1.0, 8192.0]),
    faces=st.permutations(FACES),
)
def test_no_poses_whatever_end_in_nan_or_infinity(
    fits: Fits, method: str, means: list[tuple[float, float, float]], around: float, faces: list[Face]
) -> None:
    poses = [
        replace(GOOD[0], face=faces[k % 6], accelerometer=np.array(mean) + around * np.array(faces[k % 6].gravity_g))
        for k, mean in enumerate(means)
    ]
    result = fits(method, [pose for pose in poses if np.abs(pose.accelerometer).max() < 3e38])
    assert np.isfinite(result.fit.gain).all()
    assert np.isfinite(result.fit.offset).all()


# -- the command --------------------------------------------------------------------------------


def on_the_wire(pose: StillPose) -> bytes:
    body = packed(pose)
    return body[50:51] + body[48:50] + body[:48]


@pytest.fixture(scope="module")
def bench() -> Bench:
    """The board with no sensor at all: a fit needs poses only."""
    return Bench()


def put(bench: Bench, poses: Sequence[StillPose]) -> None:
    bench.ask(CLEAR_POSES)
    for first in range(0, len(poses), 20):
        part = poses[first : first + 20]
        bench.ask(UPLOAD_POSES, bytes([first, len(part)]) + b"".join(map(on_the_wire, part)))


def asked(n: int, method: str) -> bytes:
    return bytes([n, len(method)]) + method.encode()


# In the model, at zero wait states: fixed for six faces, whatever they read; 40 poses, of which each costs some 900.
CYCLES = {"six-position": range(3_000, 9_000), "ellipsoid": range(20_000, 60_000)}


@pytest.mark.parametrize("method", METHODS)
def test_the_command_answers_fit_residual_and_cycles(bench: Bench, method: str) -> None:
    poses = instance(method, 31)  # 40 poses for the ellipsoid
    put(bench, poses)
    *fields, cycles, overhead = REPLY.unpack(bench.ask(FIT_ACCELEROMETER, asked(len(poses), method)))
    ours, expected = unpacked(*fields), METHODS[method](poses)
    assert (ours.status, ours.faces, ours.pose) == (AccelerometerStatus.OK, (), None)
    assert largest_difference_mg(ours.fit, expected.fit) < TOLERANCE_MG[method]
    assert ours.residual_mg == pytest.approx(expected.residual_mg, abs=TOLERANCE_MG[method])
    assert expected.residual_mg > 0.1
    print(method, len(poses), cycles, overhead)
    assert cycles in CYCLES[method]
    # Nothing else enters: a second run costs what the first did.
    assert REPLY.unpack(bench.ask(FIT_ACCELEROMETER, asked(len(poses), method)))[-2:] == (cycles, overhead)


def test_a_fault_comes_with_its_faces_and_no_residual(bench: Bench) -> None:
    put(bench, [GOOD[0], SHAKEN, *GOOD[2:]])
    *fields, _, _ = REPLY.unpack(bench.ask(FIT_ACCELEROMETER, asked(6, "six-position")))
    result = unpacked(*fields)
    assert (result.status, result.faces, result.pose) == (AccelerometerStatus.MOVED, (Face.MINUS_X,), 1)
    assert result.residual_mg == 0.0
    *fields, _, _ = REPLY.unpack(bench.ask(FIT_ACCELEROMETER, asked(0, "six-position")))
    assert unpacked(*fields).faces == FACES


def test_a_method_that_is_none_and_poses_that_are_not_there_are_refused(bench: Bench) -> None:
    put(bench, GOOD)
    assert bench.status(FIT_ACCELEROMETER, asked(6, "six")) == Status.UNKNOWN_CALIBRATOR
    assert bench.status(FIT_ACCELEROMETER, asked(7, "six-position")) == Status.TOO_FEW_POINTS
    assert bench.status(FIT_ACCELEROMETER, asked(6, "six-position") + b"!") == Status.BAD_LENGTH
    assert bench.status(FIT_ACCELEROMETER, b"\x06") == Status.BAD_LENGTH


def test_without_a_cycle_counter_the_fit_comes_without_cycles() -> None:
    bench = Bench(cycle_counter=False)
    put(bench, GOOD)
    reply = bench.request(FIT_ACCELEROMETER, asked(6, "six-position")).payload
    assert Status(reply[0]) == Status.NO_CYCLE_COUNTER
    status, *_, cycles, overhead = REPLY.unpack(reply[1:])
    assert (status, cycles, overhead) == (AccelerometerStatus.OK, 0, 0)
