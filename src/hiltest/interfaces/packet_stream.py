"""Packets in a stream of bytes, with any segmentation and any bytes between them."""

from __future__ import annotations

import math
import time
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass

import numpy as np
import serial
from numpy.typing import NDArray

from hiltest.errors import FrameError, LinkLostError
from hiltest.interfaces.packet_fields import Packet, layout, per_kind, scaled, sent_fields, unpack
from hiltest.interfaces.packets import KINDS, Release
from hiltest.link.framing import DELIMITER, ESCAPE, unstuff
from hiltest.link.ports import SerialPort

# Length of the largest body with every byte stuffed: a longer run without a delimiter is no packet.
_LONGEST_STUFFED = 2 * max(layout(kind).size for kind in KINDS)
# Bytes that are decoded at once, so that the working memory fits in the processor's caches.
PIECE = 1 << 18
_LOOK_EVERY_S = 0.25


@per_kind
def row_type(kind: type[Packet]) -> np.dtype[np.void]:
    """Return the NumPy type of a kind's body: the type and the transmitted fields."""
    fields = [(name, np.dtype(f"<{sent.letter}"), sent.count) for name, sent in sent_fields(kind)]
    return np.dtype(
        [("type", "u1"), *((name, form, (count,)) if count else (name, form) for name, form, count in fields)]
    )


@dataclass(frozen=True, slots=True)
class PacketTable:
    """Packets of one kind."""

    kind: type[Packet]
    """Their kind."""
    at: NDArray[np.int64]
    """Shape (n,). Position of each packet in the stream: its first byte after the delimiter."""
    rows: NDArray[np.void]
    """Shape (n,). Their transmitted fields, by name."""

    def scaled_values(self, name: str) -> NDArray[np.float64]:
        """Return an attribute in its unit, such as ``acceleration_g``: shape (n,) or (n, count)."""
        attribute = scaled(self.kind)[name]
        values: NDArray[np.float64] = self.rows[attribute.field] / attribute.per_unit
        return values

    def packets(self) -> list[Packet]:
        """Return the packets one by one."""
        return [unpack(self.kind, row.tobytes()) for row in self.rows]


@dataclass(frozen=True, slots=True)
class PacketBatch:
    """Packets that a piece of the stream completed."""

    tables: tuple[PacketTable, ...]
    """Packets by kind, without empty kinds."""
    lost_bytes: int
    """Bytes that belong to no packet. Delimiters are not counted."""

    def packets(self) -> list[Packet]:
        """Return the packets in the order in which they came."""
        came = [
            (int(at), packet) for table in self.tables for at, packet in zip(table.at, table.packets(), strict=True)
        ]
        return [packet for _, packet in sorted(came, key=lambda entry: entry[0])]

    def numbers(self) -> NDArray[np.uint8]:
        """Return the packets' numbers in the order in which they came."""
        if not self.tables:
            return np.empty(0, np.uint8)
        order = np.argsort(np.concatenate([table.at for table in self.tables]))
        numbers: NDArray[np.uint8] = np.concatenate([table.rows["number"] for table in self.tables])[order]
        return numbers


class PacketDecoder:
    """Decoder of packets in a stream of bytes that arrives in pieces.

    It starts at the first delimiter and resynchronises at every one, so no bytes can stop it. The packets have no check
    value, so damage that preserves type and length is not detected.

    Attributes
    ----------
    release : Release or None
        Release whose packets are decoded; may be set when it is known; None for all. A packet of one release that loses
        two bytes may be a packet of another.

    Examples
    --------
    >>> decoder = PacketDecoder()
    >>> batch = decoder.feed(bytes.fromhex("5e 7e 7e0205d402e8037e 7e02"))
    >>> batch.packets(), batch.lost_bytes
    ([DebugPacket(number=5, firmware=724, ticks=1000)], 1)
    """

    def __init__(self, release: Release | None = None) -> None:
        self.release = release
        self._rest = b""
        self._rest_at = 0
        self._in_step = False

    @property
    def unfinished(self) -> int:
        """Number of bytes since the last delimiter, which may become a packet."""
        return len(self._rest)

    def feed(self, data: bytes) -> PacketBatch:
        """Decode more bytes and return the packets that they complete."""
        data = self._rest + data
        array = np.frombuffer(data, np.uint8)
        marks = np.flatnonzero(array == DELIMITER)
        tables: list[PacketTable] = []
        lost = 0
        if marks.size:
            starts = np.concatenate([[0] if self._in_step else [], marks[:-1] + 1]).astype(np.int64)
            stops = marks if self._in_step else marks[1:]
            lost = 0 if self._in_step else int(marks[0])
            kinds = self.release.value if self.release else KINDS
            pieces = _Pieces(data, array, starts, stops)
            tables, of_packets = _tables(pieces, kinds, self._rest_at)
            lost += int((stops - starts).sum()) - of_packets
            self._in_step = True
        lost += self._keep(data, int(marks[-1]) + 1 if marks.size else 0)
        return PacketBatch(tuple(tables), lost)

    def _keep(self, data: bytes, begin: int) -> int:
        """Keep the bytes after the last delimiter while they can be a packet; return the number of lost bytes."""
        lost = 0
        if not self._in_step or len(data) - begin > _LONGEST_STUFFED:
            lost = len(data) - begin
            self._in_step = False
            begin = len(data)
        self._rest = data[begin:]
        self._rest_at += begin
        return lost


def batches(data: bytes, release: Release | None = None) -> Iterator[PacketBatch]:
    """Yield the packets of a recording of a release, in pieces; bytes after its last delimiter are lost."""
    decoder = PacketDecoder(release)
    for begin in range(0, len(data), PIECE):
        yield decoder.feed(data[begin : begin + PIECE])
    if decoder.unfinished:
        yield PacketBatch((), decoder.unfinished)


def heard(
    port: SerialPort, decoder: PacketDecoder, *, seconds: float | None, ended: Callable[[], bool]
) -> Iterator[PacketBatch]:
    """Yield the packets that arrive over a port, several times a second.

    Parameters
    ----------
    port
        Open; a port with a clock of its own counts the seconds by that.
    decoder
        Receives the bytes.
    seconds
        How long to listen; None: until `ended`.
    ended
        Called a few times a second.

    Raises
    ------
    LinkLostError
        When the port breaks.
    """
    now: Callable[[], float] = getattr(port, "now", None) or time.monotonic
    end_s = now() + seconds if seconds is not None else math.inf
    while now() < end_s and not ended():
        look_s, data = min(now() + _LOOK_EVERY_S, end_s), bytearray()
        while now() < look_s and len(data) < PIECE:
            try:
                data += port.read_until(b"\x7e")
            except (serial.SerialException, OSError) as error:
                raise LinkLostError(port.name, str(error)) from error
        yield decoder.feed(bytes(data))
    if decoder.unfinished:
        yield PacketBatch((), decoder.unfinished)


@dataclass(frozen=True, slots=True)
class _Pieces:
    """Pieces between delimiters: places in bytes, and the same bytes as a NumPy array."""

    data: bytes
    array: NDArray[np.uint8]
    starts: NDArray[np.int64]
    stops: NDArray[np.int64]

    def __getitem__(self, which: NDArray[np.bool_] | NDArray[np.intp]) -> _Pieces:
        """Return some of them."""
        return _Pieces(self.data, self.array, self.starts[which], self.stops[which])

    @property
    def sizes(self) -> NDArray[np.int64]:
        """Size of each [byte]."""
        return self.stops - self.starts


def _tables(pieces: _Pieces, kinds: Sequence[type[Packet]], offset: int) -> tuple[list[PacketTable], int]:
    """Return the packets among the pieces, and their number of bytes on the line."""
    pieces = pieces[(pieces.sizes >= 2) & (pieces.sizes <= _LONGEST_STUFFED)]
    escapes = np.flatnonzero(pieces.array == ESCAPE)
    escaped = np.searchsorted(escapes, pieces.stops) - np.searchsorted(escapes, pieces.starts)
    # An escape takes one more byte; `_bodies` checks that each is valid.
    types, lengths = pieces.array[pieces.starts], pieces.sizes - escaped
    tables, taken_bytes = [], 0
    for kind in kinds:
        mine = pieces[np.flatnonzero((types == kind.type) & (lengths == layout(kind).size))]
        bodies, good = _bodies(mine, layout(kind).size)
        if good.any():
            rows = np.ascontiguousarray(bodies[good]).view(row_type(kind))[:, 0]
            tables.append(PacketTable(kind, mine.starts[good] + offset, rows))
            taken_bytes += int(mine.sizes[good].sum())
    return tables, taken_bytes


def _bodies(pieces: _Pieces, size: int) -> tuple[NDArray[np.uint8], NDArray[np.bool_]]:
    """Return the bodies without escapes, and a mask of those whose escapes are all valid."""
    good = np.ones(len(pieces.starts), np.bool_)
    plain = pieces.sizes == size
    bodies = np.zeros((len(good), size), np.uint8)
    if plain.any():
        bodies[plain] = np.lib.stride_tricks.sliding_window_view(pieces.array, size)[pieces.starts[plain]]
    for index in np.flatnonzero(~plain):
        try:
            body = unstuff(pieces.data[pieces.starts[index] : pieces.stops[index]])
            bodies[index] = np.frombuffer(body, np.uint8)
        except FrameError:
            good[index] = False
    return bodies, good
