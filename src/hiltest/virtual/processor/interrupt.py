"""Handling of Ctrl-C while the emulator runs."""

from __future__ import annotations

import signal
import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from types import FrameType


@contextmanager
def deferred_interrupt(look: Callable[[], None]) -> Iterator[Callable[[], None]]:
    """Defer Ctrl-C until the emulator has stopped.

    Python raises KeyboardInterrupt at any point. In a callback of the emulator it would be printed and dropped, or it
    would stop the board in the middle of an instruction.

    Parameters
    ----------
    look
        Called at Ctrl-C to stop the emulator soon.

    Yields
    ------
    callable
        If Ctrl-C was pressed, calls the previously installed handler, which raises KeyboardInterrupt or returns. The
        context also calls it at its end.
    """
    if threading.current_thread() is not threading.main_thread():
        yield lambda: None  # signals reach the main thread only
        return
    pressed: list[FrameType | None] = []
    before = signal.getsignal(signal.SIGINT)

    def press(_number: int, frame: FrameType | None) -> None:
        pressed.append(frame)
        look()

    def call_handler() -> None:
        signal.signal(signal.SIGINT, before)
        if not pressed:
            return
        frame = pressed[0]
        pressed.clear()
        if not callable(before):
            raise KeyboardInterrupt
        before(signal.SIGINT, frame)

    def pass_on() -> None:
        nonlocal before
        if pressed:
            call_handler()
            before = signal.signal(signal.SIGINT, press)  # a handler may have installed another one

    signal.signal(signal.SIGINT, press)
    try:
        yield pass_on
    finally:
        call_handler()
