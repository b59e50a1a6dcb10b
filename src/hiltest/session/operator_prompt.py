"""Prompts to the operator at the terminal."""

from __future__ import annotations

import os
import select
import sys
from collections.abc import Callable
from contextlib import suppress
from shutil import get_terminal_size

# Interval between updates of the text beside a question; an update itself takes some time [s].
_LOOK_S = 0.2


def ask(text: str) -> str:
    """Show a text and return the line that was typed.

    Parameters
    ----------
    text
        Text of the prompt. On a terminal, keys that were pressed before are discarded, and the live part of a
        `Question` is shown after the text and updated until the line is typed.

    Raises
    ------
    OperatorAbsentError
        If there is no terminal to ask at.
    """
    live = getattr(text, "live", None)
    _discard_typed_ahead()
    try:
        return input(text) if live is None or not _is_terminal() else _ask_with_live_text(text, live)
    except (EOFError, OSError, RuntimeError) as error:  # RuntimeError: standard input is closed
        from hiltest.errors import OperatorAbsentError

        raise OperatorAbsentError.asked(text) from error


def _discard_typed_ahead() -> None:
    """Discard the keys that were pressed before a question: they answer none."""
    with suppress(ImportError, ValueError, OSError):  # no terminal: another system, a file, or closed
        import termios

        if sys.stdin is not None and sys.stdin.isatty():
            termios.tcflush(sys.stdin.fileno(), termios.TCIFLUSH)


def _is_terminal() -> bool:
    return sys.stdin is not None and sys.stdin.isatty() and sys.stdout.isatty()


def _ask_with_live_text(text: str, live: Callable[[], str]) -> str:
    """Ask, and draw the live text at the cursor, after the characters that were typed so far."""
    from hiltest.session.progress_line import ProgressLine, TextOutput

    room = get_terminal_size().columns - len(text.rpartition("\n")[2]) - 1
    beside = ProgressLine(TextOutput(sys.stdout), shown=True, room=lambda: room)
    sys.stdout.write(text)
    sys.stdout.flush()
    keyboard = sys.stdin.fileno()
    while not select.select([keyboard], [], [], _LOOK_S)[0]:
        beside.draw(f"  {live()}")
    typed = os.read(keyboard, 4096)  # a terminal delivers whole lines; select does not see what Python buffers
    if not typed:
        raise EOFError
    return typed.decode(sys.stdin.encoding or "utf-8", "replace").rstrip("\n")
