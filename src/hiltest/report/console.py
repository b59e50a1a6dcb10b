"""The console for tables: a terminal, or a pipe of unknown width."""

from __future__ import annotations

import sys

from rich.console import Console

# Wider than any table: in a file or a pipe nothing is cut, and each sentence stays on one line for searching.
_FILE_WIDTH = 200


def standard_output() -> Console:
    """Return standard output as a console without automatic highlighting."""
    return Console(highlight=False, width=None if sys.stdout.isatty() else _FILE_WIDTH)
