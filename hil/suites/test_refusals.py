"""Refusals: requests with one wrong field, and full buffers. The board's points, poses and last slot are replaced."""

from __future__ import annotations

import struct
from collections.abc import Iterator, Sequence
from itertools import product
from math import inf, nan
from typing import Any, NamedTuple

import numpy as np
import pytest

from hiltest.boards import Board
from hiltest.link.accelerometer import FitAccelerometer, GetAccelerometer, SetAccelerometer
from hiltest.link.dpi import FitDpi
from hiltest.link.framing import DELIMITER, ESCAPE, MAX_PAYLOAD, Frame, encode_frame
from hiltest.link.fusion import FusionRead, FusionRun, FusionStart
from hiltest.link.gyroscope import (
    FitGyroscope,
    GetGyroscope,
    GyroscopeRest,
    IntegrateGyroscope,
    LogGyroscope,
    SetGyroscope,
    StillnessKind,
)
from hiltest.link.messages import (
    Average,
    Calibrate,
    ClearCalibration,
    ClearPoints,
    Collect,
    GetCalibration,
    Identify,
    LinkStatistics,
    Points,
    Read,
    Reset,
    Select,
    Sensors,
    SetCalibration,
    Sync,
    TimeRange,
    Upload,
)
from hiltest.link.poses import AddPose, ClearPoses, Poses, UploadPoses
from hiltest.link.replies import SensorKind, Status
from hiltest.link.request import REPLY_BIT, Request
from hiltest.link.sequences import SEQUENCES, TimeSequence
from hiltest.link.streams import StreamFeed, StreamRemove, StreamReset, StreamState, StreamStatus
from hiltest.procedures import Turntable, upload_points
from hiltest.procedures.golden_points import golden_points

pytestmark = [pytest.mark.hil, pytest.mark.full]

POINTS = golden_points(3)
# A pose as it is sent: face, readings, then mean and spread of magnetometer and accelerometer.
POSE = (255, 16, *(100.0, 200.0, 300.0), *(4.0, 4.0, 4.0), *(0.0, 0.0, 8192.0), *(8.0, 8.0, 8.0))
POSE_CAPACITY = 128
# Turns about the three body axes, 10 s at 200 Hz: angles, sums, samples, duration, bias before and after, share.
TURNS = tuple(
    number
    for axis in range(3)
    for number in (
        *np.roll([360.0, 0.0, 0.0], axis),
        *np.roll([1_152_000, 0, 0], axis),
        2000,
        10_000_000,
        *[0.0] * 6,
        0.5,
    )
)
UNIT = (0.002, 0.0, 0.0, 0.0, 0.002, 0.0, 0.0, 0.0, 0.002, 0.0, 0.0, 0.0)
ENOUGH_US, LONGEST_US = 5_000_000, 60_000_000

OK, BAD, LENGTH, TIMEOUT = Status.OK, Status.BAD_ARGUMENT, Status.BAD_LENGTH, Status.SENSOR_TIMEOUT
FEW, UNKNOWN = Status.TOO_FEW_POINTS, Status.UNKNOWN_CALIBRATOR
LATE = (BAD, LONGEST_US + 1, 0xFFFF_FFFF)
NO_SENSOR = (Status.NO_SUCH_SENSOR, 99, 255)
# Requests that change the data that `prepare` stored.
CHANGING = (
    ClearPoints,
    ClearPoses,
    ClearCalibration,
    Upload,
    Collect,
    AddPose,
    UploadPoses,
    StreamFeed,
    StreamRemove,
)


def not_finite(*fields: int) -> tuple[tuple[Any, ...], ...]:
    """Return the rows of a case for real fields, which must be finite."""
    return (fields, BAD, nan), ((fields[0], fields[-1]), BAD, inf)


class Case(NamedTuple):
    """A valid request, and the status for other values of each field; `OK` for values just within the bounds."""

    request: type[Request[Any]]
    form: str = ""
    fields: tuple[Any, ...] = ()
    # Rows of: a field or several, the status, the values.
    others: tuple[tuple[Any, ...], ...] = ()
    answer: Status = OK

    def payload(self, index: int = -1, value: Any = None) -> bytes:
        """Return the payload, with one field changed."""
        return struct.pack("<" + self.form, *(value if i == index else field for i, field in enumerate(self.fields)))

    def changed(self) -> Iterator[tuple[str, bytes, Status]]:
        """Yield the change in words, the payload, and its status."""
        for fields, answer, *values in self.others:
            for index, value in product(fields if isinstance(fields, Sequence) else [fields], values):
                yield f"field {index} = {value}", self.payload(index, value), answer


def case_with_name(
    request: type[Request[Any]],
    form: str,
    fields: tuple[int, ...],
    name: str,
    *others: tuple[Any, ...],
    answer: Status = OK,
) -> Case:
    """Return a case that ends with a name; other names are unknown, or have another length than declared."""
    index, size = len(fields), len(name)
    unknown_names = (b"?" * size, name[:-1].encode() + b"?", b"?" + name[1:].encode())
    wrong = ((index, LENGTH, 0, size - 1, size + 1, 255), (index + 1, UNKNOWN, *unknown_names))
    return Case(request, f"{form}B{size}s", (*fields, size, name.encode()), (*others, *wrong), answer)


def cases(board: Board) -> Iterator[Case]:
    """Yield a case for each request but RESET, in the order of PROTOCOL.md, after `prepare`."""
    slots = board.identity.slots
    slot, no_slot = slots - 1, (BAD, slots, 255)
    linear = ((0, *no_slot), *not_finite(*range(1, 13)))
    selected = {info.kind: info.sensor_id for info in board.session.request(Sensors()) if info.selected}
    magnetometer = selected[SensorKind.MAGNETOMETER]
    yield from map(Case, (Identify, Sensors, ClearPoints, LinkStatistics, ClearPoses, GetGyroscope))
    yield Case(Sync, "I", (7,))
    yield Case(Select, "B", (magnetometer,), ((0, *NO_SENSOR),))
    yield Case(
        Read,
        "BBI",
        (magnetometer, 4, ENOUGH_US),
        ((0, *NO_SENSOR), (1, BAD, 0, 65, 255), (1, OK, 64), (2, *LATE), (2, TIMEOUT, 0, 5_000), (2, OK, LONGEST_US)),
    )
    yield Case(
        Collect, "HI", (4, ENOUGH_US), ((0, BAD, 0, 513, 0xFFFF), (1, *LATE), (1, TIMEOUT, 0), (1, OK, LONGEST_US))
    )
    yield Case(
        Upload,
        "HB6h",
        (3, 2, *range(6)),
        ((0, BAD, 0, 2, 4, 0xFFFF), (1, LENGTH, 0, 3, 160, 255), (1, OK, 1), (2, OK, -0x8000, 0x7FFF)),
    )
    yield Case(Points, "HB", (0, 2), ((0, BAD, 4, 0xFFFF), (0, OK, 3), (1, BAD, 81, 255), (1, OK, 0, 80)))
    for calibrator in board.identity.calibrators[:1]:
        yield case_with_name(
            Calibrate, "HH", (3, 0), calibrator, (0, BAD, 0), (0, FEW, 4, 0xFFFF), (0, OK, 1), (1, OK, 0xFFFF)
        )
    yield Case(SetCalibration, "B12f", (slot, *UNIT), linear)
    yield Case(GetCalibration, "B", (slot,), ((0, *no_slot),))
    yield Case(ClearCalibration, "B", (slot,), ((0, *no_slot),))
    yield Case(
        Average,
        "HIH",
        (4, ENOUGH_US, 1 << slot),
        ((0, BAD, 0, 513, 0xFFFF), (0, OK, 1), (1, *LATE), (1, TIMEOUT, 0, 5_000)),
    )
    yield Case(
        GyroscopeRest,
        "HIBf",
        (20, ENOUGH_US, 0, 0.0),
        (
            (0, BAD, 0, 4097, 0xFFFF),
            (0, OK, 1),
            (1, *LATE),
            (1, TIMEOUT, 0, 100_000),
            (2, BAD, 2, 255),
            (3, BAD, -0.5, nan, inf),
            (3, OK, 1e-3, 1e6),
        ),
    )
    for stream in board.identity.stream_calibrators:
        steps = ((0, FEW, 2, 0xFFFF), (0, OK, 1), (1, BAD, 0, 81, 255), (1, FEW, 4, 80), (1, OK, 1, 3))
        yield case_with_name(StreamReset, "B", (0,), stream, (0, BAD, 2, 255), (0, OK, 1))
        yield case_with_name(StreamFeed, "HB", (0, 2), stream, *steps)
        if stream == "direct-stream":
            yield case_with_name(StreamRemove, "HB", (0, 2), stream, *steps)
        else:
            yield case_with_name(StreamRemove, "HB", (0, 2), stream, answer=Status.NOT_SUPPORTED)
        yield case_with_name(StreamState, "", (), stream)
    yield Case(SetAccelerometer, "B12f", (slot, *UNIT), linear)
    yield Case(GetAccelerometer, "B", (slot,), ((0, *no_slot),))
    yield Case(
        AddPose,
        "HIB",
        (4, ENOUGH_US, 255),
        ((0, BAD, 0, 513, 0xFFFF), (0, OK, 1), (1, *LATE), (1, TIMEOUT, 0, 5_000), (2, BAD, 6, 254), (2, OK, 0, 5)),
    )
    yield Case(Poses, "BB", (0, 1), ((0, BAD, 2, 255), (0, OK, 1), (1, BAD, 21, 255), (1, OK, 0, 20)))
    means, spreads = (4, 5, 6, 10, 11, 12), (7, 8, 9, 13, 14, 15)
    yield Case(
        UploadPoses,
        "BBBH12f",
        (1, 1, *POSE),
        (
            (0, BAD, 0, 2, 255),
            (1, LENGTH, 0, 2, 20, 255),
            (2, BAD, 6, 254),
            (2, OK, 0, 5),
            (3, BAD, 0),
            (3, OK, 0xFFFF),
            *not_finite(*means),
            (spreads, BAD, -1.0, inf),
            (spreads, OK, nan, 0.0),
        ),
    )
    for method in ("six-position", "ellipsoid"):
        yield case_with_name(FitAccelerometer, "B", (1,), method, (0, FEW, 2, 255), (0, OK, 0))
    for source, wrong_flags in ((0, (4, 255)), (1, (2, 3, 4, 255))):  # flag 2, joint, is for pairs
        yield Case(
            FitDpi,
            "BHBBf",
            (source, 1, slot, 1, 60.0),
            (
                (0, BAD, 2, 255),
                (1, BAD, 0),
                (1, FEW, 4, 0xFFFF),
                (2, *no_slot),
                (3, BAD, *wrong_flags),
                (3, OK, 0),
                (4, BAD, -90.5, 90.5, nan, inf),
                (4, OK, -90.0, 90.0),
            ),
        )
    yield Case(
        IntegrateGyroscope,
        "HI",
        (40, ENOUGH_US),
        ((0, BAD, 0, 39, 12_001, 0xFFFF), (1, *LATE), (1, TIMEOUT, 0, 100_000)),
    )
    reals = [at + 15 * turn for turn in (0, 2) for at in (1, 2, 3, *range(9, 16))]
    yield Case(FitGyroscope, "B" + 3 * "3f3iHI7f", (3, *TURNS), ((0, LENGTH, 1, 2, 4, 8), *not_finite(*reals)))
    yield Case(SetGyroscope, "12f", UNIT, not_finite(*range(12)))
    yield Case(
        FusionStart,
        "BBHI",
        (slot, 1, 8, ENOUGH_US),
        (
            (0, *no_slot),
            (1, BAD, 0),
            (1, OK, 255),
            (2, BAD, 0, 513, 0xFFFF),
            (2, OK, 1),
            (3, *LATE),
            (3, TIMEOUT, 0, 20_000),
        ),
    )
    yield Case(FusionRun, "I", (100_000,), ((0, BAD, 0, 5 * LONGEST_US + 1, 0xFFFF_FFFF), (0, TIMEOUT, 1)))
    yield Case(FusionRead, "HB", (0, 36), ((0, BAD, 0xFFFF), (1, BAD, 37, 255), (1, OK, 0)))
    yield Case(
        LogGyroscope,
        "BBI",
        (40, 0, ENOUGH_US),
        ((0, BAD, 129, 255), (0, OK, 0, 128), (1, BAD, 2, 255), (1, OK, 1), (2, *LATE), (2, TIMEOUT, 0, 100_000)),
    )
    yield Case(
        TimeSequence,
        "BB",
        (0, 0),
        ((0, BAD, len(SEQUENCES), 255), (0, OK, len(SEQUENCES) - 1), (1, BAD, 5, 255), (1, OK, 1, 2, 3, 4)),
    )
    yield Case(TimeRange, "H", (3,), ((0, BAD, 0), (0, FEW, 4, 0xFFFF), (0, OK, 1)))


def answer(board: Board, code: int, payload: bytes) -> tuple[Status | None, bytes]:
    """Return status and data of the answer to a payload, sent up to three times; None if there is no answer."""
    frame = board.session.numbered(code, payload)
    for _ in range(3):
        reply = board.session.exchange_raw(frame, deadline_s=10.0)
        if reply is not None:
            return Status(reply.payload[0]), reply.payload[1:]
    return None, b""


def prepare(board: Board) -> None:
    """Store three points, one pose, and calibrations in the last slot and for the gyroscope."""
    slot = board.identity.slots - 1
    upload_points(board, POINTS)
    board.session.request(ClearPoses())
    answer(board, UploadPoses.code, struct.pack("<BBBH12f", 0, 1, *POSE))
    board.session.request(SetCalibration(slot, UNIT[:9], UNIT[9:]))
    board.session.request(SetAccelerometer(slot, UNIT[:9], UNIT[9:]))
    board.session.request(SetGyroscope(UNIT[:9], UNIT[9:]))
    for stream in board.identity.stream_calibrators:
        board.session.request(StreamReset(stream))


def stored_data(board: Board) -> dict[str, bytes]:
    """Return the data that the board stores, without the cycles in a stream's answer."""
    slot = board.identity.slots - 1
    requests: list[Request[Any]] = [
        Points(0, 80),
        Poses(0, 20),
        GetGyroscope(),
        GetCalibration(slot),
        GetAccelerometer(slot),
        *map(StreamState, board.identity.stream_calibrators),
    ]
    answers = {str(request): answer(board, request.code, request.payload())[1] for request in requests}
    return {name: data[:-8] if name.startswith("StreamState") else data for name, data in answers.items()}


def contradictions(board: Board, case: Case, before: dict[str, bytes]) -> Iterator[str]:
    """Yield answers that contradict the protocol, and data that a refused request has changed."""
    name, code, valid = case.request.command, case.request.code, case.payload()
    changed = [("a byte too many", valid + b"\0", LENGTH), *case.changed()]
    if valid:
        changed += [("a byte too few", valid[:-1], LENGTH), ("no bytes", b"", LENGTH)]
    for change, payload, status in changed:
        if status is not OK:
            answered, data = answer(board, code, payload)
            if answered is not status or data:
                yield f"{name} with {change} is answered {answered!r} and {len(data)} bytes, not {status!r}"
    after = stored_data(board)
    yield from (
        f"{name} was refused, and has changed {request}" for request in after if after[request] != before[request]
    )
    for change, payload, status in [("no change", valid, OK), *changed]:
        if status is OK:
            answered, _ = answer(board, code, payload)
            if answered is not case.answer:
                yield f"{name} with {change} is answered {answered!r}, not {case.answer!r}"
            if case.request in CHANGING:
                prepare(board)


def test_a_wrong_field_or_length_is_refused_by_its_status_and_changes_nothing(
    board: Board, turntable: Turntable
) -> None:
    turntable.rest()
    gyroscope, sensors = board.session.request(GetGyroscope()), board.session.request(Sensors())
    prepare(board)
    before = stored_data(board)
    faults = [contradiction for case in cases(board) for contradiction in contradictions(board, case, before)]
    assert board.session.request(Sensors()) == sensors
    board.session.request(SetGyroscope(gyroscope.matrix, gyroscope.bias))
    assert answer(board, Reset.code, b"\0")[0] is LENGTH
    assert not faults, "\n".join(faults)


def refused(board: Board, request: Request[Any]) -> Status | None:
    """Return the status of the answer to a valid request."""
    return answer(board, request.code, request.payload())[0]


def test_a_full_buffer_stores_none_of_what_does_not_fit(board: Board, turntable: Turntable) -> None:
    turntable.rest()
    room = board.identity.max_points
    upload_points(board, golden_points(room - 1))
    assert refused(board, Upload(room - 1, POINTS[:2])) is Status.BUFFER_FULL
    assert refused(board, Collect(2)) is Status.BUFFER_FULL
    assert board.session.request(Upload(room - 1, POINTS[:1])) == room, "a point that fits is not stored"
    assert refused(board, Collect(1)) is Status.BUFFER_FULL
    assert board.session.request(Points(room - 1, 80)).magnetometer.tolist() == POINTS[:1].tolist()
    board.session.request(ClearPoses())
    board.session.request(AddPose(1))
    (pose,) = board.session.request(Poses(0, 20))
    for first in range(1, POSE_CAPACITY - 7, 20):
        board.session.request(UploadPoses(first, [pose] * 20))
    assert refused(board, UploadPoses(POSE_CAPACITY - 7, [pose] * 8)) is Status.BUFFER_FULL
    assert board.session.request(UploadPoses(POSE_CAPACITY - 7, [pose] * 7)) == POSE_CAPACITY, (
        "poses that fit are not stored"
    )
    assert refused(board, AddPose(1)) is Status.BUFFER_FULL
    assert refused(board, UploadPoses(POSE_CAPACITY, [pose])) is Status.BUFFER_FULL
    board.session.request(ClearPoses())


def test_points_that_came_before_the_time_ran_out_are_kept(board: Board, turntable: Turntable) -> None:
    turntable.rest()
    board.session.request(ClearPoints())
    assert refused(board, Collect(512, timeout_us=300_000)) is TIMEOUT
    # Samples of 0.3 s at 80 to 200 Hz, with some margin.
    assert 10 <= len(board.session.request(Points(0, 80)).magnetometer) <= 60


def test_a_rest_that_was_not_found_still_is_no_bias(board: Board, turntable: Turntable) -> None:
    turntable.rest()
    before = board.session.request(GetGyroscope()).bias
    # Every gyroscope exceeds a noise of a thousandth of a count, so the first window counts as shaken.
    rest = board.session.request(GyroscopeRest(40, store=True, noise=1e-3))
    assert (rest.stillness.kind, rest.stillness.first) == (StillnessKind.SHAKEN, 0)
    assert np.array_equal(board.session.request(GetGyroscope()).bias, before), "a rest that was shaken is stored"


def test_a_stream_says_which_point_it_has_no_room_for(board: Board) -> None:
    stream = "direct-stream"
    if stream not in board.identity.stream_calibrators:
        pytest.skip(f"this firmware has no {stream}")
    far = [(0, 0, 0), (2047, -2047, 2047), (0, 2048, 0), (0, 0, 0)]
    upload_points(board, np.array(far, dtype=np.int16))
    board.session.request(StreamReset(stream))
    assert board.session.request(StreamRemove(stream, 0, 1)).status is StreamStatus.EMPTY
    fed = board.session.request(StreamFeed(stream, 0, 4))
    assert (fed.status, fed.taken) == (StreamStatus.OUT_OF_RANGE, 2)
    removed = board.session.request(StreamRemove(stream, 1, 3))
    assert (removed.status, removed.taken) == (StreamStatus.OUT_OF_RANGE, 1)
    upload_points(board, np.repeat(POINTS[:1], 80, axis=0))
    board.session.request(StreamReset(stream))
    replies = [board.session.request(StreamFeed(stream, 0, 80)) for _ in range(7)]
    assert [reply.taken for reply in replies] == [80] * 6 + [32], "a stream does not hold 512 points"
    assert replies[-1].status is StreamStatus.FULL
    assert board.session.request(StreamState(stream)).held == 512
    board.session.request(StreamReset(stream))


def test_fusion_needs_a_calibration_and_a_start(board: Board, turntable: Turntable) -> None:
    turntable.rest()
    slot = board.identity.slots - 1
    start = FusionStart(slot, 1, 8)
    prepare(board)
    board.session.request(start)
    board.session.request(ClearCalibration(slot))
    assert refused(board, FusionRun(100_000)) is Status.NO_CALIBRATION
    assert refused(board, start) is Status.NO_CALIBRATION
    prepare(board)
    assert refused(board, FusionRun(100_000)) is Status.NO_CALIBRATION, "a start that was refused has started"


def broken_frames() -> list[bytes]:
    """Return invalid frames as bytes of the line: wrong escapes, lengths or check values."""
    whole = encode_frame(Frame(ClearPoints.code, 0x55, b""))[1:-1]
    # A valid frame but for its first escape, whose second byte is wrong.
    escaped = encode_frame(Frame(ClearPoints.code, ESCAPE, b""))[1:-1].replace(b"\x7d\x5d", b"\x7d\x00", 1)
    longest = Frame(Upload.code, 0x55, bytes(MAX_PAYLOAD))
    too_long = encode_frame(longest)[1:-1] + bytes(8)
    broken = [
        escaped,
        whole + bytes([ESCAPE]),
        whole[:-1],
        whole[:7],
        whole[:1],
        whole + b"\0",
        whole[:2] + b"\1" + whole[3:],
        too_long,
    ]
    return [bytes([DELIMITER]) + body + bytes([DELIMITER]) for body in broken]


def test_a_frame_that_is_none_is_dropped_and_counted(board: Board) -> None:
    upload_points(board, POINTS)
    before = board.session.request(LinkStatistics())
    for wire in broken_frames():
        board.session.send_raw(wire)
        assert board.session.listen(0.3) is None, f"{wire[:20].hex(' ')} is answered"
    # A reply sent to the board is no request: it is neither counted as damaged nor answered.
    board.session.send_raw(encode_frame(Frame(ClearPoints.code | REPLY_BIT, 0x55, b"")))
    assert board.session.listen(0.3) is None, "a reply is answered"
    after = board.session.request(LinkStatistics())
    # The line may have damaged more frames.
    assert after.damaged - before.damaged >= len(broken_frames()), "a damaged frame is not counted"
    assert len(board.session.request(Points(0, 80)).magnetometer) == len(POINTS), "a damaged frame is executed"
