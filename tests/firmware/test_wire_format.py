"""The golden frames, through the firmware's codec (C, compiled for this machine) and the host's (Python)."""

from __future__ import annotations

import ctypes
import json
import subprocess
from collections.abc import Callable
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
        found = FrameDecoder().feed(wire)
        frames = [item for item in found if isinstance(item, Frame)]
        return frames, sum(isinstance(item, DamagedFrame) for item in found)


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

    def decode(self, wire: bytes) -> tuple[list[Frame], int]:
        state, frames, damaged = _Unstuffer(), [], 0
        for byte in wire:
            result = self.library.unstuff(ctypes.byref(state), byte)
            message = _Message()
            if result == BODY and self.library.message_parse(
                state.body, ctypes.c_size_t(state.length), ctypes.byref(message)
            ):
                payload = bytes(message.payload[: message.payload_length])
                frames.append(Frame(message.type, message.sequence, payload))
            elif result != PENDING:
                damaged += 1
        return frames, damaged


@pytest.fixture(scope="module")
def firmware_codec(tmp_path_factory: pytest.TempPathFactory, require_tool: Callable[[str], str]) -> FirmwareCodec:
    library = tmp_path_factory.mktemp("protocol") / "protocol.so"
    sources = [FIRMWARE / "protocol" / name for name in ("crc32.c", "message.c", "payload.c", "stuffing.c")]
    flags = ["-std=c11", "-Wall", "-Wextra", "-Wconversion", "-Werror", "-shared", "-fPIC", "-fsanitize=undefined",
             "-fsanitize-undefined-trap-on-error", f"-I{FIRMWARE}"]  # fmt: skip
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


def test_the_crc_is_the_one_of_zlib(firmware_codec: FirmwareCodec) -> None:
    assert firmware_codec.library.crc32(b"123456789", ctypes.c_size_t(9)) == 0xCBF43926


def test_every_payload_length_comes_back(firmware_codec: FirmwareCodec) -> None:
    for length in range(1025):
        frame = Frame(length % 0x80, length & 0xFF, bytes((0x7D + length * k) & 0xFF for k in range(length)))
        assert firmware_codec.decode(firmware_codec.encode(frame)) == ([frame], 0)


@given(noise=st.binary(max_size=200))
def test_both_ends_agree_on_arbitrary_bytes(firmware_codec: FirmwareCodec, noise: bytes) -> None:
    framed = b"\x7e" + noise + b"\x7e"
    assert firmware_codec.decode(framed) == HostCodec().decode(framed)
