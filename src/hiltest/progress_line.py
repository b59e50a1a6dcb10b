"""Progress of long work at the end of the terminal's current line."""

from __future__ import annotations

import time
from typing import Protocol

_REDRAW_S = 0.2
# VT100: keep and restore the cursor, clear to the end of the line. What is shown thus
# never disturbs what pytest has written on the line.
_SAVE, _RESTORE, _CLEAR = "\x1b7", "\x1b8", "\x1b[K"


class Writer(Protocol):
    """Output for progress: pytest's terminal writer, or anything like it."""

    def write(self, msg: str, *, flush: bool = False) -> None:
        """Write `msg`."""


class ProgressLine:
    """Callable as ``progress(what, done, of)``; draws at most five times a second."""

    def __init__(self, writer: Writer, *, shown: bool) -> None:
        self._writer = writer
        self._shown = shown
        self._what = ""
        self._started_s = 0.0
        self._drawn_s = 0.0

    def __call__(self, what: str, done: int, of: int) -> None:
        """Show that `done` of `of` steps of `what` are over."""
        if not self._shown:
            return
        now_s = time.monotonic()
        if what != self._what or done == 0:
            self._what, self._started_s = what, now_s
        if done >= of:
            self._draw("")
        elif now_s - self._drawn_s >= _REDRAW_S:
            self._drawn_s = now_s
            self._draw(progress_text(what, done, of, elapsed_s=now_s - self._started_s))

    def clear(self) -> None:
        """Take the line away, however far the work is."""
        if self._shown:
            self._draw("")

    def _draw(self, text: str) -> None:
        self._writer.write(f"{_SAVE}{text}{_CLEAR}{_RESTORE}", flush=True)


def progress_text(what: str, done: int, of: int, *, elapsed_s: float) -> str:
    """Return one line of progress, with the time left once a step has been timed.

    Examples
    --------
    >>> progress_text("known angles", 15, 60, elapsed_s=2.0)
    '  known angles 15 of 60, 6 s left'
    """
    if done == 0:
        return f"  {what} 0 of {of}"
    left_s = elapsed_s / done * (of - done)
    return f"  {what} {done} of {of}, {left_s:.0f} s left"
