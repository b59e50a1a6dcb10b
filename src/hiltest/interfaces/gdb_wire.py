"""Connection to a GDB server: over TCP in this module; a virtual board has its own."""

from __future__ import annotations

import socket
import time
from typing import Protocol

from hiltest.errors import DebugServerError
from hiltest.link.lock import BoardLock

_CONNECT_S = 5.0
_SEND_S = 5.0
_AT_A_LOOK = 1 << 16
_SHORTEST_S = 1e-3  # a timeout of 0 would mean blocking or non-blocking


class Wire(Protocol):
    """A connection to a GDB server.

    Attributes
    ----------
    name : str
        Name of the server in messages.
    """

    name: str

    def now(self) -> float:
        """Return the time that timeouts use [s]."""

    def send(self, data: bytes) -> None:
        """Send bytes."""

    def receive(self, timeout_s: float) -> bytes:
        """Return the received bytes; empty on a timeout."""

    def close(self) -> None:
        """Disconnect. Idempotent."""


class TcpWire:
    """A GDB server at a TCP port, locked for this process.

    Parameters
    ----------
    rig
        Name of the rig, for messages to other processes that want the board.

    Raises
    ------
    DebugServerError
        When nothing listens there.
    PortRefusedError
        When another process has the board.
    """

    def __init__(self, host: str, port: int, *, rig: str = "") -> None:
        self.name = f"{host}:{port}"
        self._lock = BoardLock(self.name, rig=rig)
        try:
            self._socket = socket.create_connection((host, port), timeout=_CONNECT_S)
        except OSError as error:
            self._lock.release()
            raise DebugServerError(
                self.name,
                f"cannot be reached ({error.strerror or error}); start OpenOCD, pyOCD (pyocd gdbserver), a "
                "J-Link GDB server, or hiltest serve --gdb, and name its port under [device.memory] server",
            ) from error
        self._socket.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)

    def now(self) -> float:
        """Return wall time [s]."""
        return time.monotonic()

    def send(self, data: bytes) -> None:
        """Send bytes.

        Raises
        ------
        DebugServerError
            When the server is gone or does not read.
        """
        try:
            self._socket.settimeout(_SEND_S)
            self._socket.sendall(data)
        except OSError as error:
            raise self._gone(str(error)) from error

    def receive(self, timeout_s: float) -> bytes:
        """Return the received bytes; empty on a timeout.

        Raises
        ------
        DebugServerError
            When the server is gone.
        """
        try:
            self._socket.settimeout(max(timeout_s, _SHORTEST_S))
            data = self._socket.recv(_AT_A_LOOK)
        except TimeoutError:
            return b""
        except ConnectionResetError:  # closed with unread bytes
            data = b""
        except OSError as error:
            raise self._gone(str(error)) from error
        if not data:
            raise self._gone("it has closed the connection")
        return data

    def close(self) -> None:
        """Disconnect. Idempotent."""
        self._socket.close()
        self._lock.release()

    def _gone(self, reason: str) -> DebugServerError:
        return DebugServerError(self.name, f"is gone: {reason}. Check its output, start it again, then run again")
