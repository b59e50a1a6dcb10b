"""A serial port with the line faults of a rig's ``[faults]`` table, over any other port.

Times are by the port's own clock if it has one, as a virtual board's port does: then faults hit the same bytes each
time, on every host.
"""

from __future__ import annotations

import errno
import os
import random
import time
from collections import Counter, deque
from collections.abc import Callable, Iterator
from typing import Any

import serial

from hiltest.link.ports import WRITE_TIMEOUT_S, SerialPort
from hiltest.rig.faults import Faults

_BITS = 10  # bits per byte on the line: start, eight of data, stop


def add_faults(port: SerialPort, faults: Faults | None, *, baud: int) -> SerialPort:
    """Return a port with the faults of a rig's line, itself if the rig has none."""
    return port if faults is None or not faults.has_line_faults else FaultyPort(port, faults, baud=baud)


class FaultyPort:
    """A port that passes everything on to another one, through faults.

    Delayed bytes move on at the next use of the port, so they may be late by one more read.

    Parameters
    ----------
    port
        Open port. This port also offers its other attributes, such as its own clock.
    baud
        Line speed that the host has set.

    Attributes
    ----------
    happened : Counter of str
        Faults of single bytes so far, by their key in the rig.
    """

    def __init__(self, port: SerialPort, faults: Faults, *, baud: int) -> None:
        self.name = port.name
        self.happened: Counter[str] = Counter()
        self._port: Any = port
        self._faults = faults
        clock: Callable[[], float] = getattr(port, "now", None) or time.monotonic
        self._clock, self._opened_s = clock, clock()
        board_baud = faults.baud.to if faults.baud else baud
        self._to_board = _Direction(faults, "to-board", self.happened, (baud, board_baud))
        self._to_host = _Direction(faults, "to-host", self.happened, (board_baud, baud))
        self._was_gone = False

    def __getattr__(self, name: str) -> Any:
        return getattr(self._port, name)

    def _since_s(self) -> float:
        return self._clock() - self._opened_s

    @property
    def timeout(self) -> float | None:
        """How long one read may wait [s]."""
        waits_s: float | None = self._port.timeout
        return waits_s

    @timeout.setter
    def timeout(self, seconds: float | None) -> None:
        self._port.timeout = seconds

    def read(self, size: int = 1) -> bytes:
        """Return the bytes that have arrived, at most `size`."""
        return self._next_piece(lambda: self._port.read(size), lambda piece: size)

    def read_until(self, expected: bytes) -> bytes:
        """Return bytes up to and including `expected`, fewer when the read slice is over or the line splits them."""
        return self._next_piece(
            lambda: self._port.read_until(expected), lambda piece: piece.find(expected) + 1 or len(piece)
        )

    def write(self, data: bytes) -> int:
        """Send bytes.

        Raises
        ------
        serial.SerialTimeoutException
            When the output buffer stays full for as long as a write may take.
        serial.SerialException
            When the device is gone.
        """
        self._fail_if_gone("write")
        full, began_s = self._faults.full_output, self._since_s()
        while full is not None and full.holds(self._since_s()):
            if self._since_s() - began_s >= WRITE_TIMEOUT_S:
                raise serial.SerialTimeoutException("Write timeout")
            self._listen(lambda: self._port.read_until(b"\x7e"))  # a virtual clock moves while the host reads
        self._to_board.take(bytes(data), self._since_s())
        self._send_due()
        return len(data)

    def reset_input_buffer(self) -> None:
        """Drop the unread bytes that have arrived."""
        self._to_host.waiting.clear()
        self._port.reset_input_buffer()

    def close(self) -> None:
        self._port.close()

    def _next_piece(self, read: Callable[[], bytes], end: Callable[[bytes], int]) -> bytes:
        """Return the next piece that is due, up to the index `end(piece)`; poll the port first if none is due."""
        self._fail_if_gone("read")
        self._send_due()
        piece = next(self._to_host.due(self._since_s()), b"")
        if not piece:
            self._listen(read)
            self._fail_if_gone("read")
            piece = next(self._to_host.due(self._since_s()), b"")
        at = end(piece)
        if piece[at:]:
            self._to_host.waiting.appendleft((0.0, piece[at:]))
        return piece[:at]

    def _listen(self, read: Callable[[], bytes]) -> None:
        self._send_due()
        self._to_host.take(read(), self._since_s())

    def _send_due(self) -> None:
        for piece in self._to_board.due(self._since_s()):
            self._port.write(piece)

    def _fail_if_gone(self, message: str) -> None:
        """Fail as pyserial does on a device that has disappeared, and drop the bytes on their way."""
        gone = self._faults.disappear is not None and self._faults.disappear.holds(self._since_s())
        if gone or self._was_gone:
            self._to_board.waiting.clear()
            self.reset_input_buffer()
        self._was_gone = gone
        if gone:
            raise serial.SerialException(f"{message} failed: [Errno {errno.EIO}] {os.strerror(errno.EIO)}")


class _Direction:
    """One direction of the line.

    Attributes
    ----------
    waiting : deque of (float, bytes)
        Pieces on their way, with the times at which they are due.
    """

    def __init__(self, faults: Faults, name: str, happened: Counter[str], bauds: tuple[int, int]) -> None:
        self.waiting: deque[tuple[float, bytes]] = deque()
        self._faults, self._happened, self._bauds = faults, happened, bauds
        self._dice = random.Random(f"{faults.seed} {name}")
        self._touched = faults.direction in ("both", name)

    def take(self, data: bytes, since_s: float) -> None:
        """Put bytes on their way."""
        if not self._touched:
            self.waiting.append((0.0, data))
            return
        last_s = self.waiting[-1][0] if self.waiting else 0.0
        for by_s, piece in self._pieces(data, since_s >= self._faults.after_s):
            last_s = max(last_s, since_s + by_s)  # no byte overtakes another
            if self._faults.baud is not None and since_s >= self._faults.baud.after_s:
                piece = heard_at(piece, *self._bauds)
            if piece:
                self.waiting.append((last_s, piece))

    def due(self, since_s: float) -> Iterator[bytes]:
        """Yield the pieces that arrive by now, each no longer on its way."""
        stall = self._faults.stall
        while self.waiting and self.waiting[0][0] <= since_s:
            if self._touched and stall is not None and stall.holds(since_s):
                return
            yield self.waiting.popleft()[1]

    def _pieces(self, data: bytes, begun: bool) -> Iterator[tuple[float, bytes]]:
        """Yield the remaining pieces of bytes after drops, with the delay of each."""
        faults, late = self._faults, self._faults.late
        piece, by_s = bytearray(), 0.0
        for byte in data:
            # The same count of random numbers for each byte, so that its faults depend on its index alone.
            hit, bit, cut, wait = (self._dice.random() for _ in range(4))
            if not begun:
                piece.append(byte)
                continue
            if late is not None and wait < late.probability:
                self._happened["late"] += 1
                yield by_s, bytes(piece)
                piece, by_s = bytearray(), late.by_s
            if hit < faults.lose:
                self._happened["lose"] += 1
            elif hit < faults.lose + faults.double:
                self._happened["double"] += 1
                piece += bytes((byte, byte))
            elif hit < faults.lose + faults.double + faults.flip:
                self._happened["flip"] += 1
                piece.append(byte ^ (1 << int(8 * bit)))
            else:
                piece.append(byte)
            if cut < faults.split:
                self._happened["split"] += 1
                yield by_s, bytes(piece)
                piece = bytearray()
        yield by_s, bytes(piece)


def heard_at(data: bytes, sent_baud: int, heard_baud: int) -> bytes:
    """Return the bytes that a receiver with another line speed decodes from back-to-back bytes.

    The receiver takes a falling edge for a start bit and samples the line in the middle of the nine bits after it, by
    its own clock. It ignores a missing stop bit, as terminals do by default.
    """
    levels = [level for byte in data for level in (0, *(byte >> n & 1 for n in range(8)), 1)]
    heard, free = bytearray(), 0
    # Units in which a sent bit is 2 `heard_baud` long, and a received one 2 `sent_baud`.
    for at, level in enumerate(levels):
        edge = 2 * heard_baud * at
        if edge < free or level or (at and not levels[at - 1]):
            continue
        samples = ((edge + (3 + 2 * n) * sent_baud) // (2 * heard_baud) for n in range(8))
        heard.append(sum((levels[index] if index < len(levels) else 1) << n for n, index in enumerate(samples)))
        free = edge + (2 * _BITS - 1) * sent_baud
    return bytes(heard)
