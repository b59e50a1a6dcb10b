"""The buffer of still poses: what the firmware stores, gives back and refuses."""

from __future__ import annotations

import math
import struct

import pytest

from hiltest.link.replies import Status

from .bench import ADD_POSE, CLEAR_POSES, POSES, UPLOAD_POSES, Bench, bench_with

SECOND_US = 1_000_000
POSE = struct.Struct("<BH12f")


@pytest.fixture(scope="module")
def bench() -> Bench:
    return bench_with("i2c1")


@pytest.fixture(scope="module")
def bare_bench() -> Bench:
    """The board with no sensor at all."""
    return Bench()


def some_pose(number: int, face: int = 255) -> bytes:
    return POSE.pack(face, 16 + number, *(number + k / 4 for k in range(12)))


def fill(bench: Bench, count: int) -> None:
    bench.ask(CLEAR_POSES)
    for first in range(0, count, 20):
        part = [some_pose(number) for number in range(first, min(first + 20, count))]
        assert bench.ask(UPLOAD_POSES, bytes([first, len(part)]) + b"".join(part)) == bytes([first + len(part)])


def test_a_pose_is_the_average_of_new_samples_and_is_stored(bench: Bench) -> None:
    bench.ask(CLEAR_POSES)
    for number, face in enumerate((4, 255)):
        index, count, *values, overruns, degc = struct.unpack(
            "<BH12fHb", bench.ask(ADD_POSE, struct.pack("<HIB", 16, SECOND_US, face))
        )
        assert (index, count, overruns) == (number, 16, 0)
        assert 32 <= degc <= 41  # the course of the rig, as an untrimmed part gives it
        # 0.4 uT rms are 4 counts; a sample deviation of 16 readings is within 60 % of it but for 1 in 1000.
        assert values[3:6] == pytest.approx([4, 4, 4], rel=0.6)
        assert math.hypot(*values[6:9]) == pytest.approx(8192, abs=100)
        data = bench.ask(POSES, bytes([number, 20]))
        assert data[0] == 1
        assert POSE.unpack(data[1:]) == (face, 16, *values)
    bench.ask(CLEAR_POSES)
    assert bench.ask(POSES, b"\x00\x14") == b"\x00"


def test_a_single_reading_has_no_spread(bench: Bench) -> None:
    bench.ask(CLEAR_POSES)
    bench.ask(ADD_POSE, struct.pack("<HIB", 1, SECOND_US, 255))
    numbers = POSE.unpack(bench.ask(POSES, b"\x00\x01")[1:])[2:]
    assert [math.isnan(number) for number in numbers] == [False, False, False, True, True, True] * 2
    bench.ask(CLEAR_POSES)


def test_uploaded_poses_come_back_as_they_were(bare_bench: Bench) -> None:
    fill(bare_bench, 45)
    data = bare_bench.ask(POSES, bytes([30, 20]))
    assert data == bytes([15]) + b"".join(some_pose(number) for number in range(30, 45))


def test_the_buffer_holds_128_poses_and_no_more(bench: Bench) -> None:
    fill(bench, 128)
    assert bench.status(UPLOAD_POSES, bytes([128, 1]) + some_pose(0)) == Status.BUFFER_FULL
    assert bench.status(ADD_POSE, struct.pack("<HIB", 1, SECOND_US, 255)) == Status.BUFFER_FULL
    assert bench.ask(POSES, bytes([127, 20])) == b"\x01" + some_pose(127)
    bench.ask(CLEAR_POSES)


def test_a_pose_needs_a_magnetometer_and_an_accelerometer(bare_bench: Bench) -> None:
    assert bare_bench.status(ADD_POSE, struct.pack("<HIB", 1, SECOND_US, 255)) == Status.SENSOR_ABSENT


def without(place: int, value: float) -> bytes:
    numbers = [1.0] * 12
    numbers[place] = value
    return POSE.pack(0, 16, *numbers)


@pytest.mark.parametrize(
    ("kind", "payload"),
    [
        (ADD_POSE, struct.pack("<HIB", 0, SECOND_US, 255)),
        (ADD_POSE, struct.pack("<HIB", 513, SECOND_US, 255)),
        (ADD_POSE, struct.pack("<HIB", 16, 60_000_001, 255)),
        (ADD_POSE, struct.pack("<HIB", 16, SECOND_US, 6)),
        (POSES, b"\x00\x15"),
        (POSES, b"\x01\x01"),
        (UPLOAD_POSES, b"\x01\x01" + some_pose(1)),
        (UPLOAD_POSES, b"\x00\x02" + some_pose(1) + some_pose(1, face=6)),
        (UPLOAD_POSES, b"\x00\x01" + POSE.pack(0, 0, *[1.0] * 12)),
        (UPLOAD_POSES, b"\x00\x01" + without(0, math.nan)),
        (UPLOAD_POSES, b"\x00\x01" + without(8, math.inf)),
        (UPLOAD_POSES, b"\x00\x01" + without(4, -1.0)),
        (UPLOAD_POSES, b"\x00\x01" + without(11, math.inf)),
    ],
)
def test_an_argument_out_of_range_is_refused_and_nothing_is_stored(bench: Bench, kind: int, payload: bytes) -> None:
    bench.ask(CLEAR_POSES)
    assert bench.status(kind, payload) == Status.BAD_ARGUMENT
    assert bench.ask(POSES, b"\x00\x14") == b"\x00"


@pytest.mark.parametrize(
    ("kind", "payload"),
    [
        (ADD_POSE, bytes(6)),
        (ADD_POSE, bytes(8)),
        (POSES, bytes(1)),
        (POSES, bytes(3)),
        (CLEAR_POSES, bytes(1)),
        (UPLOAD_POSES, bytes(1)),
        (UPLOAD_POSES, b"\x00\x01" + bytes(50)),
        (UPLOAD_POSES, b"\x00\x02" + some_pose(1)),
    ],
)
def test_a_payload_of_another_length_is_refused(bare_bench: Bench, kind: int, payload: bytes) -> None:
    assert bare_bench.status(kind, payload) == Status.BAD_LENGTH
