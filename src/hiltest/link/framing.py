"""Frames on the serial line: byte stuffing, length, type, sequence number and CRC-32.

On the wire a frame is ``7E body 7E``; inside the body 7E travels as ``7D 5E`` and 7D as ``7D 5D``. The body is ``u8
type, u8 sequence, u16 length, payload, u32 crc``, little-endian, and the CRC (IEEE 802.3, as in `zlib.crc32`) covers
everything before it. Two consecutive delimiters are an empty frame, which is ignored, so a sender may start with one to
terminate preceding noise.
"""

from __future__ import annotations

import struct
import zlib
from dataclasses import dataclass

from hiltest.errors import FrameError

DELIMITER = 0x7E
ESCAPE = 0x7D
MAX_PAYLOAD = 1024
_ESCAPED_DELIMITER, _ESCAPED_ESCAPE = b"\x7d\x5e", b"\x7d\x5d"
_HEADER = struct.Struct("<BBH")
_CHECK = struct.Struct("<I")
_OVERHEAD = _HEADER.size + _CHECK.size
# Length of the largest body with every byte stuffed: a longer run without a delimiter is noise.
_MAX_STUFFED = 2 * (MAX_PAYLOAD + _OVERHEAD)


@dataclass(frozen=True, slots=True)
class Frame:
    """One intact frame."""

    type: int
    sequence: int
    payload: bytes


@dataclass(frozen=True, slots=True)
class DamagedFrame:
    """Bytes between two delimiters that are not a frame."""

    reason: str
    """Reason why they are not a frame."""
    data: bytes
    """Bytes as received, without delimiters."""


def stuff(body: bytes) -> bytes:
    """Escape delimiters and escapes in a body.

    Examples
    --------
    >>> stuff(bytes([1, 0x7E, 0x7D])).hex()
    '017d5e7d5d'
    """
    return body.replace(b"\x7d", _ESCAPED_ESCAPE).replace(b"\x7e", _ESCAPED_DELIMITER)


def unstuff(data: bytes) -> bytes:
    """Undo `stuff`.

    Raises
    ------
    FrameError
        When an escape is not followed by 5D or 5E, or the data contains a delimiter.
    """
    escapes = data.count(_ESCAPED_DELIMITER) + data.count(_ESCAPED_ESCAPE)
    if data.count(ESCAPE) != escapes or DELIMITER in data:
        raise FrameError(_why_no_body(data))
    return data.replace(_ESCAPED_DELIMITER, b"\x7e").replace(_ESCAPED_ESCAPE, b"\x7d")


def _why_no_body(data: bytes) -> str:
    for position in range(len(data)):
        if data[position] == DELIMITER:
            return f"delimiter inside a frame at byte {position}"
        if data[position] == ESCAPE:
            if position + 1 == len(data):
                return f"frame ends in an escape at byte {position}"
            if data[position + 1] not in (0x5E, 0x5D):
                return f"escape followed by 0x{data[position + 1]:02x} at byte {position + 1}"
    raise AssertionError("the escapes are right")


def encode_frame(frame: Frame) -> bytes:
    """Return the bytes of a frame on the wire, with both delimiters.

    Raises
    ------
    ValueError
        When the payload is longer than `MAX_PAYLOAD`.
    """
    if len(frame.payload) > MAX_PAYLOAD:
        raise ValueError(f"payload of {len(frame.payload)} bytes; at most {MAX_PAYLOAD} fit a frame")
    checked = _HEADER.pack(frame.type, frame.sequence, len(frame.payload)) + frame.payload
    body = checked + _CHECK.pack(zlib.crc32(checked))
    return b"\x7e" + stuff(body) + b"\x7e"


def decode_body(data: bytes) -> Frame:
    """Return the frame in the bytes between two delimiters.

    Raises
    ------
    FrameError
        When escape sequences, length or check value do not fit.
    """
    body = unstuff(data)
    if len(body) < _OVERHEAD:
        raise FrameError(f"{len(body)} bytes between delimiters; a frame has at least {_OVERHEAD}")
    kind, sequence, length = _HEADER.unpack_from(body)
    if length != len(body) - _OVERHEAD:
        raise FrameError(f"length field says {length}, frame carries {len(body) - _OVERHEAD} payload bytes")
    if length > MAX_PAYLOAD:
        raise FrameError(f"payload of {length} bytes; at most {MAX_PAYLOAD} are allowed")
    (sent_crc,) = _CHECK.unpack_from(body, len(body) - _CHECK.size)
    computed_crc = zlib.crc32(body[: -_CHECK.size])
    if sent_crc != computed_crc:
        raise FrameError(f"check value 0x{sent_crc:08x}, bytes give 0x{computed_crc:08x}")
    return Frame(kind, sequence, body[_HEADER.size : -_CHECK.size])


class FrameDecoder:
    """Decoder of frames in a stream of bytes, with any segmentation.

    Damage never stops it: invalid bytes become a `DamagedFrame`, and the next delimiter resynchronises.
    """

    def __init__(self) -> None:
        self._pending = bytearray()
        self._too_long = False

    def feed(self, data: bytes) -> list[Frame | DamagedFrame]:
        """Decode more bytes and return the items that they complete, in order."""
        items: list[Frame | DamagedFrame] = []
        *complete, rest = data.split(bytes([DELIMITER]))
        for piece in complete:
            self._keep(piece)
            if self._pending:
                items.append(self._finish())
        self._keep(rest)
        return items

    @property
    def unfinished(self) -> bytes:
        """Bytes since the last delimiter."""
        return bytes(self._pending)

    def reset(self) -> None:
        """Discard an unfinished frame."""
        self._pending.clear()
        self._too_long = False

    def _keep(self, piece: bytes) -> None:
        room = _MAX_STUFFED - len(self._pending)
        self._too_long |= len(piece) > room
        self._pending += piece[:room]

    def _finish(self) -> Frame | DamagedFrame:
        data, too_long = bytes(self._pending), self._too_long
        self.reset()
        if too_long:
            return DamagedFrame(f"more than {_MAX_STUFFED} bytes without a delimiter", data)
        try:
            return decode_body(data)
        except FrameError as error:
            return DamagedFrame(str(error), data)
