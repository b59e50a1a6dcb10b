"""Packets of the GDB remote serial protocol: framing, check and escapes."""

from __future__ import annotations

from collections.abc import Iterator

LONGEST = 1 << 14
"""Longest accepted packet [byte], which is reported to GDB."""

INTERRUPT = b"\x03"
ACKNOWLEDGED, AGAIN = b"+", b"-"
_ESCAPE = 0x7D
_RUN = 0x2A
_NO_RUN = 29  # a count is written as a printable character, with this offset
_RESERVED = b"#$}*"


def packet(data: bytes) -> bytes:
    """Frame a command or an answer."""
    escaped = b"".join(bytes((_ESCAPE, byte ^ 0x20)) if byte in _RESERVED else bytes((byte,)) for byte in data)
    return b"$%s#%02x" % (escaped, sum(escaped) & 0xFF)


class PacketReader:
    """Decoder of packets in a stream of bytes with any other content.

    Parameters
    ----------
    runs
        True if run-length encoding is allowed, as in a server's answers.
    """

    def __init__(self, *, runs: bool = False) -> None:
        self._pending = bytearray()
        self._runs = runs

    def feed(self, data: bytes) -> Iterator[bytes | None]:
        """Yield the content of every complete packet, `INTERRUPT`, `AGAIN`, or None for a damaged packet."""
        self._pending += data
        while self._pending:
            first = bytes(self._pending[:1])
            if first != b"$":
                del self._pending[:1]
                if first in (INTERRUPT, AGAIN):
                    yield first
                continue
            end = self._pending.find(b"#")
            if end < 0 or end + 3 > len(self._pending):
                if len(self._pending) <= LONGEST + 4:
                    return  # the rest is still to arrive
                end = len(self._pending)  # a packet that starts like this is too long, so it is discarded
            begin = self._pending.rfind(b"$", 0, end) + 1  # escaped in packets: one was cut
            body, check = bytes(self._pending[begin:end]), bytes(self._pending[end + 1 : end + 3])
            del self._pending[: end + 3]
            yield _decode_body(body, self._runs) if check.lower() == b"%02x" % (sum(body) & 0xFF) else None


def _decode_body(body: bytes, runs: bool) -> bytes:
    """Undo escapes and run-length encoding: after a byte, ``*`` and the number of its repetitions."""
    if _ESCAPE not in body and not (runs and _RUN in body):
        return body
    plain = bytearray()
    bytes_left = iter(body)
    for byte in bytes_left:
        if byte == _ESCAPE:
            plain.append(next(bytes_left, 0) ^ 0x20)
        elif byte == _RUN and runs:
            plain += plain[-1:] * max(next(bytes_left, 0) - _NO_RUN, 0)
        else:
            plain.append(byte)
    return bytes(plain)
