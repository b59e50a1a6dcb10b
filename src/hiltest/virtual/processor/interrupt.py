"""Ctrl-C while the emulator runs."""

from __future__ import annotations

import signal
import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from types import FrameType


@contextmanager
def deferred_interrupt(look: Callable[[], None]) -> Iterator[Callable[[], bool]]:
    """Hold Ctrl-C back until the emulator has stopped, then raise it.

    Python raises KeyboardInterrupt wherever it happens to be. Within a callback
    of the emulator it would be printed and dropped, or leave the board half way
    through an instruction.

    Parameters
    ----------
    look
        Called at once: makes the emulator stop soon.

    Yields
    ------
    callable
        Answers whether Ctrl-C was pressed.

    Raises
    ------
    KeyboardInterrupt
        On leaving, when it was (or what the handler before this one does).
    """
    if threading.current_thread() is not threading.main_thread():
        yield lambda: False  # signals reach the main thread only
        return
    pressed: list[FrameType | None] = []

    def press(_number: int, frame: FrameType | None) -> None:
        pressed.append(frame)
        look()

    before = signal.signal(signal.SIGINT, press)
    try:
        yield lambda: bool(pressed)
    finally:
        signal.signal(signal.SIGINT, before)
        if pressed:
            if callable(before):
                before(signal.SIGINT, pressed[0])
            else:
                raise KeyboardInterrupt
