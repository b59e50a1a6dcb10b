"""Ctrl-C while the emulator runs."""

from __future__ import annotations

import signal
import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from types import FrameType


@contextmanager
def deferred_interrupt(look: Callable[[], None]) -> Iterator[Callable[[], bool]]:
    """Defer Ctrl-C until the emulator has stopped, then raise it.

    Python raises KeyboardInterrupt at any point. Within a callback
    of the emulator it would be printed and dropped, or leave the board in the
    middle of an instruction.

    Parameters
    ----------
    look
        Called at Ctrl-C: stops the emulator soon.

    Yields
    ------
    callable
        Returns whether Ctrl-C was pressed.

    Raises
    ------
    KeyboardInterrupt
        At the end of the context if it was pressed (or the previous handler's action).
    """
    if threading.current_thread() is not threading.main_thread():
        yield lambda: False  # only the main thread receives signals
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
