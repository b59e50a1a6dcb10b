"""The bytes on the line during one test, which are written to the run's folder if the test fails."""

from __future__ import annotations

import re
from collections import deque
from contextlib import suppress
from hashlib import sha256
from pathlib import Path

from hiltest.errors import ConfigError
from hiltest.link.transcript import SCHEMA, LatestTranscript
from hiltest.path_names import path_below

FOLDER = "traces"

_MOST_BYTES = 256 * 1024  # twenty seconds of a full line at 115200 baud
_LONGEST_NAME = 100
# Every test that needs a failed set-up requests it again; this is the number of remembered failures.
_FAILURES_KEPT = 32


class WireTraces:
    """The latest bytes on the line since the beginning of the running test.

    Parameters
    ----------
    out
        Folder of the run.

    Attributes
    ----------
    transcript : LatestTranscript
        Transcript that the link's session fills.
    """

    def __init__(self, out: Path) -> None:
        self.transcript = LatestTranscript(most_bytes=_MOST_BYTES)
        self._out = out
        self._written: deque[tuple[BaseException, str]] = deque(maxlen=_FAILURES_KEPT)

    def begin(self) -> None:
        """Discard earlier bytes at the beginning of a test."""
        self.transcript.restart()

    def keep(self, test: str, phase: str, error: BaseException, *, about: str) -> str:
        """Write the bytes that were on the line before a failure.

        Parameters
        ----------
        test
            Test that the bytes belong to; it determines the names of the files.
        phase
            Phase of the test that failed. A fixture's set-up fails once and is charged to every test that
            needs it: all of them refer to the first test's file.
        error
            Exception of the failure.
        about
            Description of the board, for the heading.

        Returns
        -------
        str
            The text file, relative to the run's folder; empty if the line was silent.
        """
        for stored_error, name in self._written:
            if stored_error is error:
                return name
        if not self.transcript.entries:
            return ""
        name = f"{FOLDER}/{file_name(test)}.txt"
        if not self._write(name, f"wire trace of {test}, until its {phase} failed", about):
            return ""
        if phase != "call":
            self._written.append((error, name))
        return name

    def _write(self, name: str, heading: str, about: str) -> bool:
        from hiltest.link.trace_text import trace_lines

        cut = self.transcript.dropped_bytes
        head = [heading, f"{about}; {self.transcript.clock} time of the board [s], > to the board, < to the host"]
        if cut:
            head.append(f"cut: {cut} earlier bytes were dropped")
        lines = [*(f"# {line}" for line in head), *trace_lines(self.transcript)]
        try:
            path = path_below(self._out, name, remedy="remove it")
            path.parent.mkdir(parents=True, exist_ok=True)
            path.write_text("\n".join(lines) + "\n", encoding="utf-8")
            self.transcript.write(path.with_suffix(".jsonl"))
        except (ConfigError, OSError):
            return False  # a link, or a full disk: the test's own failure must be reported
        return True


def file_name(test: str) -> str:
    """Return a file name for a test's id; different ids have different names.

    Examples
    --------
    >>> file_name("test_link.py::test_answers")
    'test_link.py-test_answers-5811d9'
    """
    plain = re.sub(r"[^A-Za-z0-9_.]+", "-", test).strip("-.")[-_LONGEST_NAME:]
    return f"{plain}-{sha256(test.encode()).hexdigest()[:6]}"


def remove_traces(out: Path) -> None:
    """Remove the traces of an earlier run, and nothing else, from a run's folder."""
    folder = out / FOLDER
    with suppress(OSError):
        for path in folder.glob("*.jsonl"):
            with path.open("rb") as file:
                ours = SCHEMA.encode() in file.readline(200)
            if ours:
                path.unlink()
                path.with_suffix(".txt").unlink(missing_ok=True)
        folder.rmdir()
