"""Progress of long work at the end of the terminal's current line, even while pytest captures output."""

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
_SAY_AGAIN_S = 30.0  # a run of the default bench prints no such line, a run on a slow machine one or two
# VT100: save and restore the cursor, clear to the end of the line. These codes do not
# disturb pytest's text on the line.
_SAVE, _RESTORE, _CLEAR = "\x1b7", "\x1b8", "\x1b[K"


class Writer(Protocol):
    """Output for progress: pytest's terminal writer, or a similar object."""

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
    """Callable as ``progress(label, done, total)``.

    Parameters
    ----------
    writer
        Writer to the terminal.
    shown
        True for a terminal: the progress is drawn after the text on the line, at most five times a second.
    say
        Function that prints a separate line, at most every half minute, if there is no terminal.
    room
        Function that returns the number of free columns on the current line; by default all but one of the terminal's.
    also
        Function that receives the text of the progress as well, empty at its end.
    """

    def __init__(
        self,
        writer: Writer,
        *,
        shown: bool,
        say: Callable[[str], None] | None = None,
        room: Callable[[], int] | None = None,
        also: Callable[[str], None] = lambda text: None,
    ) -> None:
        self._also = also
        self._writer = writer
        self._shown = shown
        self._say = say
        self._room = room or (lambda: get_terminal_size().columns - 1)
        self._task = ""
        self._started_s = self._drawn_s = 0.0
        self._printed_s = time.monotonic()
        self._is_drawn = False

    def __call__(self, label: str, done: int, total: int, note: str = "") -> None:
        """Show that `done` of `total` steps of `label` are done, followed by a note."""
        now_s = time.monotonic()
        task = label.partition(",")[0]  # after it, a label tells how far the task is in other terms
        if task != self._task or done == 0:
            self._task, self._started_s = task, now_s
        if done >= total:
            self._also("")
            self.clear()
            return
        text = progress_text(label, done, total, elapsed_s=now_s - self._started_s)
        text += f"; {note}" if note else ""
        self._also(text)
        if self._shown and now_s - self._drawn_s >= _REDRAW_S:
            self._drawn_s = now_s
            self.draw(text)
        elif not self._shown and self._say is not None and now_s - self._printed_s >= _SAY_AGAIN_S:
            self._printed_s = now_s
            self._say(text.strip())

    def clear(self) -> None:
        """Remove the line."""
        if self._is_drawn:
            self.draw("")

    def draw(self, text: str) -> None:
        """Draw a text after the text on the line, and replace the one that was drawn before."""
        self._is_drawn = bool(text)
        shown = text[: max(self._room(), 0)]  # a wrapped line would scroll the lines above it
        self._writer.write(f"{_SAVE}{shown}{_CLEAR}{_RESTORE}", flush=True)


def progress_text(label: str, done: int, total: int, *, elapsed_s: float) -> str:
    """Return one line of progress, with the remaining time after the first step.

    Examples
    --------
    >>> progress_text("known angles", 15, 60, elapsed_s=2.0)
    '  known angles 15 of 60, 6 s left'
    """
    if done == 0:
        return f"  {label} 0 of {total}"
    left_s = elapsed_s / done * (total - done)
    return f"  {label} {done} of {total}, {left_s:.0f} s left"


def progress_of(config: pytest.Config, also: Callable[[str], None] = lambda text: None) -> ProgressLine:
    """Return the progress display of pytest's terminal; a worker has no terminal, and shows no progress."""
    terminal: pytest.TerminalReporter | None = config.pluginmanager.get_plugin("terminalreporter")
    if terminal is None:
        return ProgressLine(TextOutput(sys.stdout), shown=False, also=also)
    capture = config.pluginmanager.get_plugin("capturemanager")
    uncaptured = nullcontext if capture is None else capture.global_and_fixture_disabled
    writer = terminal._tw

    def say(line: str) -> None:
        """Print a separate line; pytest continues after it."""
        with uncaptured():
            if writer.width_of_current_line:
                writer.line()
            terminal.write_line(line)
            terminal.flush()

    return ProgressLine(
        # The output bypasses pytest's writer, which would otherwise count it as part of the line.
        _UncapturedOutput(TextOutput(writer._file), uncaptured),
        shown=writer.hasmarkup,
        say=say,
        room=lambda: writer.fullwidth - writer.width_of_current_line - 1,
        also=also,
    )


class _UncapturedOutput:
    """Writes to the terminal while a test's output is captured."""

    def __init__(self, output: TextOutput, uncaptured: Callable[[], AbstractContextManager[None]]) -> None:
        self._output = output
        self._uncaptured = uncaptured

    def write(self, msg: str, *, flush: bool = False) -> None:
        """Write a text."""
        with self._uncaptured():
            self._output.write(msg, flush=flush)
