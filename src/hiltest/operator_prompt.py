"""Prompts to the operator at the terminal."""

from __future__ import annotations

import os
import select
import sys
from collections.abc import Callable
from shutil import get_terminal_size

# Between two looks at what stands beside a question; a look itself takes its time [s].
_LOOK_S = 0.2


def ask(text: str) -> str:
    """Show a text and return the line that was typed.

    Parameters
    ----------
    text
        What a `Question` has beside it is shown, and kept up to date, behind the text until the line is typed: at a
        terminal alone, elsewhere it is a text as any other.

    Raises
    ------
    OperatorAbsentError
        If there is no terminal to ask at.
    """
    live = getattr(text, "live", None)
    try:
        return input(text) if live is None or not _is_terminal() else _ask_beside(text, live)
    except (EOFError, OSError, RuntimeError) as error:  # RuntimeError: standard input is closed
        from hiltest.errors import OperatorAbsentError

        raise OperatorAbsentError.asked(text) from error


def _is_terminal() -> bool:
    return sys.stdin is not None and sys.stdin.isatty() and sys.stdout.isatty()


def _ask_beside(text: str, live: Callable[[], str]) -> str:
    """Ask, and draw what is beside the question where the cursor is, behind what has been typed so far."""
    from hiltest.progress_line import ProgressLine, TextOutput

    room = get_terminal_size().columns - len(text.rpartition("\n")[2]) - 1
    beside = ProgressLine(TextOutput(sys.stdout), shown=True, room=lambda: room)
    sys.stdout.write(text)
    sys.stdout.flush()
    keyboard = sys.stdin.fileno()
    while not select.select([keyboard], [], [], _LOOK_S)[0]:
        beside.draw(f"  {live()}")
    typed = os.read(keyboard, 4096)  # a terminal gives a line at a time; what Python buffers nobody could wait for
    if not typed:
        raise EOFError
    return typed.decode(sys.stdin.encoding or "utf-8", "replace").rstrip("\n")
