"""GDB server of a virtual board: a TCP port with GDB's remote protocol, in its own thread."""

from __future__ import annotations

import contextlib
import select
import socket
import threading
import time
from typing import Self

from hiltest.boards.gdb_session import GdbSession
from hiltest.boards.served_lines import Door, keep_alive
from hiltest.virtual.board.debugger import Debugger
from hiltest.virtual.board.virtual_machine import VirtualMachine

_AT_A_LOOK = 1 << 16
# Longest time that GDB may block a write before it is disconnected [s], because it holds the board meanwhile.
_UNREAD_S = 5.0
_FIRST_BYTES = (b"+", b"-", b"$", b"\x03")  # of a GDB, and of no HTTP and no TLS
# While the board runs, the thread rests longer than it works, so that a flood costs the board less than a tenth.
_REST, _LONGEST_REST_S = 19.0, 1.0


class GdbServer:
    """A server for one GDB at a time; the board runs on when it disconnects.

    Parameters
    ----------
    machine
        Not running yet.
    port
        0 for any free one.
    host
        Address to listen on.

    Attributes
    ----------
    port : int
        Port that it listens on.
    token : str
        First line of a client; empty on a loopback address, where none is needed.

    Raises
    ------
    ConfigError
        When the address cannot be listened on.
    """

    def __init__(self, machine: VirtualMachine, port: int, *, host: str = "127.0.0.1") -> None:
        self._machine = machine
        self._door = Door(host, port)
        self.port: int = self._door.port
        self.token = self._door.token
        self._halted, self._wake = socket.socketpair()  # one byte for each halt that GDB did not ask for
        self._wake.setblocking(False)
        self._debugger = Debugger(machine, on_stop=self._notice)
        self._client = socket.socket()  # of the present GDB, if any
        self._ended = False
        self._thread = threading.Thread(target=self._run, name="hiltest-gdb", daemon=True)
        self._thread.start()

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    @property
    def connected(self) -> bool:
        """True if a GDB is connected."""
        return self._machine.debugged

    def close(self) -> None:
        """Disconnect, let the board run, and stop listening. Idempotent."""
        self._ended = True
        self._notice()
        with contextlib.suppress(OSError):  # so that a client that does not read its answers holds nothing up
            self._client.shutdown(socket.SHUT_RDWR)
        self._thread.join()
        self._door.close()
        for sock in (self._halted, self._wake, self._client):
            sock.close()

    def _notice(self) -> None:
        with contextlib.suppress(OSError):  # the buffer is full, or the server is closed
            self._wake.send(b"!")

    def _run(self) -> None:
        while not self._ended:
            select.select([*self._door.sources(), self._halted.fileno()], [], [])
            if self._ended:
                return
            if select.select([self._halted], [], [], 0)[0]:
                self._halted.recv(_AT_A_LOOK)
                continue
            with contextlib.suppress(OSError):  # the client has left already, or leaves while it is served
                self._serve(self._door.admit())

    def _serve(self, client: socket.socket) -> None:
        self._client.close()
        self._client = client
        with client:
            keep_alive(client)
            client.settimeout(_UNREAD_S)
            # Nothing is halted, and nothing obeyed, for a client that is no GDB, such as a browser.
            if client.recv(1, socket.MSG_PEEK) not in _FIRST_BYTES:
                return
            session = GdbSession(self._machine, self._debugger)
            try:
                while not (self._ended or session.over):
                    began_s = time.thread_time()
                    self._exchange(client, session)
                    if session.awaits_halt:  # the board runs, and needs the processor more than GDB
                        time.sleep(min(_REST * (time.thread_time() - began_s), _LONGEST_REST_S))
            finally:
                session.close()

    def _exchange(self, client: socket.socket, session: GdbSession) -> None:
        """Forward the next message of GDB or the processor; `session` ends when GDB disconnects."""
        ready, _, _ = select.select([client.fileno(), self._halted.fileno(), *self._door.sources()], [], [])
        if self._halted.fileno() in ready:
            self._halted.recv(_AT_A_LOOK)
            client.sendall(session.stopped())
        with contextlib.suppress(BlockingIOError):
            self._door.admit().close()  # one at a time
        if client.fileno() in ready:
            data = client.recv(_AT_A_LOOK)
            if not data:
                session.close()
                return
            for answer in session.answers(data):
                client.sendall(answer)
