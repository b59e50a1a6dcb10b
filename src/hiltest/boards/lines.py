"""Serial lines to other programs: pseudo-terminals and TCP ports, each with one program at its far end.

Everything here is for one thread that must not wait: what cannot be sent at once is lost, as on
a serial line without flow control; so is what is sent while no program is connected.
"""

from __future__ import annotations

import contextlib
import errno
import hashlib
import os
import select
import socket
import sys
from collections.abc import Iterator
from pathlib import Path
from typing import Protocol

from hiltest.errors import ConfigError

REFUSAL = b"in use: this port serves one client at a time\r\n"
# A client whose machine is gone without a word is noticed after about this time [s].
_DEAD_AFTER_S = 30


class PortLine(Protocol):
    """One end of a serial line.

    Attributes
    ----------
    url : str
        What the program at the other end opens: a device, or a pyserial URL.
    """

    url: str

    @property
    def connected(self) -> bool:
        """Whether a program had it open at the latest look."""

    def sources(self, *, reading: bool) -> list[int]:
        """Return the file descriptors on which something may happen; those of data only when `reading`."""

    def receive(self, limit: int) -> bytes:
        """Accept and drop connections, and return at most `limit` bytes that have arrived."""

    def send(self, data: bytes) -> None:
        """Send what fits now."""

    def close(self) -> None:
        """Close the line for good. Idempotent."""


class PseudoTerminal:
    """A pair of connected terminals: other programs open `path`, the board has `board_end`. POSIX only.

    Attributes
    ----------
    path : str
        A device such as ``/dev/pts/3``.
    board_end : int
        File descriptor.
    """

    def __init__(self) -> None:
        import tty  # does not exist on Windows, where this module can still be imported

        self.board_end, far_end = os.openpty()
        # Raw for every program to come: the settings stay while this end is open.
        tty.setraw(far_end)
        self.path = self.url = os.ttyname(far_end)
        # Not kept open: only so does Linux say whether another program has it open.
        os.close(far_end)
        os.set_blocking(self.board_end, False)
        self._events = select.poll()
        self._events.register(self.board_end, select.POLLIN)
        self._plugged = True
        self.connected = False

    def sources(self, *, reading: bool) -> list[int]:
        """Return the board's end while a program has it open; otherwise it would be ready all the time."""
        return [self.board_end] if reading and self.connected else []

    def receive(self, limit: int) -> bytes:
        """Accept and drop connections, and return the bytes that have arrived; their sender may have left since."""
        happened = dict(self._events.poll(0)).get(self.board_end, 0)
        if happened & select.POLLIN and limit:
            self.connected = True
            return os.read(self.board_end, limit)
        left = bool(happened & select.POLLHUP)
        if left and self.connected:
            self._drop_unread()
        self.connected = not left
        return b""

    def send(self, data: bytes) -> None:
        """Send what fits now."""
        if self.connected and data:
            with contextlib.suppress(BlockingIOError):
                os.write(self.board_end, data)

    def unplug(self) -> None:
        """Hang up, as a pulled cable does; what is open at `path` breaks. Idempotent."""
        if self._plugged:
            self._plugged = self.connected = False
            os.close(self.board_end)

    close = unplug

    def _drop_unread(self) -> None:
        """Drop what the program that left has not read: the next one must not take it for its own."""
        import termios

        # OSError: a program has locked the terminal, and has it open already.
        with contextlib.suppress(OSError):
            far_end = os.open(self.path, os.O_RDWR | os.O_NOCTTY | os.O_NONBLOCK)
            termios.tcflush(far_end, termios.TCIFLUSH)
            os.close(far_end)


class TcpLine:
    """A TCP port as a serial line: bytes as they are, one client; a second one is refused with a message.

    Parameters
    ----------
    host : str
        Address to listen on.
    port : int
        0 for any free one.

    Raises
    ------
    ConfigError
        When the address cannot be listened on.
    """

    def __init__(self, host: str, port: int) -> None:
        try:
            family = socket.getaddrinfo(host, port, type=socket.SOCK_STREAM)[0][0]
            self._listener = socket.create_server((host, port), family=family)
        except (OSError, OverflowError) as error:
            reason = getattr(error, "strerror", None) or error
            of_the_port = getattr(error, "errno", None) in (errno.EADDRINUSE, errno.EACCES)
            advice = "Choose another port, or 0 for any free one." if of_the_port else "Is it this machine's address?"
            raise ConfigError(f"cannot listen on {host} port {port}: {reason}. {advice}") from error
        self._listener.setblocking(False)
        self._client: socket.socket | None = None
        self.port: int = self._listener.getsockname()[1]
        self.url = f"socket://{f'[{host}]' if ':' in host else host}:{self.port}"

    @property
    def connected(self) -> bool:
        """Whether a client is there."""
        return self._client is not None

    def sources(self, *, reading: bool) -> list[int]:
        """Return the listening socket, and that of the client if there is one."""
        return [self._listener.fileno(), *([self._client.fileno()] if reading and self._client else [])]

    def receive(self, limit: int) -> bytes:
        """Accept and drop clients, and return the bytes that the client has sent."""
        data = self._hear(limit)
        with contextlib.suppress(OSError):  # no other client is waiting, or it has left again
            while True:
                self._welcome(self._listener.accept()[0])
        return data

    def send(self, data: bytes) -> None:
        """Send what fits now."""
        if self._client is None or not data:
            return
        try:
            self._client.send(data)
        except BlockingIOError:
            return
        except OSError:
            self._hang_up()

    def close(self) -> None:
        """Hang up on the client, and listen no more."""
        self._hang_up()
        self._listener.close()

    def _hear(self, limit: int) -> bytes:
        if self._client is None or not limit:
            return b""
        try:
            data = self._client.recv(limit)
        except BlockingIOError:
            return b""
        except OSError:
            data = b""
        if not data:
            self._hang_up()
        return data

    def _welcome(self, caller: socket.socket) -> None:
        caller.setblocking(False)
        if self._client is not None:
            with contextlib.suppress(OSError):
                caller.send(REFUSAL)
            caller.close()
            return
        caller.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
        caller.setsockopt(socket.SOL_SOCKET, socket.SO_KEEPALIVE, 1)
        if sys.platform == "linux":
            caller.setsockopt(socket.IPPROTO_TCP, socket.TCP_KEEPIDLE, _DEAD_AFTER_S // 2)
            caller.setsockopt(socket.IPPROTO_TCP, socket.TCP_KEEPINTVL, _DEAD_AFTER_S // 6)
            caller.setsockopt(socket.IPPROTO_TCP, socket.TCP_KEEPCNT, 3)
        self._client = caller

    def _hang_up(self) -> None:
        if self._client is not None:
            self._client.close()
            self._client = None


@contextlib.contextmanager
def _kept_alone(path: Path) -> Iterator[None]:
    """Hold a lock that one process can have: where a link leads does not say which process keeps it."""
    folder = os.path.realpath(path.parent)
    name = hashlib.sha256(os.fsencode(os.path.join(folder, path.name))).hexdigest()
    with socket.socket(socket.AF_UNIX) as held:
        try:
            held.bind(f"\0hiltest-link-{name}")  # of the system, not of a file: it ends with the process
        except OSError as error:
            if error.errno == errno.EADDRINUSE:  # anything else: a system without such names, where no one is asked
                raise ConfigError(
                    f"cannot make the link {path}: another hiltest serve keeps it. Name another one with --link"
                ) from error
        yield


@contextlib.contextmanager
def port_link(path: Path, target: str) -> Iterator[None]:
    """Keep a symbolic link to a terminal for the time of the context.

    A link that an earlier start has left behind is replaced; nothing else is.

    Raises
    ------
    ConfigError
        When something else is at `path`, another process keeps it, or it cannot be written.
    """
    with _kept_alone(path):
        yield from _link(path, target)


def _link(path: Path, target: str) -> Iterator[None]:
    try:
        if path.is_symlink() and os.readlink(path).startswith("/dev/pts/"):
            path.unlink()
        path.symlink_to(target)
    except OSError as error:
        raise ConfigError(f"cannot make the link {path}: {error.strerror}. Name another one with --link") from error
    try:
        yield
    finally:
        with contextlib.suppress(OSError):
            if os.readlink(path) == target:
                path.unlink()
