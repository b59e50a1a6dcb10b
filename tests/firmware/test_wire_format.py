"""The golden frames, through the firmware's codec (C, compiled for this machine) and the host's (Python)."""

from __future__ import annotations

import ctypes
import json
import subprocess
from collections.abc import Callable, Iterator, Sequence
from itertools import pairwise
from pathlib import Path
from typing import Any, Protocol

import pytest
from hypothesis import given
from hypothesis import strategies as st

from hiltest.link.framing import DamagedFrame, Frame, FrameDecoder, encode_frame

ROOT = Path(__file__).parents[2]
FIRMWARE = ROOT / "firmware_stub"
GOLDEN = json.loads((ROOT / "fixtures" / "frames" / "frames.json").read_text())
FRAMES = {entry["name"]: entry for entry in GOLDEN["frames"]}
BODY_MAXIMUM = 1032
PENDING, BODY, DAMAGED = range(3)


class Codec(Protocol):
    """Either end of the link."""

    def encode(self, frame: Frame) -> bytes: ...

    def decode(self, wire: bytes) -> tuple[list[Frame], int]: ...


class HostCodec:
    """The Python side."""

    def encode(self, frame: Frame) -> bytes:
        return encode_frame(frame)

    def decode(self, wire: bytes) -> tuple[list[Frame], int]:
        feed = FrameDecoder().feed(wire)
        frames = [packet for packet in feed if isinstance(packet, Frame)]
        return frames, sum(isinstance(packet, DamagedFrame) for packet in feed)


class _Unstuffer(ctypes.Structure):
    _fields_ = [
        ("body", ctypes.c_uint8 * BODY_MAXIMUM),
        ("length", ctypes.c_size_t),
        ("escaped", ctypes.c_bool),
        ("damaged", ctypes.c_bool),
        ("complete", ctypes.c_bool),
    ]


class _Message(ctypes.Structure):
    _fields_ = [
        ("type", ctypes.c_uint8),
        ("sequence", ctypes.c_uint8),
        ("payload", ctypes.POINTER(ctypes.c_uint8)),
        ("payload_length", ctypes.c_uint16),
        ("crc", ctypes.c_uint32),
    ]


class FirmwareCodec:
    """The C side, as a shared library of this machine."""

    def __init__(self, library: ctypes.CDLL) -> None:
        self.library = library
        library.message_finish.restype = library.stuff.restype = ctypes.c_size_t
        library.message_parse.restype = ctypes.c_bool
        library.crc32.restype = ctypes.c_uint32

    def encode(self, frame: Frame) -> bytes:
        body = (ctypes.c_uint8 * BODY_MAXIMUM)(0, 0, 0, 0, *frame.payload)
        wire = (ctypes.c_uint8 * (2 * BODY_MAXIMUM + 2))()
        length = self.library.message_finish(body, frame.type, frame.sequence, len(frame.payload))
        return bytes(wire[: self.library.stuff(body, ctypes.c_size_t(length), wire)])

    def decode(self, wire: bytes, cuts: Sequence[int] = ()) -> tuple[list[Frame], int]:
        """Find frames in bytes that come in pieces: cut at these places."""
        state, frames, damaged = _Unstuffer(), [], 0
        for start, end in pairwise([0, *sorted(cuts), len(wire)]):
            for result in self._unstuff(state, wire[start:end]):
                message = _Message()
                if result == BODY and self.library.message_parse(
                    state.body, ctypes.c_size_t(state.length), ctypes.byref(message)
                ):
                    payload = bytes(message.payload[: message.payload_length])
                    frames.append(Frame(message.type, message.sequence, payload))
                elif result != PENDING:
                    damaged += 1
        return frames, damaged

    def _unstuff(self, state: _Unstuffer, piece: bytes) -> Iterator[int]:
        """Give a piece, what is left of it after each end of a body; the state is that end's while it is yielded."""
        selected = ctypes.c_size_t()
        while piece:
            yield self.library.unstuff(ctypes.byref(state), piece, ctypes.c_size_t(len(piece)), ctypes.byref(selected))
            assert 0 < selected.value <= len(piece)
            piece = piece[selected.value :]


@pytest.fixture(scope="module")
def firmware_codec(tmp_path_factory: pytest.TempPathFactory, require_tool: Callable[[str], str]) -> FirmwareCodec:
    library = tmp_path_factory.mktemp("protocol") / "protocol.so"
    sources = [FIRMWARE / "protocol" / name for name in ("crc32.c", "message.c", "payload.c", "stuffing.c")]
    flags = [
        "-std=c11",
        "-Wall",
        "-Wextra",
        "-Wconversion",
        "-Werror",
        "-shared",
        "-fPIC",
        "-fsanitize=undefined",
        "-fsanitize-undefined-trap-on-error",
        f"-I{FIRMWARE}",
    ]
    subprocess.run([require_tool("gcc"), *flags, "-o", library, *sources], check=True)
    return FirmwareCodec(ctypes.CDLL(str(library)))


@pytest.fixture(params=["firmware", "host"])
def codec(request: pytest.FixtureRequest) -> Codec:
    return request.getfixturevalue("firmware_codec") if request.param == "firmware" else HostCodec()


def as_frame(entry: dict[str, Any]) -> Frame:
    return Frame(entry["type"], entry["sequence"], bytes.fromhex(entry["payload"]))


@pytest.mark.parametrize("name", FRAMES)
def test_a_golden_frame_is_written_byte_for_byte(codec: Codec, name: str) -> None:
    assert codec.encode(as_frame(FRAMES[name])).hex() == FRAMES[name]["wire"]


@pytest.mark.parametrize("name", FRAMES)
def test_a_golden_frame_is_read(codec: Codec, name: str) -> None:
    assert codec.decode(bytes.fromhex(FRAMES[name]["wire"])) == ([as_frame(FRAMES[name])], 0)


@pytest.mark.parametrize("stream", GOLDEN["streams"], ids=lambda stream: stream["name"])
def test_frames_are_found_in_a_stream_and_damage_is_counted(codec: Codec, stream: dict[str, Any]) -> None:
    expected = [as_frame(FRAMES[name]) for name in stream["frames"]]
    assert codec.decode(bytes.fromhex(stream["wire"])) == (expected, stream["damaged"])


@pytest.mark.parametrize("name", FRAMES)
def test_no_golden_frame_survives_a_flipped_bit(codec: Codec, name: str) -> None:
    wire = bytes.fromhex(FRAMES[name]["wire"])
    for bit in range(8 * len(wire)) if len(wire) < 500 else range(0, 8 * len(wire), 61):
        flipped = bytearray(wire)
        flipped[bit // 8] ^= 1 << bit % 8
        frames, _ = codec.decode(bytes(flipped))
        assert frames == [], f"bit {bit}"


@given(noise=st.binary(max_size=200))
def test_both_ends_agree_on_arbitrary_bytes(firmware_codec: FirmwareCodec, noise: bytes) -> None:
    framed = b"\x7e" + noise + b"\x7e"
    assert firmware_codec.decode(framed) == HostCodec().decode(framed)


# What a line can bring: frames full of delimiters and escapes, parts of frames, noise, more than fits a body.
SPECIAL = st.sampled_from([0x00, 0x5D, 0x5E, 0x7D, 0x7E, 0xFF])
LONGEST = st.integers(1000, 1024).map(lambda size: (b"\x7d\x01" * 512)[:size])
PAYLOADS = st.lists(SPECIAL, max_size=40).map(bytes) | LONGEST
WHOLE = st.builds(Frame, st.integers(0, 0x7F), st.integers(0, 255), PAYLOADS).map(encode_frame)
PARTS = st.tuples(WHOLE, st.floats(0, 1)).map(lambda part: part[0][int(part[1] * len(part[0])) :])
NOISE = st.lists(SPECIAL, max_size=20).map(bytes) | st.integers(1030, 1036).map(lambda size: b"\x7e" + b"U" * size)
STREAMS = st.lists(WHOLE | PARTS | NOISE, max_size=6).map(b"".join)


@given(stream=STREAMS, places=st.lists(st.floats(0, 1), max_size=12))
def test_frames_are_found_wherever_the_stream_is_cut(
    firmware_codec: FirmwareCodec, stream: bytes, places: list[float]
) -> None:
    closed = stream + b"\x7e"
    cuts = [int(place * len(closed)) for place in places]
    assert firmware_codec.decode(closed, cuts) == HostCodec().decode(closed)
