"""Prompts to the operator, at the terminal and the page."""

from __future__ import annotations

import os
import select
import sys
from collections.abc import Callable
from contextlib import suppress
from shutil import get_terminal_size
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from hiltest.session.bench_page import BenchPage

# Interval between updates of the text beside a question; an update itself takes some time, and the FIFO of a
# gyroscope is full after 0.16 s [s].
_LOOK_S = 0.02


def ask(text: str, page: BenchPage | None = None, *, is_turn: bool = False) -> str:
    """Show a text and return the line that was typed, or the answer at the page.

    Parameters
    ----------
    text
        Text of the prompt. On a terminal the live part of a `Question` is shown after it, and updated until the line is
        typed.
    page
        Page with the same question; the first answer counts.
    is_turn
        Whether the question asks for a turn of the board: keys that were pressed before are then discarded.

    Raises
    ------
    OperatorAbsentError
        If there is neither a terminal nor a page to ask at.
    """
    live = getattr(text, "live", None)
    if is_turn:
        _discard_typed_ahead()
    try:
        return input(text) if page is None and (live is None or not _is_terminal()) else _ask_live(text, live, page)
    except (EOFError, OSError, RuntimeError) as error:  # RuntimeError: standard input is closed
        from hiltest.errors import OperatorAbsentError

        raise OperatorAbsentError.asked(text) from error


def _discard_typed_ahead() -> None:
    """Discard the keys that were pressed before a question: the board was not turned for it."""
    with suppress(ImportError, ValueError, OSError):  # no terminal: another system, a file, or closed
        import termios

        if sys.stdin is not None and sys.stdin.isatty():
            termios.tcflush(sys.stdin.fileno(), termios.TCIFLUSH)


def _is_terminal() -> bool:
    return sys.stdin is not None and sys.stdin.isatty() and sys.stdout.isatty()


def _ask_live(text: str, live: Callable[[], object] | None, page: BenchPage | None) -> str:
    """Ask, and draw the live text at the cursor, after the characters that were typed so far."""
    from hiltest.session.progress_line import ProgressLine, TextOutput

    room = get_terminal_size().columns - len(text.rpartition("\n")[2]) - 1
    beside = ProgressLine(TextOutput(sys.stdout), shown=True, room=lambda: room)
    sys.stdout.write(text)
    sys.stdout.flush()
    keyboard = [sys.stdin.fileno()] if _is_terminal() else []
    if page is not None:
        page.ask(text)
    try:
        while not select.select(keyboard, [], [], _LOOK_S)[0]:
            if page is not None and (answer := page.answer()) is not None:
                sys.stdout.write(f"{answer}\n")
                return answer
            if live is not None:
                seen = live()
                if keyboard:
                    beside.draw(f"  {seen}")
                if page is not None:
                    page.look(seen)
    finally:
        if page is not None:
            page.answered()
    typed = os.read(keyboard[0], 4096)  # a terminal delivers whole lines; select does not see what Python buffers
    if not typed:
        raise EOFError
    return typed.decode(sys.stdin.encoding or "utf-8", "replace").rstrip("\n")
