"""A scripted far end of a pseudo-terminal, for what a healthy board never sends."""

from __future__ import annotations

import os
import select
import threading
import tty
from collections.abc import Callable, Iterator
from contextlib import ExitStack

import pytest

from hiltest.link.framing import Frame, FrameDecoder
from hiltest.link.ports import open_port
from hiltest.link.session import Session
from hiltest.link.transcript import Transcript

Script = Callable[[Frame, int], bytes | None]


class PtyPeer:
    """Answer each frame with ``script(frame, how many before it)``; None hangs up the line.

    It is no board: it knows nothing of commands.
    """

    def __init__(self, script: Script, greeting: bytes) -> None:
        self._script = script
        self._greeting = greeting
        self._master, self._slave = os.openpty()
        tty.setraw(self._slave)
        self.path = os.ttyname(self._slave)
        self._line_open = True
        self._stop_read, self._stop_write = os.pipe()
        self._thread = threading.Thread(target=self._serve)

    def __enter__(self) -> PtyPeer:
        self._thread.start()
        return self

    def __exit__(self, *_: object) -> None:
        os.write(self._stop_write, b"x")
        self._thread.join(timeout=5.0)
        self._hang_up()
        os.close(self._stop_read)
        os.close(self._stop_write)

    def _hang_up(self) -> None:
        if self._line_open:
            self._line_open = False
            os.close(self._slave)
            os.close(self._master)

    def _serve(self) -> None:
        decoder = FrameDecoder()
        os.write(self._master, self._greeting)
        count = 0
        while True:
            readable, _, _ = select.select([self._master, self._stop_read], [], [])
            if self._stop_read in readable:
                return
            for frame in decoder.feed(os.read(self._master, 4096)):
                assert isinstance(frame, Frame)
                answer = self._script(frame, count)
                count += 1
                if answer is None:
                    self._hang_up()
                    return
                os.write(self._master, answer)


OpenSession = Callable[..., Session]


@pytest.fixture
def session_with() -> Iterator[OpenSession]:
    """Return a function that opens a session, not yet synchronised, with a scripted far end."""
    with ExitStack() as stack:

        def open_session(script: Script, *, deadline_s: float = 0.3, greeting: bytes = b"") -> Session:
            peer = stack.enter_context(PtyPeer(script, greeting))
            session = Session(
                open_port(peer.path), transcript=Transcript("wall"), reply_deadline_s=deadline_s, nonce_seed=1
            )
            stack.callback(session.close)
            return session

        yield open_session
