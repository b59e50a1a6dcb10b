"""Every command of the firmware, executed on the virtual board: what it answers, and what it refuses."""

from __future__ import annotations

import math
import struct

import pytest

from hiltest.link.framing import Frame, encode_frame
from hiltest.link.messages import PROTOCOL_VERSION
from hiltest.link.replies import Status

from .bench import (
    AVERAGE,
    CALIBRATE,
    CLEAR,
    CLEAR_POINTS,
    COLLECT,
    GET,
    GET_ACCELEROMETER,
    IDENTITY,
    POINTS,
    READ,
    RESET,
    REST,
    SELECT,
    SENSORS,
    SET,
    SET_ACCELEROMETER,
    STATISTICS,
    SYNC,
    UPLOAD,
    Bench,
    bench_with,
    sphere,
)

MAG3110, ACCELEROMETER, FXOS8700_MAGNETOMETER, GYROSCOPE, ON_BOARD_ACCELEROMETER, ON_BOARD_MAGNETOMETER = range(6)
IDENTITY_CALIBRATION = struct.pack("<12f", 1, 0, 0, 0, 1, 0, 0, 0, 1, 0, 0, 0)
SECOND_US = 1_000_000


@pytest.fixture(scope="module")
def bench() -> Bench:
    """The board with everything on it; tests leave no points and no calibrations behind."""
    return bench_with("i2c0", "i2c1")


@pytest.fixture(scope="module")
def bare_bench() -> Bench:
    """The board with no sensor at all."""
    return Bench()


# -- the link -----------------------------------------------------------------------------------


def test_sync_answers_the_nonce_and_the_protocol_version(bench: Bench) -> None:
    assert struct.unpack("<IH", bench.ask(SYNC, struct.pack("<I", 0x7D7E5D5E))) == (0x7D7E5D5E, PROTOCOL_VERSION)


def test_unknown_types_are_refused(bare_bench: Bench) -> None:
    assert {bare_bench.status(kind) for kind in (0x00, 0x40, 0x7F)} == {Status.UNKNOWN_COMMAND}


LENGTHS = {
    SYNC: 4,
    IDENTITY: 0,
    SENSORS: 0,
    SELECT: 1,
    READ: 6,
    COLLECT: 6,
    POINTS: 3,
    CLEAR_POINTS: 0,
    SET: 49,
    GET: 1,
    CLEAR: 1,
    SET_ACCELEROMETER: 49,
    GET_ACCELEROMETER: 1,
    AVERAGE: 8,
    REST: 11,
    STATISTICS: 0,
    RESET: 0,
}


@pytest.mark.parametrize("kind", LENGTHS)
def test_a_payload_of_another_length_is_refused(bare_bench: Bench, kind: int) -> None:
    wrong = [length for length in (LENGTHS[kind] - 1, LENGTHS[kind] + 1, 1024) if length >= 0]
    assert {bare_bench.status(kind, bytes(length)) for length in wrong} == {Status.BAD_LENGTH}


@pytest.mark.parametrize("payload", [b"", bytes(2), b"\x00\x00\x02" + bytes(11), bytes(3 + 161 * 6)])
def test_an_upload_whose_count_and_length_differ_is_refused(bare_bench: Bench, payload: bytes) -> None:
    assert bare_bench.status(UPLOAD, payload) == Status.BAD_LENGTH


@pytest.mark.parametrize("payload", [b"\x01\x00\x00\x00", b"\x01\x00\x00\x00\x06direc", b"\x01\x00\x00\x00\x06direct!"])
def test_a_calibrator_name_that_does_not_fill_the_payload_is_refused(bare_bench: Bench, payload: bytes) -> None:
    assert bare_bench.status(CALIBRATE, payload) == Status.BAD_LENGTH


def test_a_repeated_request_is_answered_again_but_not_executed_again(bare_bench: Bench) -> None:
    bare_bench.ask(CLEAR_POINTS)
    repeated_before = bare_bench.counters()[3]
    point = struct.pack("<HB3h", 0, 1, 10, 20, 30)
    first = bare_bench.request(UPLOAD, point, sequence=200)
    assert bare_bench.request(UPLOAD, point, sequence=200) == first
    assert bare_bench.counters()[3] == repeated_before + 1
    assert bare_bench.ask(POINTS, struct.pack("<HB", 0, 80))[0] == 1
    # Executed again it would be refused: the first point is there by now.
    assert bare_bench.status(UPLOAD, point) == Status.BAD_ARGUMENT


def test_a_damaged_frame_is_dropped_and_counted(bare_bench: Bench) -> None:
    before = bare_bench.counters()
    damaged = bytearray(encode_frame(Frame(SYNC, 9, b"\x01\x02\x03\x04")))
    damaged[6] ^= 0x10
    bare_bench.send(bytes(damaged))
    assert bare_bench.receive(within_s=0.05) is None
    after = bare_bench.counters()
    assert after[1] == before[1] + 1
    assert after[0] == before[0] + 1  # only the request for the counters


def test_the_longest_request_is_not_lost_while_a_command_runs(bench: Bench) -> None:
    bench.send(encode_frame(Frame(READ, 1, struct.pack("<BBI", MAG3110, 30, SECOND_US))))
    bench.send(encode_frame(Frame(SYNC, 2, bytes([0x7E, 0x7D] * 512))))
    first, second = bench.receive(), bench.receive()
    assert first is not None
    assert second is not None
    assert (first.type, first.payload[0], first.payload[1]) == (READ | 0x80, Status.OK, 30)
    assert (second.type, second.payload) == (SYNC | 0x80, bytes([Status.BAD_LENGTH]))
    assert bench.counters()[2] == 0


def test_reset_answers_and_then_starts_afresh() -> None:
    bench = Bench()
    bench.ask(SET, b"\x00" + IDENTITY_CALIBRATION)
    bench.ask(RESET)
    bench.board.run_until(bench.board.time_s + 0.01)  # what arrives during the reset is lost
    assert bench.counters() == (1, 0, 0, 0)
    assert bench.status(GET, b"\x00") == Status.NO_CALIBRATION


# -- sensors ------------------------------------------------------------------------------------


def listed(bench: Bench) -> list[tuple[int, ...]]:
    """Id, kind, bus, address, expected and seen WHO_AM_I, present, selected of every sensor."""
    data = bench.ask(SENSORS)
    rows, position = [], 1
    for _ in range(data[0]):
        rows.append(tuple(data[position : position + 8]))
        position += 9 + data[position + 8]
    assert position == len(data)
    return rows


def test_sensors_lists_the_shield_and_the_board(bench: Bench) -> None:
    bench.ask(SELECT, bytes([MAG3110]))
    assert listed(bench) == [
        (0, 0, 1, 0x0E, 0xC4, 0xC4, 1, 1),
        (1, 1, 1, 0x1E, 0xC7, 0xC7, 1, 1),
        (2, 0, 1, 0x1E, 0xC7, 0xC7, 1, 0),
        (3, 2, 1, 0x20, 0xD7, 0xD7, 1, 1),
        (4, 1, 0, 0x1D, 0xC7, 0xC7, 1, 0),
        (5, 0, 0, 0x1D, 0xC7, 0xC7, 1, 0),
    ]


def test_without_the_shield_the_sensors_on_the_board_are_selected() -> None:
    bench = bench_with("i2c0")
    assert [row[6:] for row in listed(bench)] == [(0, 0)] * 4 + [(1, 1), (1, 1)]
    assert bench.status(SELECT, bytes([MAG3110])) == Status.SENSOR_ABSENT
    assert bench.status(READ, struct.pack("<BBI", GYROSCOPE, 1, SECOND_US)) == Status.SENSOR_ABSENT
    assert bench.status(REST, struct.pack("<HIBf", 1, SECOND_US, 0, 0.0)) == Status.SENSOR_ABSENT
    values = struct.unpack("<H12fH", bench.ask(AVERAGE, struct.pack("<HIH", 4, SECOND_US, 0)))[1:13]
    assert all(math.isfinite(value) for value in values)


def test_with_no_sensor_at_all_nothing_is_measured(bare_bench: Bench) -> None:
    assert all(row[5:] == (0, 0, 0) for row in listed(bare_bench))
    assert bare_bench.status(AVERAGE, struct.pack("<HIH", 4, SECOND_US, 0)) == Status.SENSOR_ABSENT
    assert bare_bench.status(COLLECT, struct.pack("<HI", 4, SECOND_US)) == Status.SENSOR_ABSENT


def test_select_changes_the_magnetometer(bench: Bench) -> None:
    bench.ask(SELECT, bytes([FXOS8700_MAGNETOMETER]))
    assert [row[7] for row in listed(bench)] == [0, 1, 1, 1, 0, 0]
    bench.ask(SELECT, bytes([MAG3110]))
    assert bench.status(SELECT, b"\x06") == Status.NO_SUCH_SENSOR


PERIODS_US = {
    MAG3110: 12_500,
    ACCELEROMETER: 5_000,
    FXOS8700_MAGNETOMETER: 5_000,
    GYROSCOPE: 5_000,
    ON_BOARD_ACCELEROMETER: 5_000,
    ON_BOARD_MAGNETOMETER: 5_000,
}


@pytest.mark.parametrize("sensor_id", PERIODS_US)
def test_read_gives_every_sample_once(bench: Bench, sensor_id: int) -> None:
    count = 64
    data = bench.ask(READ, struct.pack("<BBI", sensor_id, count, 2 * SECOND_US))
    rows = [struct.unpack_from("<Q3h", data, 1 + 14 * k) for k in range(count)]
    overruns, temperature_degc = struct.unpack_from("<Hb", data, 1 + 14 * count)
    assert overruns == 0
    assert 32 <= temperature_degc <= 41  # the rig's course; the FXOS8700CQ's step is 0.96 degC
    # A look finds a sample at most 1/8 of a period and one transaction late: over the whole run none is missing.
    elapsed = rows[-1][0] - rows[0][0]
    assert abs(elapsed - (count - 1) * PERIODS_US[sensor_id]) < PERIODS_US[sensor_id] / 4
    assert len({row[1:] for row in rows}) > count / 2  # noise makes most of them differ


@pytest.mark.parametrize(
    ("kind", "payload"),
    [
        (READ, struct.pack("<BBI", MAG3110, 64, 100_000)),
        (COLLECT, struct.pack("<HI", 100, 100_000)),
        (AVERAGE, struct.pack("<HIH", 100, 100_000, 0)),
        (REST, struct.pack("<HIBf", 100, 100_000, 0, 0.0)),
    ],
    ids=["read", "collect", "average", "rest"],
)
def test_a_timeout_ends_in_time(bench: Bench, kind: int, payload: bytes) -> None:
    bench.ask(CLEAR_POINTS)
    started_s = bench.board.time_s
    assert bench.status(kind, payload) == Status.SENSOR_TIMEOUT
    assert bench.board.time_s - started_s < 0.1 + 0.005  # 5 ms for both frames on the wire
    bench.ask(CLEAR_POINTS)


@pytest.mark.parametrize(
    ("kind", "payload"),
    [
        (READ, struct.pack("<BBI", MAG3110, 0, SECOND_US)),
        (READ, struct.pack("<BBI", MAG3110, 65, SECOND_US)),
        (READ, struct.pack("<BBI", MAG3110, 1, 60 * SECOND_US + 1)),
        (COLLECT, struct.pack("<HI", 0, SECOND_US)),
        (COLLECT, struct.pack("<HI", 513, SECOND_US)),
        (UPLOAD, struct.pack("<HB", 1, 0)),
        (POINTS, struct.pack("<HB", 0, 81)),
        (POINTS, struct.pack("<HB", 1, 1)),
        (CALIBRATE, struct.pack("<HHB", 0, 0, 6) + b"direct"),
        (SET, b"\x10" + IDENTITY_CALIBRATION),
        (SET, b"\x00" + struct.pack("<f", math.nan) + IDENTITY_CALIBRATION[4:]),
        (SET, b"\x00" + IDENTITY_CALIBRATION[:-4] + struct.pack("<f", math.inf)),
        (GET, b"\x10"),
        (CLEAR, b"\x10"),
        (SET_ACCELEROMETER, b"\x10" + IDENTITY_CALIBRATION),
        (SET_ACCELEROMETER, b"\x00" + struct.pack("<f", math.nan) + IDENTITY_CALIBRATION[4:]),
        (SET_ACCELEROMETER, b"\x0f" + IDENTITY_CALIBRATION[:-4] + struct.pack("<f", math.inf)),
        (GET_ACCELEROMETER, b"\x10"),
        (AVERAGE, struct.pack("<HIH", 0, SECOND_US, 0)),
        (AVERAGE, struct.pack("<HIH", 513, SECOND_US, 0)),
        (REST, struct.pack("<HIBf", 0, SECOND_US, 0, 0.0)),
        (REST, struct.pack("<HIBf", 4097, SECOND_US, 0, 0.0)),
        (REST, struct.pack("<HIBf", 1, SECOND_US, 2, 0.0)),
    ],
)
def test_an_argument_out_of_range_is_refused(bench: Bench, kind: int, payload: bytes) -> None:
    assert bench.status(kind, payload) == Status.BAD_ARGUMENT


# -- points and calibrations --------------------------------------------------------------------


def test_collect_stores_new_points_with_their_gravity_and_range(bench: Bench) -> None:
    bench.ask(CLEAR_POINTS)
    stored, *limits, overruns = struct.unpack("<H6hH", bench.ask(COLLECT, struct.pack("<HI", 10, SECOND_US)))
    assert (stored, overruns) == (10, 0)
    data = bench.ask(POINTS, struct.pack("<HB", 0, 80))
    points = [struct.unpack_from("<6h", data, 1 + 12 * k) for k in range(data[0])]
    assert [min(p[axis] for p in points) for axis in range(3)] == limits[:3]
    assert [max(p[axis] for p in points) for axis in range(3)] == limits[3:]
    assert all(abs(math.hypot(*p[3:]) - 8192) < 100 for p in points)  # 1 g; the rig's errors are below 10 mg
    bench.ask(CLEAR_POINTS)


def test_points_come_back_as_they_were_uploaded(bare_bench: Bench) -> None:
    points = sphere(200)
    bare_bench.upload(points)
    data = bare_bench.ask(POINTS, struct.pack("<HB", 130, 80))
    assert data[0] == 70  # no more are there
    assert [struct.unpack_from("<6h", data, 1 + 12 * k) for k in range(70)] == [(*p, 0, 0, 0) for p in points[130:]]


def test_a_full_buffer_refuses_more(bench: Bench) -> None:
    bench.upload(sphere(512))
    assert bench.status(UPLOAD, struct.pack("<HB3h", 512, 1, 1, 2, 3)) == Status.BUFFER_FULL
    assert bench.status(COLLECT, struct.pack("<HI", 1, SECOND_US)) == Status.BUFFER_FULL
    bench.ask(CLEAR_POINTS)


FIT = struct.Struct("<BBH9f3ffII")


def calibrate(bench: Bench, name: bytes, n: int, *, iterations: int = 0) -> Frame:
    return bench.request(CALIBRATE, struct.pack("<HHB", n, iterations, len(name)) + name)


@pytest.mark.parametrize("name", [b"direct", b"iterative"])
def test_a_calibrator_runs_on_the_first_n_points_and_is_timed(bare_bench: Bench, name: bytes) -> None:
    far = [(20000, -20000, 20000)] * 5  # after the first 100: range and fit must not know of them
    bare_bench.upload(sphere(100) + far)
    with_more = calibrate(bare_bench, name, 100)
    bare_bench.upload(sphere(100))
    assert calibrate(bare_bench, name, 100).payload == with_more.payload
    status, flags, _, *rest = FIT.unpack(with_more.payload[1:])
    soft_iron, hard_iron, cycles, overhead = rest[:9], rest[9:12], rest[13], rest[14]
    assert (status, flags) == (0, 0)
    # Rounding to whole counts moves each point by at most 0.87 counts; the centre is a mean over 100 of them.
    assert hard_iron == pytest.approx([100, -200, 300], abs=0.87)
    assert soft_iron == pytest.approx([1 / 500, 0, 0, 0, 1 / 500, 0, 0, 0, 1 / 500], abs=0.87 / 500**2 * 2)
    assert 0 < overhead < 100 < cycles


def test_a_limit_on_iterations_ends_the_solver_with_the_fit_that_it_has_by_then(bare_bench: Bench) -> None:
    bare_bench.upload([(x + y // 3, y, z - x // 4) for x, y, z in sphere(100)])
    statuses, sweeps, cycles, soft_irons = [], [], [], []
    for limit in range(1, 9):
        status, _, made, *rest = FIT.unpack(calibrate(bare_bench, b"iterative", 100, iterations=limit).payload[1:])
        statuses.append(status)
        sweeps.append(made)
        cycles.append(rest[13])
        soft_irons.append(rest[:9])
    enough = statuses.index(0)
    assert set(statuses[:enough]) <= {1, 5}  # NOT_AN_ELLIPSOID, NOT_CONVERGED
    assert sweeps[: enough + 1] == [*range(1, enough + 1), enough]
    assert cycles[: enough + 1] == sorted(set(cycles[: enough + 1]))
    # Cyclic rotations converge quadratically; in parts of the matrix.
    left = [math.dist(soft_iron, soft_irons[enough]) * 500 for soft_iron in soft_irons]
    assert left[0] > 0.1
    assert left[enough - 1] < 1e-5
    # Beyond what it needs, and with no limit at all, it is the same run.
    unlimited = calibrate(bare_bench, b"iterative", 100).payload
    assert calibrate(bare_bench, b"iterative", 100, iterations=8).payload == unlimited
    assert calibrate(bare_bench, b"iterative", 100, iterations=65535).payload == unlimited
    direct = calibrate(bare_bench, b"direct", 100).payload
    assert calibrate(bare_bench, b"direct", 100, iterations=1).payload == direct


def test_calibrate_refuses_what_it_cannot_do(bare_bench: Bench) -> None:
    bare_bench.upload(sphere(20))
    assert calibrate(bare_bench, b"magic", 20).payload == bytes([Status.UNKNOWN_CALIBRATOR])
    assert calibrate(bare_bench, b"", 20).payload == bytes([Status.UNKNOWN_CALIBRATOR])
    assert calibrate(bare_bench, b"direct", 21).payload == bytes([Status.TOO_FEW_POINTS])


def test_without_a_cycle_counter_the_fit_comes_with_a_status_that_says_so() -> None:
    bench = Bench(cycle_counter=False)
    assert bench.ask(IDENTITY)[6] == 0
    bench.upload(sphere(100))
    reply = calibrate(bench, b"direct", 100).payload
    assert Status(reply[0]) == Status.NO_CYCLE_COUNTER
    *_, cycles, overhead = FIT.unpack(reply[1:])
    assert (reply[1], cycles, overhead) == (0, 0, 0)


def test_slots_keep_calibrations_until_they_are_cleared(bare_bench: Bench) -> None:
    slots = [struct.pack("<12f", *(slot + k / 8 for k in range(12))) for slot in range(16)]
    for slot, calibration in enumerate(slots):
        bare_bench.ask(SET, bytes([slot]) + calibration)
    assert [bare_bench.ask(GET, bytes([slot])) for slot in range(16)] == slots
    for slot in range(16):
        bare_bench.ask(CLEAR, bytes([slot]))
        assert bare_bench.status(GET, bytes([slot])) == Status.NO_CALIBRATION


NOMINAL_ACCELEROMETER = struct.pack("<12f", 1 / 8192, 0, 0, 0, 1 / 8192, 0, 0, 0, 1 / 8192, 0, 0, 0)


def test_every_slot_has_an_accelerometer_calibration_of_its_own(bare_bench: Bench) -> None:
    assert [bare_bench.ask(GET_ACCELEROMETER, bytes([slot])) for slot in range(16)] == 16 * [NOMINAL_ACCELEROMETER]
    given = [struct.pack("<12f", *(slot - k / 8 for k in range(12))) for slot in range(16)]
    for slot, calibration in enumerate(given):
        bare_bench.ask(SET_ACCELEROMETER, bytes([slot]) + calibration)
    assert bare_bench.status(GET, b"\x05") == Status.NO_CALIBRATION  # of the magnetometer, as before
    bare_bench.ask(SET, b"\x05" + IDENTITY_CALIBRATION)
    assert [bare_bench.ask(GET_ACCELEROMETER, bytes([slot])) for slot in range(16)] == given
    for slot in range(16):
        bare_bench.ask(CLEAR, bytes([slot]))
        assert bare_bench.ask(GET_ACCELEROMETER, bytes([slot])) == NOMINAL_ACCELEROMETER


# -- averages -----------------------------------------------------------------------------------


def test_average_answers_each_asked_slot_in_order(bench: Bench) -> None:
    bench.ask(SET, b"\x01" + IDENTITY_CALIBRATION)
    bench.ask(SET, b"\x0f" + bytes(48))  # maps every field to zero
    data = bench.ask(AVERAGE, struct.pack("<HIH", 16, SECOND_US, 0x8012))
    slots = [struct.unpack_from("<B3f", data, 52 + 13 * k) for k in range((len(data) - 52) // 13)]
    assert [slot[0] for slot in slots] == [Status.OK, Status.NO_CALIBRATION, Status.DEGENERATE_FIELD]
    assert all(math.isfinite(angle) for angle in slots[0][1:])
    assert all(math.isnan(angle) for slot in slots[1:] for angle in slot[1:])
    count, *values, overruns = struct.unpack_from("<H12fH", data)
    assert (count, overruns) == (16, 0)
    assert math.hypot(*values[6:9]) == pytest.approx(8192, abs=100)  # gravity; the rig's errors are below 10 mg
    # 0.4 uT rms are 4 counts; a sample deviation of 16 readings is within 60 % of it but for 1 in 1000.
    assert values[3:6] == pytest.approx([4, 4, 4], rel=0.6)
    for slot in (1, 15):
        bench.ask(CLEAR, bytes([slot]))


def test_a_slots_attitude_uses_its_accelerometer_calibration_and_no_others(bench: Bench) -> None:
    quarter_turned = struct.pack("<12f", 1, 0, 0, 0, 0, 1, 0, -1, 0, 100, 200, 300)  # y is what z was, z what y was not
    for slot in (2, 3):
        bench.ask(SET, bytes([slot]) + IDENTITY_CALIBRATION)
    bench.ask(SET_ACCELEROMETER, b"\x03" + quarter_turned)
    data = bench.ask(AVERAGE, struct.pack("<HIH", 16, SECOND_US, 0b1100))
    x, y, z = struct.unpack_from("<3f", data, 26)
    plain, turned = (struct.unpack_from("<B3f", data, 52 + 13 * k) for k in range(2))
    assert [plain[0], turned[0]] == [Status.OK, Status.OK]
    assert plain[2:] == pytest.approx([math.degrees(math.atan2(-x, math.hypot(y, z))), math.degrees(math.atan2(y, z))])
    x, y, z = x - 100, z - 300, -(y - 200)
    assert turned[2:] == pytest.approx([math.degrees(math.atan2(-x, math.hypot(y, z))), math.degrees(math.atan2(y, z))])
    for slot in (2, 3):
        bench.ask(CLEAR, bytes([slot]))
