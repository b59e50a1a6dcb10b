"""Requests and replies are the bytes the protocol page says; hostile bytes are refused by name."""

from __future__ import annotations

import math
import struct

import numpy as np
import pytest
from tests.link.requests import REQUESTS

from hiltest.calibration.accelerometer import AccelerometerStatus
from hiltest.calibration.fit import FitStatus
from hiltest.calibration.still_pose import FACES, Face, StillPose
from hiltest.errors import DeviceError, ProtocolError
from hiltest.link import messages as m
from hiltest.link.accelerometer import FitAccelerometer, GetAccelerometer, SetAccelerometer
from hiltest.link.fusion import FusionRead, FusionRun, FusionStart
from hiltest.link.poses import AddPose, ClearPoses, Poses, UploadPoses
from hiltest.link.replies import CycleSource, RunCost, SensorInfo, SensorKind, SlotHeading, Status
from hiltest.link.request import Request, decode_reply
from hiltest.link.streams import StreamFeed, StreamRemove, StreamReset, StreamState, StreamStatus
from hiltest.orientation.angles import Pose

POSE = StillPose(
    magnetometer=np.array([1.0, -2.0, 0.5]),
    magnetometer_spread=None,
    accelerometer=np.array([-8192.0, 0.0, 4.0]),
    accelerometer_spread=np.array([0.0, 1.0, 1.0]),
    readings=16,
    face=Face.MINUS_X,
)


@pytest.mark.parametrize(
    ("request_", "code", "expected"),
    [
        (m.Sync(0x01020304), 0x01, "04030201"),
        (m.Identify(), 0x02, ""),
        (m.Sensors(), 0x03, ""),
        (m.Select(3), 0x04, "03"),
        (m.Read(2, 64, timeout_us=1_000_000), 0x05, "02 40 40420f00"),
        (m.Collect(300, timeout_us=65536), 0x06, "2c01 00000100"),
        (m.Upload(5, [(1, -1, 256), (-32768, 32767, 0)]), 0x07, "0500 02 0100 ffff 0001 0080 ff7f 0000"),
        (m.Upload(1, [(1, -1, 256, 2, -2, 512)]), 0x07, "0100 01 0100 ffff 0001 0200 feff 0002"),
        (m.Points(258, 80), 0x08, "0201 50"),
        (m.ClearPoints(), 0x09, ""),
        (m.Calibrate(100, "direct"), 0x0A, "6400 0000 06 646972656374"),
        (m.Calibrate(100, "direct", iterations=0x102), 0x0A, "6400 0201 06 646972656374"),
        (m.GetCalibration(7), 0x0C, "07"),
        (m.ClearCalibration(2), 0x0D, "02"),
        (m.Average(16, 0b101, timeout_us=1), 0x0E, "1000 01000000 0500"),
        (m.LinkStatistics(), 0x10, ""),
        (m.Reset(), 0x11, ""),
        (m.TimeRange(258), 0x27, "0201"),
        (StreamReset("ab", sliced=True), 0x12, "01 02 6162"),
        (StreamFeed("ab", 258, 80), 0x13, "0201 50 02 6162"),
        (StreamRemove("ab", 3, 1), 0x14, "0300 01 02 6162"),
        (StreamState("ab"), 0x15, "02 6162"),
        (GetAccelerometer(15), 0x17, "0f"),
        (FitAccelerometer(6, "ellipsoid"), 0x1C, "06 09 656c6c6970736f6964"),
        (FusionStart(3, 5, 16, timeout_us=2), 0x22, "03 05 1000 02000000"),
        (FusionRun(258), 0x23, "02010000"),
        (FusionRead(258, 36), 0x24, "0201 24"),
        (AddPose(512, Face.PLUS_Z, timeout_us=3), 0x18, "0002 03000000 04"),
        (AddPose(1, timeout_us=3), 0x18, "0100 03000000 ff"),
        (Poses(3, 20), 0x19, "03 14"),
        (ClearPoses(), 0x1A, ""),
        (
            UploadPoses(2, [POSE]),
            0x1B,
            "02 01 01 1000 0000803f 000000c0 0000003f 0000c07f 0000c07f 0000c07f"
            " 000000c6 00000000 00008040 00000000 0000803f 0000803f",
        ),
    ],
)
def test_request_payloads_are_those_written_by_hand(request_: Request[object], code: int, expected: str) -> None:
    assert request_.code == code
    assert request_.payload() == bytes.fromhex(expected)


def test_a_calibration_travels_row_major_in_float32() -> None:
    soft_iron = np.arange(1.0, 10.0).reshape(3, 3)
    payload = m.SetCalibration(4, soft_iron, [10.0, 20.0, -30.0]).payload()
    assert payload == bytes([4]) + struct.pack("<12f", *range(1, 10), 10, 20, -30)
    reply = decode_reply(m.GetCalibration(4), b"\x00" + payload[1:])
    assert np.array_equal(reply.soft_iron, soft_iron)
    assert np.array_equal(reply.hard_iron, [10.0, 20.0, -30.0])


def test_an_accelerometer_calibration_travels_row_major_in_float32() -> None:
    gain = np.arange(1.0, 10.0).reshape(3, 3) / 8192
    payload = SetAccelerometer(15, gain, [10.0, 20.0, -30.0]).payload()
    assert payload == bytes([15]) + struct.pack("<12f", *(k / 8192 for k in range(1, 10)), 10, 20, -30)
    back = decode_reply(GetAccelerometer(15), b"\x00" + payload[1:])
    assert np.array_equal(back.gain, gain)
    assert np.array_equal(back.offset, [10.0, 20.0, -30.0])


def test_a_pose_comes_back_as_it_was_sent() -> None:
    payload = UploadPoses(0, [POSE, POSE]).payload()
    first, second = decode_reply(Poses(0, 20), b"\x00" + payload[1:])
    assert first.magnetometer.tolist() == POSE.magnetometer.tolist()
    assert first.accelerometer.tolist() == POSE.accelerometer.tolist()
    assert second.magnetometer_spread is None
    assert second.accelerometer_spread is not None
    assert second.accelerometer_spread.tolist() == [0.0, 1.0, 1.0]
    assert (second.readings, second.face) == (16, Face.MINUS_X)
    with pytest.raises(ProtocolError, match="face at byte 2 of 104: 6 is not a Face"):
        decode_reply(Poses(0, 20), b"\x00\x02\x06" + payload[3:])


def test_a_fit_of_an_accelerometer_names_the_faces_at_fault() -> None:
    numbers = [float(k) for k in range(12)]
    data = struct.pack("<B3B13fII", 0, AccelerometerStatus.MISPLACED_FACE, 0b100010, 255, *numbers, 0.5, 900, 30)
    reply = decode_reply(FitAccelerometer(6, "six-position"), data)
    assert reply.solution.status is AccelerometerStatus.MISPLACED_FACE
    assert reply.solution.faces == (Face.MINUS_X, Face.MINUS_Z)
    assert reply.solution.pose is None
    assert reply.solution.fit.gain.ravel().tolist() == numbers[:9]
    assert reply.solution.fit.offset.tolist() == numbers[9:]
    assert (reply.solution.residual_mg, reply.cost) == (0.5, RunCost(900, 30))


def test_a_face_reads_gravity_on_the_axis_that_is_down() -> None:
    assert [face.gravity_g for face in FACES] == [(1, 0, 0), (-1, 0, 0), (0, 1, 0), (0, -1, 0), (0, 0, 1), (0, 0, -1)]
    with pytest.raises(ValueError, match="no gravity"):
        _ = Face.NONE.gravity_g


def test_what_a_fusion_run_did_and_what_it_kept() -> None:
    done = struct.pack("<BQ5H4I", 0, 10**12, 2, 3, 4, 5, 6, 10, 532, 5280, 22)
    summary = decode_reply(FusionRun(1), done)
    assert (summary.began_us, summary.records, summary.no_attitude) == (10**12, 2, 3)
    assert (summary.field_left_out, summary.bad_steps, summary.overruns) == (4, 5, 6)
    assert (summary.costs.updates, summary.costs.largest, summary.costs.mean_cycles) == (10, RunCost(532, 22), 528.0)
    assert summary.left_out == 3 + 4 + 5 + 6
    none, uncounted = (
        decode_reply(FusionRun(1), status + done[1:19] + struct.pack("<4I", *costs)).costs
        for status, costs in ((b"\x00", (0, 0, 0, 22)), (b"\x0c", (10, 0, 0, 0)))
    )
    assert none.mean_cycles is None  # of no update
    assert (uncounted.updates, uncounted.largest, uncounted.mean_cycles) == (10, None, None)

    record = struct.pack("<I12h", 12500, 0, 0, 0, 32767, 0, 0, 0, 0, -32767, 0, 0, 0)
    records = decode_reply(FusionRead(0, 1), b"\x00\x01" + record)
    assert records.time_us.tolist() == [12500]
    assert records.fused.tolist() == [[0, 0, 0, 1]]
    assert np.isnan(records.measured).all()
    assert records.turned.tolist() == [[-1, 0, 0, 0]]
    assert len(decode_reply(FusionRead(5, 1), b"\x00\x00").time_us) == 0


def test_identity_fields_are_read_in_order() -> None:
    def text(value: str) -> bytes:
        return bytes([len(value)]) + value.encode()

    data = struct.pack("<BHIBHB4I", 0, 1, 120_000_000, 1, 512, 8, 0x01020304, 0x05060708, 0x090A0B0C, 0x0D0E0F10)
    data += text("hiltest-frdm-k64f") + text("0.1.0") + text("0123456789abcdef") + text("gcc 12.2.1") + text("sram")
    data += bytes([2]) + text("direct") + text("iterative") + bytes([1]) + text("direct-stream")
    identity = decode_reply(m.Identify(), data)
    assert identity.core_clock_hz == 120_000_000
    assert identity.cycle_source is CycleSource.DWT
    assert (identity.max_points, identity.slots) == (512, 8)
    assert identity.unique_id == bytes(range(1, 17))
    assert identity.build_id == "0123456789abcdef"
    assert identity.placement == "sram"
    assert identity.calibrators == ("direct", "iterative")
    assert identity.stream_calibrators == ("direct-stream",)


def test_sensors_are_listed_with_what_they_answered() -> None:
    data = bytes([0, 1, 5, 0, 1, 0x0E, 0xC4, 0xC4, 1, 0, 7]) + b"MAG3110"
    (sensor,) = decode_reply(m.Sensors(), data)
    assert sensor == SensorInfo(5, SensorKind.MAGNETOMETER, 1, 0x0E, 0xC4, 0xC4, True, False, "MAG3110")


def test_samples_keep_time_and_sign() -> None:
    data = struct.pack("<BB Qhhh Qhhh Hb", 0, 2, 10**12, 1, -2, 3, 10**12 + 12500, -32767, 32767, 0, 4, -7)
    reply = decode_reply(m.Read(1, 2), data)
    assert reply.time_us.tolist() == [10**12, 10**12 + 12500]
    assert reply.counts.tolist() == [[1, -2, 3], [-32767, 32767, 0]]
    assert (reply.overruns, reply.die_temperature_degc) == (4, -7)


def test_collect_points_and_calibrate_replies() -> None:
    collected = decode_reply(m.Collect(1), struct.pack("<BH6hH", 0, 40, -1, -2, -3, 1, 2, 3, 9))
    assert (collected.stored, collected.overruns) == (40, 9)
    assert collected.minimum.tolist() == [-1, -2, -3]
    assert collected.maximum.tolist() == [1, 2, 3]
    points = decode_reply(m.Points(0, 1), struct.pack("<BB6h", 0, 1, 1, 2, 3, 4, 5, 8192))
    assert points.magnetometer.tolist() == [[1, 2, 3]]
    assert points.accelerometer.tolist() == [[4, 5, 8192]]
    fit = decode_reply(
        m.Calibrate(100, "direct"), struct.pack("<BBBH13fII", 0, 2, 1, 7, *([0.5] * 12), 31.0, 12_400, 8)
    )
    assert fit.fit is FitStatus.POOR_COVERAGE
    assert fit.is_sphere
    assert (fit.iterations, fit.coverage, fit.cost) == (7, 31.0, RunCost(12_400, 8))


def test_a_core_that_counts_no_cycles_fits_all_the_same() -> None:
    data = struct.pack("<BBBH13fII", Status.NO_CYCLE_COUNTER, 0, 0, 0, *([0.5] * 12), 1.7, 0, 0)
    fit = decode_reply(m.Calibrate(100, "direct"), data)
    assert (fit.fit, fit.cost) == (FitStatus.ELLIPSOID, None)


def test_fed_points_are_counted_one_by_one_and_a_refused_one_is_named() -> None:
    steps = decode_reply(StreamFeed("s", 0, 3), struct.pack("<BBIBII", 0, 1, 8, 2, 330, 328))
    assert (steps.status, steps.taken) == (StreamStatus.OUT_OF_RANGE, 2)
    assert steps.costs == (RunCost(330, 8), RunCost(328, 8))
    uncounted = decode_reply(StreamFeed("s", 0, 1), struct.pack("<BBIBI", Status.NO_CYCLE_COUNTER, 0, 0, 1, 0))
    assert (uncounted.status, uncounted.taken, uncounted.costs) == (StreamStatus.OK, 1, None)


@pytest.mark.parametrize(
    ("status", "selected"), [(StreamStatus.OK, 2), (StreamStatus.OK, 4), (StreamStatus.FULL, 3), (StreamStatus.FULL, 4)]
)
def test_points_are_all_taken_or_one_is_refused(status: StreamStatus, selected: int) -> None:
    data = struct.pack(f"<BBIB{selected}I", 0, status, 8, selected, *range(selected))
    with pytest.raises(ProtocolError, match=f"{status.name} after {selected} of 3 points"):
        decode_reply(StreamFeed("s", 0, 3), data)


def test_the_state_of_a_stream_is_read_in_order() -> None:
    data = struct.pack("<BBBH13fHBIfII", 0, 0, 3, 4, *([0.5] * 12), 1.25, 250, 10, 7, 2.5, 900, 8)
    state = decode_reply(StreamState("s"), data)
    assert (state.fit, state.is_sphere, state.is_solving, state.iterations) == (FitStatus.ELLIPSOID, True, True, 4)
    assert (state.held, state.elements, state.accepted) == (250, 10, 7)
    assert (state.coverage, state.fit_error_percent, state.cost) == (1.25, 2.5, RunCost(900, 8))
    without = struct.pack("<BBBH13fHBIfII", 12, 3, 0, 0, *([0.5] * 12), 0.0, 5, 0, 0, math.nan, 0, 0)
    state = decode_reply(StreamState("s"), without)
    assert (state.fit, state.fit_error_percent, state.cost) == (FitStatus.TOO_FEW_POINTS, None, None)


def test_average_has_one_heading_for_each_slot_asked_for_from_low_to_high() -> None:
    data = struct.pack("<BH12fH", 0, 16, *range(12), 1)
    data += struct.pack("<B3f", 0, 10.0, 1.0, 2.0) + struct.pack("<B3f", 13, math.nan, math.nan, math.nan)
    reply = decode_reply(m.Average(16, 0b1001), data)
    assert list(reply.headings) == [0, 3]
    assert reply.headings[0].attitude == Pose(10.0, 1.0, 2.0)
    assert reply.headings[3] == SlotHeading(Status.DEGENERATE_FIELD, None)
    assert reply.accelerometer.mean.tolist() == [6.0, 7.0, 8.0]
    assert reply.accelerometer.spread is not None
    assert reply.accelerometer.spread.tolist() == [9.0, 10.0, 11.0]


def test_numbers_that_a_board_does_not_have_are_none() -> None:
    one_sample = [*range(3), *[math.nan] * 3]
    data = struct.pack("<BH12fH", 0, 1, *one_sample, *one_sample, 0)
    reply = decode_reply(m.Average(1), data)
    assert reply.magnetometer.spread is None
    assert reply.accelerometer.spread is None


@pytest.mark.parametrize("slot", [[math.nan] * 3, [1.0, math.nan, 2.0], [math.inf, 0.0, 0.0]])
def test_an_ok_heading_without_a_number_is_refused(slot: list[float]) -> None:
    data = struct.pack("<BH12fH", 0, 16, *range(12), 1) + struct.pack("<B3f", 0, *slot)
    with pytest.raises(ProtocolError, match=r"reply to AVERAGE: (heading at byte 54|pitch at byte 58) of 66"):
        decode_reply(m.Average(16, 1), data)


def test_an_error_status_names_command_status_and_a_way_out() -> None:
    with pytest.raises(DeviceError, match=r"READ with SENSOR_ABSENT: check that the FRDM-FXS-MULTI-B shield"):
        decode_reply(m.Read(1, 1), bytes([Status.SENSOR_ABSENT]))


@pytest.mark.parametrize(
    ("request_", "payload", "message"),
    [
        (m.Identify(), b"", "reply to IDENTITY: status at byte 0 of 0: needs 1 bytes, 0 are left"),
        (m.ClearPoints(), b"\x63", "status at byte 0 of 1: 99 is not a Status"),
        (m.ClearPoints(), b"\x00\x01", "end at byte 1 of 2: 1 bytes too many"),
        (m.ClearPoints(), b"\x03\x01", "end at byte 1 of 2: 1 bytes too many"),
        (m.Sync(1), b"\x00\x01\x00\x00", "nonce at byte 1 of 4: needs 4 bytes, 3 are left"),
        (m.Sensors(), b"\x00\x01\x05\x09", "kind at byte 3 of 4: 9 is not a SensorKind"),
        (m.Sensors(), b"\x00\x01\x05\x00\x01\x0e\xc4\xc4\x02", "present at byte 8 of 9: 2 is neither 0 nor 1"),
        (m.Sensors(), b"\x00\x01\x05\x00\x01\x0e\xc4\xc4\x01\x01\x02\xc3\x28", "name at byte 11 of 13"),
        (m.GetCalibration(0), b"\x00" + struct.pack("<12f", *[1.0] * 3, math.nan, *[1.0] * 8), "element 3 is nan"),
    ],
)
def test_a_malformed_reply_says_which_field_and_where(request_: Request[object], payload: bytes, message: str) -> None:
    with pytest.raises(ProtocolError, match=message):
        decode_reply(request_, payload)


@pytest.mark.parametrize(
    ("request_", "message"),
    [
        (m.Read(1, 65), "65 samples; the protocol takes 1 to 64"),
        (m.Collect(0), "0 points; the protocol takes 1 to 512"),
        (m.Upload(0, [(0, 0, 0)] * 161), "161 points"),
        (m.Upload(0, [(0, 0, 0, 0, 0, 0)] * 81), "81 points"),
        (m.Upload(0, [(0, 40_000, 0)]), "40000 counts"),
        (m.Points(0, 81), "81 points"),
        (m.Average(513), "513 samples"),
        (AddPose(0), "0 samples"),
        (Poses(0, 21), "21 poses; the protocol takes 1 to 20"),
        (UploadPoses(0, [POSE] * 21), "21 poses"),
        (m.Calibrate(9, ""), "0 characters"),
        (m.Calibrate(9, "direct", iterations=65536), "65536 iterations"),
        (StreamFeed("s", 0, 81), "81 points; the protocol takes 1 to 80"),
        (StreamRemove("s", -1, 1), "-1 points"),
        (StreamState(""), "0 characters"),
    ],
)
def test_requests_beyond_the_protocol_are_refused_before_they_are_sent(request_: Request[object], message: str) -> None:
    with pytest.raises(ValueError, match=message):
        request_.payload()


def test_codes_and_names_are_unique() -> None:
    kinds = {type(request) for request in REQUESTS}
    codes, names = ({getattr(kind, name) for kind in kinds} for name in ("code", "command"))
    assert len(codes) == len(names) == len(kinds)
