"""Packets of the GDB remote serial protocol: framing, check and escapes."""

from __future__ import annotations

from collections.abc import Iterator

LONGEST = 1 << 14
"""Longest packet that is taken [bytes]; gdb is told."""

INTERRUPT = b"\x03"
ACKNOWLEDGED, AGAIN = b"+", b"-"
_ESCAPE = 0x7D
_RUN = 0x2A
_NO_RUN = 29  # a count is written as a printable character: this much more than it is
_RESERVED = b"#$}*"


def packet(data: bytes) -> bytes:
    """Frame a command or an answer."""
    escaped = b"".join(bytes((_ESCAPE, each ^ 0x20)) if each in _RESERVED else bytes((each,)) for each in data)
    return b"$%s#%02x" % (escaped, sum(escaped) & 0xFF)


class PacketReader:
    """Finds packets in a stream of bytes, whatever else is in it.

    Parameters
    ----------
    runs
        Whether a byte may stand for several, as in what a server answers.
    """

    def __init__(self, *, runs: bool = False) -> None:
        self._kept = bytearray()
        self._runs = runs

    def feed(self, data: bytes) -> Iterator[bytes | None]:
        """Yield the content of every packet that is complete, `INTERRUPT`, `AGAIN`, or None for a damaged packet."""
        self._kept += data
        while self._kept:
            first = bytes(self._kept[:1])
            if first != b"$":
                del self._kept[:1]
                if first in (INTERRUPT, AGAIN):
                    yield first
                continue
            end = self._kept.find(b"#")
            if end < 0 or end + 3 > len(self._kept):
                if len(self._kept) <= LONGEST + 4:
                    return  # the rest is to come
                end = len(self._kept)  # nothing that was begun like this is taken
            begin = self._kept.rfind(b"$", 0, end) + 1  # within a packet it is escaped: one was broken off
            body, check = bytes(self._kept[begin:end]), bytes(self._kept[end + 1 : end + 3])
            del self._kept[: end + 3]
            yield _plain(body, self._runs) if check.lower() == b"%02x" % (sum(body) & 0xFF) else None


def _plain(body: bytes, runs: bool) -> bytes:
    """Undo escapes, and runs: behind a byte, ``*`` and how often it stands there again."""
    if _ESCAPE not in body and not (runs and _RUN in body):
        return body
    plain = bytearray()
    bytes_left = iter(body)
    for each in bytes_left:
        if each == _ESCAPE:
            plain.append(next(bytes_left, 0) ^ 0x20)
        elif each == _RUN and runs:
            plain += plain[-1:] * max(next(bytes_left, 0) - _NO_RUN, 0)
        else:
            plain.append(each)
    return bytes(plain)
