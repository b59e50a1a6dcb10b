"""A session tells a slow board, a broken line and a wrong answer apart."""

from __future__ import annotations

import struct
import time
from collections.abc import Callable

import pytest

from hiltest.errors import (
    BoardResetError,
    DeviceError,
    DeviceTimeoutError,
    LinkLostError,
    ProtocolError,
    SequenceError,
    SyncError,
    VersionMismatchError,
)
from hiltest.link.framing import Frame, encode_frame
from hiltest.link.messages import PROTOCOL_VERSION, ClearPoints, LinkStatistics
from hiltest.link.replies import LinkCounters, Status
from hiltest.link.session import RequestOutcome, Session
from hiltest.link.transcript import Direction

SYNC = 0x01
COUNTERS = struct.pack("<B4I", 0, 1, 2, 3, 4)

Script = Callable[[Frame, int], bytes | None]
OpenSession = Callable[..., Session]


def reply(frame: Frame, payload: bytes) -> bytes:
    return encode_frame(Frame(frame.type | 0x80, frame.sequence, payload))


def echo(frame: Frame, *, version: int = PROTOCOL_VERSION) -> bytes:
    return reply(frame, b"\x00" + frame.payload + struct.pack("<H", version))


@pytest.fixture
def synchronised(session_with: OpenSession) -> OpenSession:
    """Return a function that opens a session whose far end answers SYNC well, and the rest by the script."""

    def open_synchronised(script: Script, *, deadline_s: float = 0.3) -> Session:
        session = session_with(
            lambda frame, count: echo(frame) if frame.type == SYNC else script(frame, count), deadline_s=deadline_s
        )
        session.synchronise()
        return session

    return open_synchronised


def test_a_reply_comes_back_parsed_and_the_attempt_is_recorded(synchronised: OpenSession) -> None:
    session = synchronised(lambda frame, _: reply(frame, COUNTERS))
    assert session.request(LinkStatistics()) == LinkCounters(1, 2, 3, 4)
    last = session.attempts[-1]
    assert (last.command, last.number, last.outcome) == ("LINK_STATISTICS", 1, RequestOutcome.ANSWERED)
    assert last.ended_s >= last.sent_s
    assert session.retried == 0


def test_a_board_that_has_carried_out_less_than_it_answered_was_reset(synchronised: OpenSession) -> None:
    # Each count is of all requests, SYNC and the look itself among them, and of what was sent again.
    counts = iter([(3, 0), (7, 2), (9, 1), (5, 1)])

    def script(frame: Frame, _: int) -> bytes:
        frames, repeated = next(counts) if frame.type == LinkStatistics.code else (0, 0)
        return reply(frame, struct.pack("<B4I", 0, frames, 0, 0, repeated) if frames else b"\x00")

    session = synchronised(script)
    session.request(ClearPoints())
    session.refuse_reset()  # 3 of 3
    session.request(ClearPoints())
    session.refuse_reset()  # 5 of 5
    session.request(ClearPoints())
    session.refuse_reset()  # 8 of 7: one more, of a host that was there before
    session.request(ClearPoints())
    with pytest.raises(BoardResetError, match="at least 10 requests") as raised:
        session.refuse_reset()
    assert (raised.value.carried_out, raised.value.answered) == (4, 10)


def test_synchronising_skips_noise_and_old_answers(session_with: OpenSession) -> None:
    old = encode_frame(Frame(0x81, 0, b"\x00\x11\x22\x33\x44\x01\x00"))
    session = session_with(lambda frame, _: b"boot banner\r\n" + old + echo(frame), greeting=b"\x7e\x01\x02")
    session.synchronise()
    assert session.protocol_version == PROTOCOL_VERSION


def test_silence_is_a_sync_error(session_with: OpenSession) -> None:
    with pytest.raises(SyncError, match="no other byte"):
        session_with(lambda *_: b"", deadline_s=0.1).synchronise()


def test_a_sync_error_shows_what_was_heard_instead(session_with: OpenSession) -> None:
    with pytest.raises(SyncError) as caught:
        session_with(lambda *_: b"\x00\xfflogin: ", deadline_s=0.1).synchronise()
    assert caught.value.heard == b"\x00\xfflogin: " * 3


def test_firmware_that_prints_text_is_another_firmware(session_with: OpenSession) -> None:
    with pytest.raises(VersionMismatchError, match=r"but it sends text: 'HDG=12\.3 deg'\. .*hiltest start"):
        session_with(lambda *_: b"HDG=12.3 deg\n", deadline_s=0.1).synchronise()


def test_another_protocol_version_is_named(session_with: OpenSession) -> None:
    with pytest.raises(VersionMismatchError, match=f"version 250, hiltest {PROTOCOL_VERSION}"):
        session_with(lambda frame, _: echo(frame, version=250)).synchronise()


def test_another_firmware_is_named(synchronised: OpenSession) -> None:
    def identity(frame: Frame, _: int) -> bytes:
        texts = b"".join(bytes([len(text)]) + text for text in (b"blinky", b"2.0", b"abcd", b"gcc", b"flash"))
        return reply(frame, struct.pack("<BHIBHB4I", 0, 2, 1, 0, 1, 1, 1, 2, 3, 4) + texts + bytes(2))

    with pytest.raises(VersionMismatchError, match=r"firmware 'blinky' \(2.0"):
        synchronised(identity).identify()


def test_a_retry_carries_the_same_sequence_number(synchronised: OpenSession) -> None:
    observations: list[Frame] = []

    def second_time(frame: Frame, _: int) -> bytes:
        observations.append(frame)
        return reply(frame, COUNTERS) if len(observations) == 2 else b""

    session = synchronised(second_time, deadline_s=0.15)
    session.request(LinkStatistics())
    assert observations[0] == observations[1]
    assert [attempt.outcome for attempt in session.attempts[1:]] == [RequestOutcome.TIMEOUT, RequestOutcome.ANSWERED]
    assert session.retried == 1


def test_no_answer_is_a_timeout_after_bounded_attempts(synchronised: OpenSession) -> None:
    session = synchronised(lambda *_: b"", deadline_s=0.15)
    began = time.monotonic()
    with pytest.raises(DeviceTimeoutError, match=r"no answer to LINK_STATISTICS within 0.15 s \(wall time\)"):
        session.request(LinkStatistics())
    assert time.monotonic() - began >= 0.45  # three deadlines
    assert [attempt.number for attempt in session.attempts[1:]] == [1, 2, 3]


def test_a_broken_line_is_lost_not_late(synchronised: OpenSession) -> None:
    session = synchronised(lambda *_: None)
    with pytest.raises(LinkLostError) as caught:
        session.request(LinkStatistics())
    assert not isinstance(caught.value, TimeoutError)
    assert session.attempts[-1].outcome is RequestOutcome.ERROR


def test_damaged_frames_are_counted_and_a_good_one_behind_is_taken(synchronised: OpenSession) -> None:
    session = synchronised(lambda frame, _: b"\x7e\x91\x01junk\x7e" + reply(frame, COUNTERS))
    assert session.request(LinkStatistics()).frames == 1
    assert session.attempts[-1].damaged == 1


def test_a_late_answer_to_an_earlier_request_is_dropped(synchronised: OpenSession) -> None:
    def late(frame: Frame, _: int) -> bytes:
        return encode_frame(Frame(0x90, (frame.sequence - 1) % 256, bytes(17))) + reply(frame, COUNTERS)

    session = synchronised(late)
    assert session.request(LinkStatistics()).damaged == 2
    assert session.attempts[-1].stale == 1


def test_an_answer_is_late_for_sixteen_requests_and_wrong_beyond(synchronised: OpenSession) -> None:
    """A number that is further back is of nobody who was asked."""

    def old(requests: int) -> Session:
        def answers(frame: Frame, _: int) -> bytes:
            return encode_frame(Frame(0x90, (frame.sequence - requests) % 256, COUNTERS)) + reply(frame, COUNTERS)

        return synchronised(answers)

    late = old(16)
    late.request(LinkStatistics())
    assert late.attempts[-1].stale == 1
    with pytest.raises(SequenceError, match=f"sequence number {(1 - 17) % 256}"):
        old(17).request(LinkStatistics())


@pytest.mark.parametrize(
    ("answer", "error", "message"),
    [
        (lambda f: encode_frame(Frame(0x90, (f.sequence + 5) % 256, COUNTERS)), SequenceError, "sequence number 6"),
        (lambda f: encode_frame(Frame(0x85, f.sequence, COUNTERS)), ProtocolError, "answered by a frame of type 0x85"),
        (lambda f: reply(f, COUNTERS[:-1]), ProtocolError, "repeated at byte 13 of 16"),
        (lambda f: reply(f, bytes([Status.BUSY])), DeviceError, "LINK_STATISTICS with BUSY"),
    ],
)
def test_a_wrong_answer_is_named(
    answer: Callable[[Frame], bytes], error: type[Exception], message: str, synchronised: OpenSession
) -> None:
    session = synchronised(lambda frame, _: answer(frame))
    with pytest.raises(error, match=message):
        session.request(LinkStatistics())


def test_sequence_numbers_wrap(synchronised: OpenSession) -> None:
    session = synchronised(lambda frame, _: reply(frame, b"\x00"))
    for _ in range(300):
        session.request(ClearPoints())
    assert session.attempts[-1].sequence == 300 % 256


def test_both_directions_are_in_the_transcript(synchronised: OpenSession) -> None:
    session = synchronised(lambda frame, _: reply(frame, COUNTERS))
    session.request(LinkStatistics())
    assert session.transcript is not None
    sent = b"".join(e.data for e in session.transcript.entries if e.direction is Direction.TO_BOARD)
    heard = b"".join(e.data for e in session.transcript.entries if e.direction is Direction.TO_HOST)
    assert sent.endswith(encode_frame(Frame(0x10, 1, b"")))
    assert heard.endswith(encode_frame(Frame(0x90, 1, COUNTERS)))
