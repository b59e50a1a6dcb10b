"""Frames survive the line whole, or not at all."""

from __future__ import annotations

import pytest
from hypothesis import given
from hypothesis import strategies as st

from hiltest.errors import FrameError
from hiltest.link.framing import (
    MAX_PAYLOAD,
    DamagedFrame,
    Frame,
    FrameDecoder,
    decode_body,
    encode_frame,
    stuff,
    unstuff,
)

# The bytes that matter to stuffing come up often, so that short payloads meet them.
_AWKWARD = st.lists(st.sampled_from([0x7D, 0x7E, 0x5D, 0x5E, 0x00, 0xFF, 0x20]), max_size=80).map(bytes)
_PAYLOADS = st.one_of(st.binary(max_size=MAX_PAYLOAD), _AWKWARD)


def decode_all(wire: bytes) -> list[Frame | DamagedFrame]:
    return FrameDecoder().feed(wire)


@given(body=_PAYLOADS)
def test_stuffed_bodies_hold_no_delimiter_and_come_back(body: bytes) -> None:
    wire = stuff(body)
    assert b"\x7e" not in wire
    assert unstuff(wire) == body


@given(type_=st.integers(0, 255), sequence=st.integers(0, 255), payload=_PAYLOADS)
def test_any_frame_round_trips(type_: int, sequence: int, payload: bytes) -> None:
    assert decode_all(encode_frame(Frame(type_, sequence, payload))) == [Frame(type_, sequence, payload)]


@given(garbage=st.lists(st.binary(max_size=60), min_size=4, max_size=4), payload=_PAYLOADS)
def test_frames_between_random_garbage_are_found(garbage: list[bytes], payload: bytes) -> None:
    frames = [Frame(0x80 + index, index, payload) for index in range(3)]
    wire = garbage[0] + b"".join(encode_frame(frame) + noise for frame, noise in zip(frames, garbage[1:], strict=True))
    results = [item for item in decode_all(wire) if isinstance(item, Frame)]
    assert results == frames


def test_empty_frames_are_ignored() -> None:
    frame = Frame(1, 2, b"abc")
    assert decode_all(b"\x7e" * 9 + encode_frame(frame) + b"\x7e" * 9) == [frame]


def test_endless_noise_is_bounded_and_named() -> None:
    decoder = FrameDecoder()
    for _ in range(100):
        assert decoder.feed(b"U" * 1000) == []
    (damage,) = decoder.feed(b"\x7e")
    assert isinstance(damage, DamagedFrame)
    assert "without a delimiter" in damage.reason
    assert len(damage.data) <= 2 * (MAX_PAYLOAD + 8)
    assert decoder.feed(encode_frame(Frame(1, 1, b""))) == [Frame(1, 1, b"")]


@pytest.mark.parametrize(
    ("data", "reason"),
    [
        (b"\x01\x7d", "ends in an escape at byte 1"),
        (b"\x01\x7d\x00", "escape followed by 0x00 at byte 2"),
        (b"\x01\x02\x7e", "delimiter inside a frame at byte 2"),
        (b"\x01\x02", "2 bytes between delimiters; a frame has at least 8"),
        (b"\x01\x02\x05\x00" + bytes(4), "length field says 5, frame carries 0"),
        (b"\x01\x02\x00\x00" + bytes(4), "check value 0x00000000, bytes give 0x"),
    ],
)
def test_damage_says_what_and_where(data: bytes, reason: str) -> None:
    with pytest.raises(FrameError, match=reason):
        decode_body(data)


def test_a_payload_too_long_for_a_frame_is_refused() -> None:
    with pytest.raises(ValueError, match="1025 bytes; at most 1024"):
        encode_frame(Frame(1, 1, bytes(1025)))
