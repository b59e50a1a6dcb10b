"""Prompts to the operator at the terminal."""

from __future__ import annotations


def ask(text: str) -> str:
    """Show a text and return the line that was typed.

    Raises
    ------
    OperatorAbsentError
        If there is no terminal to ask at.
    """
    try:
        return input(text)
    except (EOFError, OSError, RuntimeError) as error:  # RuntimeError: standard input is closed
        from hiltest.errors import OperatorAbsentError

        raise OperatorAbsentError(
            f"no one answers at the terminal; this was asked: {text.strip()} "
            "Run it where an operator can type and turn the board."
        ) from error
