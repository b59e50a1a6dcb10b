"""Progress of long work at the end of the terminal's current line, also while pytest captures what tests print."""

from __future__ import annotations

import sys
import time
from collections.abc import Callable
from contextlib import AbstractContextManager, nullcontext
from shutil import get_terminal_size
from typing import TYPE_CHECKING, Protocol, TextIO

if TYPE_CHECKING:
    import pytest

_REDRAW_S = 0.2
_SAY_AGAIN_S = 30.0  # a run of the default bench says nothing, a run on a slow machine a line or two
# VT100: keep and restore the cursor, clear to the end of the line. What is shown thus
# never disturbs what pytest has written on the line.
_SAVE, _RESTORE, _CLEAR = "\x1b7", "\x1b8", "\x1b[K"


class Writer(Protocol):
    """Output for progress: pytest's terminal writer, or anything like it."""

    def write(self, msg: str, *, flush: bool = False) -> None:
        """Write `msg`."""


class TextOutput:
    """A file as a writer."""

    def __init__(self, file: TextIO) -> None:
        self._file = file

    def write(self, msg: str, *, flush: bool = False) -> None:
        """Write `msg`."""
        self._file.write(msg)
        if flush:
            self._file.flush()


class ProgressLine:
    """Callable as ``progress(what, done, of)``.

    Parameters
    ----------
    writer
        The terminal.
    shown
        Whether it is one: then the progress is drawn behind what stands on the line, five times a second at most.
    say
        Where it is none, this prints a line of its own, every half minute at most.
    room
        Returns how many columns are left on the current line; by default all but one of the terminal's.
    """

    def __init__(
        self, writer: Writer, *, shown: bool, say: Callable[[str], None] | None = None,
        room: Callable[[], int] | None = None,
    ) -> None:
        self._writer = writer
        self._shown = shown
        self._say = say
        self._room = room or (lambda: get_terminal_size().columns - 1)
        self._what = ""
        self._started_s = self._drawn_s = 0.0
        self._said_s = time.monotonic()
        self._is_drawn = False

    def __call__(self, what: str, done: int, of: int, note: str = "") -> None:
        """Show that `done` of `of` steps of `what` are over, and a note behind it."""
        now_s = time.monotonic()
        if what != self._what or done == 0:
            self._what, self._started_s = what, now_s
        if done >= of:
            self.clear()
            return
        text = progress_text(what, done, of, elapsed_s=now_s - self._started_s)
        text += f"; {note}" if note else ""
        if self._shown and now_s - self._drawn_s >= _REDRAW_S:
            self._drawn_s = now_s
            self.draw(text)
        elif not self._shown and self._say is not None and now_s - self._said_s >= _SAY_AGAIN_S:
            self._said_s = now_s
            self._say(text.strip())

    def clear(self) -> None:
        """Remove the line."""
        if self._is_drawn:
            self.draw("")

    def draw(self, text: str) -> None:
        """Draw a text behind what stands on the line, in place of what was drawn there before."""
        self._is_drawn = bool(text)
        shown = text[: max(self._room(), 0)]  # a line that wraps would move what stands above it
        self._writer.write(f"{_SAVE}{shown}{_CLEAR}{_RESTORE}", flush=True)


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


def progress_of(config: pytest.Config) -> ProgressLine:
    """Return what shows progress on pytest's terminal; in a worker, which has none, nothing does."""
    terminal: pytest.TerminalReporter | None = config.pluginmanager.get_plugin("terminalreporter")
    if terminal is None:
        return ProgressLine(TextOutput(sys.stdout), shown=False)
    capture = config.pluginmanager.get_plugin("capturemanager")
    uncaptured = nullcontext if capture is None else capture.global_and_fixture_disabled
    writer = terminal._tw

    def say(line: str) -> None:
        """Print a line of its own; pytest goes on after it."""
        with uncaptured():
            if writer.width_of_current_line:
                writer.line()
            terminal.write_line(line)
            terminal.flush()

    return ProgressLine(
        # Past pytest's writer: what that counts as part of the line would move its own words.
        _Uncaptured(TextOutput(writer._file), uncaptured), shown=writer.hasmarkup, say=say,
        room=lambda: writer.fullwidth - writer.width_of_current_line - 1,
    )


class _Uncaptured:
    """Writes to the terminal while a test's output is captured."""

    def __init__(self, output: TextOutput, uncaptured: Callable[[], AbstractContextManager[None]]) -> None:
        self._output = output
        self._uncaptured = uncaptured

    def write(self, msg: str, *, flush: bool = False) -> None:
        """Write a text."""
        with self._uncaptured():
            self._output.write(msg, flush=flush)
