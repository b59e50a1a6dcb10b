"""GDB at a virtual board: a TCP port that speaks its remote protocol, in a thread of its own."""

from __future__ import annotations

import contextlib
import select
import socket
import threading
from types import TracebackType
from typing import Self

from hiltest.boards.gdb_session import GdbSession
from hiltest.boards.lines import listen
from hiltest.virtual.board.debugger import Debugger
from hiltest.virtual.board.k64f import VirtualK64F

_AT_A_LOOK = 1 << 16
# What a GDB that reads nothing may leave unread before it is hung up on [s]: it holds the board meanwhile.
_UNREAD_S = 5.0


class GdbServer:
    """Waits for GDB, one at a time; the board runs on when it leaves.

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
        The one that it listens on.

    Raises
    ------
    ConfigError
        When the address cannot be listened on.
    """

    def __init__(self, machine: VirtualK64F, port: int, *, host: str = "127.0.0.1") -> None:
        self._machine = machine
        self._listener = listen(host, port)
        self.port: int = self._listener.getsockname()[1]
        self._halted, self._wake = socket.socketpair()  # a byte for every halt that the processor made by itself
        self._wake.setblocking(False)
        self._debugger = Debugger(machine, on_stop=self._notice)
        self._ended = False
        self._thread = threading.Thread(target=self._run, name="hiltest-gdb", daemon=True)
        self._thread.start()

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.close()

    @property
    def connected(self) -> bool:
        """Whether a GDB is there."""
        return self._machine.debugged

    def close(self) -> None:
        """Hang up, let the board run, and listen no more. Idempotent."""
        self._ended = True
        self._notice()
        self._thread.join()
        for each in (self._listener, self._halted, self._wake):
            each.close()

    def _notice(self) -> None:
        with contextlib.suppress(OSError):  # as many are waiting as fit, or it is over
            self._wake.send(b"!")

    def _run(self) -> None:
        while not self._ended:
            select.select([self._listener, self._halted], [], [])
            if self._ended:
                return
            if select.select([self._halted], [], [], 0)[0]:
                self._halted.recv(_AT_A_LOOK)
                continue
            with contextlib.suppress(OSError):  # the caller has left again, or leaves while it is served
                caller, _ = self._listener.accept()
                self._serve(caller)

    def _serve(self, client: socket.socket) -> None:
        session = GdbSession(self._machine, self._debugger)
        try:
            with client:
                client.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
                client.settimeout(_UNREAD_S)
                while not (self._ended or session.over):
                    self._exchange(client, session)
        finally:
            session.close()

    def _exchange(self, client: socket.socket, session: GdbSession) -> None:
        """Pass on what GDB and the processor have to say next; `session` is over when GDB has left."""
        ready, _, _ = select.select([client, self._halted, self._listener], [], [])
        if self._halted in ready:
            self._halted.recv(_AT_A_LOOK)
            client.sendall(session.stopped())
        if self._listener in ready:
            self._listener.accept()[0].close()  # one at a time
        if client in ready:
            data = client.recv(_AT_A_LOOK)
            if not data:
                session.close()
                return
            client.sendall(session.feed(data))
