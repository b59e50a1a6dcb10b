"""The far end of a serial wire, at the host."""

from __future__ import annotations

from collections import deque
from collections.abc import Callable

from hiltest.errors import BenchError

_MOST_BYTES = 1 << 24


class FarEnd:
    """The host's end of a UART whose model is in Python.

    Attributes
    ----------
    line_baud : int
        Rate at the far end of the wire [bit/s].
    """

    def connect_far_end(self, name: str, expect_arrival: Callable[[], None]) -> None:
        """Begin without bytes; `expect_arrival` is called when a byte begins on its way to the board."""
        self.line_baud = 115_200
        self._line_name, self._expect_arrival_at_board = name, expect_arrival
        self._to_board: deque[int] = deque()
        self._to_host = bytearray()
        self._has_lost = False

    def send_to_host(self, byte: int) -> None:
        """Put a byte of the board on the wire, at whose far end it waits."""
        self._has_lost |= len(self._to_host) >= _MOST_BYTES
        self._to_host.append(byte)

    def take_from_host(self) -> int:
        """Take the byte that has arrived at the board; the next one begins on its way."""
        byte = self._to_board.popleft()
        if self._to_board:
            self._expect_arrival_at_board()
        return byte

    def host_write(self, data: bytes) -> None:
        """Put bytes on the line towards the board, one after the other at line speed.

        Raises
        ------
        BenchError
            If more than 16 MiB are on the line.
        """
        if len(self._to_board) + len(data) > _MOST_BYTES:
            raise BenchError(f"{self._line_name} of the virtual board cannot accept {len(data)} more bytes at once")
        was_silent = not self._to_board
        self._to_board.extend(data)
        if data and was_silent:
            self._expect_arrival_at_board()

    def host_expect(self, count: int, byte: int) -> None:
        """Ignore the expectation: the core stops after every byte anyway, so the caller checks each time."""

    @property
    def host_arriving(self) -> int:
        """Bytes of the host that are on the line towards the board."""
        return len(self._to_board)

    @property
    def answer(self) -> tuple[int, int]:
        """Cycles from the host's latest byte to the board's next one, which only the K64F's UART counts."""
        return 0, 0

    @property
    def host_waiting(self) -> int:
        """Bytes that the board has sent and the host has not fetched."""
        return len(self._to_host)

    def host_read(self, size: int) -> bytes:
        """Return bytes that the board has sent.

        Raises
        ------
        BenchError
            If bytes were lost because the host has not fetched 16 MiB before them.
        """
        if self._has_lost:
            raise BenchError(
                f"{self._line_name} of the virtual board has lost bytes: 16 MiB before them were not fetched"
            )
        data = bytes(self._to_host[:size])
        del self._to_host[:size]
        return data
