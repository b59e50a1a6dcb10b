"""A transcript for people: every request and reply decoded, damage shown as damage, and bounded in size."""

from __future__ import annotations

import struct
from typing import Any

import pytest
from tests.link.requests import REQUESTS

from hiltest.link import messages as m
from hiltest.link.framing import Frame, encode_frame
from hiltest.link.replies import Status
from hiltest.link.request import REPLY_BIT, Request
from hiltest.link.request_reading import read_request
from hiltest.link.trace_text import trace_lines
from hiltest.link.transcript import Direction, LatestTranscript, Transcript


def kinds_under(kind: type) -> set[type]:
    below = {kind} if "code" in vars(kind) else set()
    return below.union(*(kinds_under(subclass) for subclass in kind.__subclasses__()))


@pytest.mark.parametrize("request_", REQUESTS, ids=lambda request: type(request).__name__)
def test_a_request_is_read_back_from_its_bytes(request_: Request[Any]) -> None:
    read = read_request(Frame(request_.code, 1, request_.payload()))
    assert type(read) is type(request_)
    assert read.payload() == request_.payload()


def test_every_request_there_is_can_be_read_back() -> None:
    assert {type(request) for request in REQUESTS} == kinds_under(Request)


def lines(*entries: tuple[float, Direction, bytes]) -> list[str]:
    transcript = Transcript("virtual")
    for entry in entries:
        transcript.add(*entry)
    return list(trace_lines(transcript))


def asked(request: Request[Any], sequence: int) -> bytes:
    return encode_frame(Frame(request.code, sequence, request.payload()))


def answered(request: Request[Any], sequence: int, payload: bytes) -> bytes:
    return encode_frame(Frame(request.code | REPLY_BIT, sequence, payload))


def test_a_frame_is_shown_with_the_time_of_its_last_byte_its_number_and_its_fields() -> None:
    upload = m.Upload(7, [[1, -2, 3]] * 20)
    reply = answered(upload, 5, struct.pack("<BH", 0, 27))
    assert lines(
        (1.25, Direction.TO_BOARD, asked(upload, 5)),
        (1.5, Direction.TO_HOST, reply[:6]),
        (1.75, Direction.TO_HOST, reply[6:]),
    ) == [
        "      1.250000  >    5  UPLOAD first=7 points=[1, -2, 3, 1, -2, 3, 1, -2, 3, 1, -2, 3, ... 20 x 3 in all]",
        "      1.750000  <    5  UPLOAD OK 27",
    ]


def test_a_reply_is_decoded_by_the_request_it_answers_and_an_error_by_its_name() -> None:
    read = m.Read(2, 1)
    payload = struct.pack("<BBQ3hHb", 0, 1, 5000, 10, -20, 30, 2, 25)
    refused = m.Calibrate(9, "direct")
    shown = lines(
        (0.0, Direction.TO_BOARD, asked(read, 1)),
        (0.0, Direction.TO_BOARD, asked(refused, 2)),
        (0.0, Direction.TO_HOST, answered(refused, 2, bytes([Status.TOO_FEW_POINTS]))),
        (0.0, Direction.TO_HOST, answered(read, 1, payload)),
        (0.0, Direction.TO_HOST, answered(m.ClearPoints(), 3, b"\0")),
    )
    assert [line[14:] for line in shown[2:]] == [
        "  <    2  CALIBRATE TOO_FEW_POINTS",
        "  <    1  READ OK time_us=[5000] counts=[10, -20, 30] overruns=2 die_temperature_degc=25",
        "  <    3  CLEAR_POINTS does not answer a request of this trace; 1 bytes 00",
    ]


def test_damage_is_shown_as_damage_and_what_follows_is_read() -> None:
    damaged = bytearray(asked(m.Select(3), 1))
    damaged[3] ^= 0x20
    shown = lines(
        (0.0, Direction.TO_BOARD, bytes(damaged)),
        (0.0, Direction.TO_BOARD, asked(m.Select(3), 2)),
        (0.0, Direction.TO_BOARD, encode_frame(Frame(0x04, 3, b"12"))),
        (0.0, Direction.TO_BOARD, encode_frame(Frame(0x77, 4, b"x"))),
        (0.0, Direction.MARK, b"the table turns"),
        (0.0, Direction.TO_HOST, b"\x7e\x01\x02"),
    )
    assert [line[16:] for line in shown] == [
        f">       damaged: length field says 33, frame carries 1 payload bytes; 9 bytes {damaged[1:-1].hex(' ')}",
        ">    2  SELECT sensor_id=3",
        ">    3  SELECT not understood: request SELECT: end at byte 1 of 2: 1 bytes too many; 2 bytes 31 32",
        ">    4  type 0x77 not understood: no request has type 0x77; 1 bytes 78",
        "#       the table turns",
        "<       unfinished: 2 bytes 01 02",
    ]


def test_only_the_latest_bytes_are_kept_and_what_is_lost_is_counted() -> None:
    transcript = LatestTranscript(most_bytes=1000)
    for number in range(100):
        transcript.add(number, Direction.TO_HOST, bytes(42))
    assert [entry.time_s for entry in transcript.entries] == list(range(80, 100)), "20 entries of 42 + 8 bytes"
    assert transcript.dropped_bytes == 80 * 42
    transcript.restart()
    assert (list(transcript.entries), transcript.dropped_bytes) == ([], 0)
    transcript.add(0.0, Direction.TO_HOST, bytes(5000))
    assert len(transcript.entries) == 1, "the latest entry is there, however long"
    for number in range(100_000):
        transcript.add(number, Direction.TO_HOST, b"")
    assert len(transcript.entries) <= 125
