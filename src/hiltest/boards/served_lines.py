"""Serial lines to other programs: pseudo-terminals and TCP ports, each with one program at its far end.

All functions are for one thread that must not block: bytes that cannot be sent at once are lost, as on a serial line
without flow control; so are bytes sent while no program is connected. Bytes from a program are read at once and queued
for the board, so that a disconnection after them is noticed.
"""

from __future__ import annotations

import contextlib
import ctypes
import errno
import hashlib
import hmac
import ipaddress
import os
import secrets
import select
import socket
import struct
import sys
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Protocol

from hiltest.errors import ConfigError

REFUSAL = b"in use: this port serves one client at a time\r\n"
# Bytes per read: more than the system buffers of a closed terminal.
_AT_A_LOOK = 1 << 18
_TERMINAL_READ = 4096  # Linux returns no more at once
# Capacity of the queue to the board [byte]: 24 minutes of a line at 115 200 baud, and 16 times its flash.
_LONGEST_QUEUE = 1 << 24
# A client whose machine disappeared without closing is noticed after about this time [s].
_DEAD_AFTER_S = 30
# Callers without a token so far: the longest time [s], and the most of them.
_TOKEN_S, _MOST_WAITING = 5.0, 8


class PortLine(Protocol):
    """One end of a serial line.

    Attributes
    ----------
    url : str
        Device or pyserial URL for the program at the other end.
    queue : Queue
        Bytes that programs have sent and the board has not taken.
    """

    url: str
    queue: Queue

    @property
    def connected(self) -> bool:
        """True if a program had it open at the latest poll."""

    def sources(self) -> list[int]:
        """Return the file descriptors on which something may happen."""

    def receive(self, limit: int) -> bytes:
        """Accept and drop connections, and return at most `limit` bytes of those that have arrived."""

    def send(self, data: bytes) -> int:
        """Send as many bytes as fit now; return their number."""

    def close(self) -> None:
        """Close the line for good. Idempotent."""


class Queue:
    """Bytes on their way to the board.

    Attributes
    ----------
    keep_limit : int
        Number of bytes of a disconnected program that are still delivered when the next one connects: the newest ones,
        whose end is the end of a line or a frame.
    lost : int
        Number of bytes that were not delivered.
    used : bool
        True if anything has come so far.
    """

    def __init__(self) -> None:
        self.keep_limit = 4096
        self.lost = 0
        self.used = False
        self._bytes = bytearray()

    def add(self, data: bytes) -> None:
        """Append bytes that arrived, as far as there is room."""
        self.used = self.used or bool(data)
        room = _LONGEST_QUEUE - len(self._bytes)
        self._bytes += data[:room]
        self.lost += max(0, len(data) - room)

    @property
    def backlog(self) -> bool:
        """True if the board has not taken all bytes."""
        return bool(self._bytes)

    def take(self, limit: int) -> bytes:
        """Remove the oldest bytes, at most `limit`, and return them."""
        data = bytes(self._bytes[:limit])
        del self._bytes[:limit]
        return data

    def next_program(self) -> None:
        """Drop bytes that would delay the next program."""
        surplus = max(0, len(self._bytes) - self.keep_limit)
        del self._bytes[:surplus]
        self.lost += surplus


class _Openings:
    """Detector of a device that was closed and opened again, however fast, by Linux's inotify."""

    _OPEN, _CLOSE = 0x20, 0x08 | 0x10  # IN_OPEN, IN_CLOSE
    _EVENT = struct.Struct("iIII")

    def __init__(self, path: str) -> None:
        self._descriptor: int | None = None
        if sys.platform == "linux":
            system = ctypes.CDLL(None)
            descriptor = system.inotify_init1(os.O_NONBLOCK | os.O_CLOEXEC)
            if descriptor >= 0:  # otherwise all inotify instances are in use, and only a closed device is noticed
                self._descriptor = descriptor
                system.inotify_add_watch(descriptor, os.fsencode(path), self._OPEN | self._CLOSE)

    def reopened(self) -> bool:
        """Return whether the device was closed and opened again since the last call."""
        closed = False
        if self._descriptor is not None:
            with contextlib.suppress(BlockingIOError):
                for _watch, mask, _cookie, _length in self._EVENT.iter_unpack(os.read(self._descriptor, 1024)):
                    if closed and mask & self._OPEN:
                        return True
                    closed = closed or bool(mask & self._CLOSE)
        return False

    def close(self) -> None:
        """Stop watching."""
        if self._descriptor is not None:
            os.close(self._descriptor)


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
        # Closed again, because Linux reports an open by another program only then.
        os.close(far_end)
        os.set_blocking(self.board_end, False)
        self._events = select.poll()
        self._events.register(self.board_end, select.POLLIN)
        self._openings = _Openings(self.path)
        self._plugged = True
        self.connected = False
        self.queue = Queue()

    def sources(self) -> list[int]:
        """Return the board's end while a program has it open; otherwise it would be ready all the time."""
        return [self.board_end] if self.connected else []

    def receive(self, limit: int) -> bytes:
        """Accept and drop connections, and return bytes that have arrived; their sender may have left since."""
        was_connected, reopened = self.connected, self._openings.reopened()
        happened = dict(self._events.poll(0)).get(self.board_end, 0)
        if happened & select.POLLIN:
            self._read()
        self.connected = not happened & select.POLLHUP
        if was_connected and (reopened or not self.connected):
            self._drop_unread()
        if reopened or (self.connected and not was_connected):
            self.queue.next_program()
        return self.queue.take(limit)

    def send(self, data: bytes) -> int:
        """Send as many bytes as fit now; return their number."""
        if self.connected and data:
            with contextlib.suppress(BlockingIOError):
                return os.write(self.board_end, data)
        return 0

    def unplug(self) -> None:
        """Hang up, as a pulled cable does; programs that have `path` open get an error. Idempotent."""
        if self._plugged:
            self._plugged = self.connected = False
            os.close(self.board_end)
            self._openings.close()

    close = unplug

    def _read(self) -> None:
        # BlockingIOError: no more bytes; another OSError: no more bytes and no program.
        with contextlib.suppress(OSError):
            for _ in range(_AT_A_LOOK // _TERMINAL_READ):
                self.queue.add(os.read(self.board_end, _TERMINAL_READ))

    def _drop_unread(self) -> None:
        """Drop the unread bytes of the last program, because the next one must not receive them."""
        import termios

        # OSError: a program has locked the terminal, and has it open already.
        with contextlib.suppress(OSError):
            far_end = os.open(self.path, os.O_RDWR | os.O_NOCTTY | os.O_NONBLOCK)
            termios.tcflush(far_end, termios.TCIFLUSH)
            os.close(far_end)


def listen(host: str, port: int) -> socket.socket:
    """Return a socket that listens; port 0 is any free one.

    Raises
    ------
    ConfigError
        When the address cannot be listened on.
    """
    try:
        family = socket.getaddrinfo(host, port, type=socket.SOCK_STREAM)[0][0]
        return socket.create_server((host, port), family=family)
    except (OSError, OverflowError) as error:
        reason = getattr(error, "strerror", None) or error
        of_the_port = getattr(error, "errno", None) in (errno.EADDRINUSE, errno.EACCES)
        advice = (
            "Choose another port, or 0 for any free one." if of_the_port else "Check that this machine has the address."
        )
        raise ConfigError(f"cannot listen on {host} port {port}: {reason}. {advice}") from error


def keep_alive(client: socket.socket) -> None:
    """Send small packets at once, and notice a client whose machine has disappeared."""
    client.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
    client.setsockopt(socket.SOL_SOCKET, socket.SO_KEEPALIVE, 1)
    if sys.platform == "linux":
        client.setsockopt(socket.IPPROTO_TCP, socket.TCP_KEEPIDLE, _DEAD_AFTER_S // 2)
        client.setsockopt(socket.IPPROTO_TCP, socket.TCP_KEEPINTVL, _DEAD_AFTER_S // 6)
        client.setsockopt(socket.IPPROTO_TCP, socket.TCP_KEEPCNT, 3)


class Door:
    """A TCP port that lets callers in: on a loopback address all, elsewhere those that send its token in a line first.

    Attributes
    ----------
    listener : socket
        The port.
    port : int
        Its number.
    url : str
        URL for pyserial, with the token as the user's name, which hiltest sends and other programs ignore.
    """

    def __init__(self, host: str, port: int) -> None:
        self.listener = listen(host, port)
        self.listener.setblocking(False)
        self._waiting: dict[socket.socket, tuple[bytes, float]] = {}  # bytes so far, and time of arrival
        address, self.port = self.listener.getsockname()[:2]
        is_local = ipaddress.ip_address(address.partition("%")[0]).is_loopback
        self.token = "" if is_local else secrets.token_hex(16)
        at = f"[{host}]" if ":" in host else host
        self.url = f"socket://{f'{self.token}@' if self.token else ''}{at}:{self.port}"

    def sources(self) -> list[int]:
        """Return the sockets on which something may happen."""
        return [self.listener.fileno(), *(caller.fileno() for caller in self._waiting)]

    def admit(self) -> socket.socket:
        """Return the next caller that may come in, or raise an OSError at once if there is none."""
        with contextlib.suppress(BlockingIOError):
            caller = self.listener.accept()[0]
            caller.setblocking(False)
            if not self.token:
                return caller
            self._waiting[caller] = b"", time.monotonic()
        expected = f"{self.token}\n".encode()
        for caller, (begin, since_s) in list(self._waiting.items()):
            is_late = time.monotonic() - since_s > _TOKEN_S or len(self._waiting) > _MOST_WAITING
            with contextlib.suppress(BlockingIOError):
                data = caller.recv(len(expected) - len(begin))
                self._waiting[caller] = begin + data, since_s
                if hmac.compare_digest(begin + data, expected):
                    del self._waiting[caller]
                    return caller
                is_late = is_late or not data or b"\n" in data or len(begin + data) == len(expected)
            if is_late:
                del self._waiting[caller]
                caller.close()
        raise BlockingIOError

    def close(self) -> None:
        """Hang up on those that wait, and stop listening."""
        for sock in (self.listener, *self._waiting):
            sock.close()


class TcpLine:
    """A TCP port as a serial line: bytes as they are, one client; a second one is refused with a message.

    Parameters
    ----------
    host
        Address to listen on.
    port
        0 for any free one.

    Raises
    ------
    ConfigError
        When the address cannot be listened on.
    """

    def __init__(self, host: str, port: int) -> None:
        self._door = Door(host, port)
        self._client: socket.socket | None = None
        self.queue = Queue()
        self.port, self.url = self._door.port, self._door.url

    @property
    def connected(self) -> bool:
        """True if a client is connected."""
        return self._client is not None

    def sources(self) -> list[int]:
        """Return the sockets of the door, and that of the client if there is one."""
        return [*self._door.sources(), *([self._client.fileno()] if self._client else [])]

    def receive(self, limit: int) -> bytes:
        """Accept and drop clients, and return bytes that clients have sent."""
        with contextlib.suppress(OSError):  # no other client is waiting, or it has left again
            while self._client is None or not self._hear(self._client):
                self._welcome(self._door.admit())
        return self.queue.take(limit)

    def send(self, data: bytes) -> int:
        """Send as many bytes as fit now; return their number."""
        if self._client is not None and data:
            try:
                return self._client.send(data)
            except BlockingIOError:
                return 0
            except OSError:
                self._hang_up()
        return 0

    def close(self) -> None:
        """Disconnect the client, and stop listening."""
        self._hang_up()
        self._door.close()

    def _hear(self, client: socket.socket) -> bool:
        """Read bytes; return True if more may follow, because a disconnection is only seen after the last of them."""
        try:
            data = client.recv(_AT_A_LOOK)
        except BlockingIOError:
            return False
        except OSError:
            data = b""
        self.queue.add(data)
        if not data:
            self._hang_up()
        return bool(data)

    def _welcome(self, caller: socket.socket) -> None:
        caller.setblocking(False)
        if self._client is not None:
            with contextlib.suppress(OSError):
                caller.send(REFUSAL)
            caller.close()
            return
        self.queue.next_program()
        keep_alive(caller)
        self._client = caller

    def _hang_up(self) -> None:
        if self._client is not None:
            self._client.close()
            self._client = None


@contextlib.contextmanager
def _hold_lock(path: Path) -> Iterator[None]:
    """Hold a lock that one process can have, because the target of a link does not tell which process owns it."""
    folder = os.path.realpath(path.parent)
    name = hashlib.sha256(os.fsencode(os.path.join(folder, path.name))).hexdigest()
    with socket.socket(socket.AF_UNIX) as held:
        try:
            held.bind(f"\0hiltest-link-{name}")  # abstract socket name, which the system frees with the process
        except OSError as error:
            if error.errno == errno.EADDRINUSE:  # other errors: a system without abstract names, which skips the check
                raise ConfigError(
                    f"cannot make the link {path}: another hiltest serve uses it. Name another link with --link"
                ) from error
        yield


@contextlib.contextmanager
def port_link(path: Path, target: str) -> Iterator[None]:
    """Keep a symbolic link to a terminal for the time of the context.

    A stale link of an earlier start is replaced; any other file is not.

    Raises
    ------
    ConfigError
        When something else is at `path`, another process keeps it, or it cannot be written.
    """
    with _hold_lock(path):
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
