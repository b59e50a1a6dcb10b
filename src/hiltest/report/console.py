"""The console that tables are printed on: a terminal, or a pipe of unknown width."""

from __future__ import annotations

import sys

from rich.console import Console

# Wider than any table here: in a file or a pipe nothing is cut, and a sentence stays on its line, so that it is found.
_FILE_WIDTH = 200


def standard_output() -> Console:
    """Return standard output as a console without automatic highlighting."""
    return Console(highlight=False, width=None if sys.stdout.isatty() else _FILE_WIDTH)
