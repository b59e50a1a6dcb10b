"""The progress of long work while pytest captures what tests print."""

from __future__ import annotations

import sys
from collections.abc import Callable
from contextlib import AbstractContextManager, nullcontext

import pytest

from hiltest.progress_line import ProgressLine, TextOutput


def progress_of(config: pytest.Config) -> ProgressLine:
    """Return what shows progress on pytest's terminal; in a worker, which has none, nothing does."""
    terminal: pytest.TerminalReporter | None = config.pluginmanager.get_plugin("terminalreporter")
    if terminal is None:
        return ProgressLine(TextOutput(sys.stdout), shown=False)
    capture = config.pluginmanager.get_plugin("capturemanager")
    uncaptured = nullcontext if capture is None else capture.global_and_fixture_disabled
    writer = terminal._tw

    def say(line: str) -> None:
        """Print a line of its own; pytest goes on behind it."""
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
