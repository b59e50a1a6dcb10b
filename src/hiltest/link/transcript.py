"""Bytes on the line in both directions, with the time of the board's clock.

On disk a transcript is JSON lines: a header with schema and clock, then one entry a
line, ``{"t": seconds, "dir": ">", "hex": "7e01..."}``, or ``{"t": seconds, "mark": "text"}``.
"""

from __future__ import annotations

import json
from collections import deque
from collections.abc import Iterable, MutableSequence
from dataclasses import dataclass
from enum import StrEnum
from pathlib import Path

from hiltest.errors import ConfigError
from hiltest.strict_json import read_bounded

SCHEMA = "hiltest.transcript/1"

_LARGEST_BYTES = 256 << 20  # two bytes of text for one of the line: three hours at 115 200 baud, without a pause
_ENTRY_BYTES = 8  # an entry's time, in what a transcript may hold: single bytes must not cost nothing


class Direction(StrEnum):
    """Direction of bytes, or a note of the host."""

    TO_BOARD = ">"
    TO_HOST = "<"
    MARK = "#"


@dataclass(frozen=True, slots=True)
class TranscriptEntry:
    """Bytes that were written or read in one piece, or the text of a mark."""

    time_s: float
    direction: Direction
    data: bytes


class Transcript:
    """A growing list of entries.

    Parameters
    ----------
    clock : str
        ``virtual`` or ``wall``: what `TranscriptEntry.time_s` counts. The session that fills an
        empty one says it.
    """

    def __init__(self, clock: str = "", entries: Iterable[TranscriptEntry] = ()) -> None:
        self.clock = clock
        self.entries: MutableSequence[TranscriptEntry] = list(entries)

    def add(self, time_s: float, direction: Direction, data: bytes) -> None:
        """Append an entry."""
        self.entries.append(TranscriptEntry(time_s, direction, data))

    def mark(self, time_s: float, text: str) -> None:
        """Note something beside the bytes, such as the name of a test."""
        self.add(time_s, Direction.MARK, text.encode())

    def write(self, path: Path) -> None:
        """Write the transcript to a file."""
        with path.open("w", encoding="utf-8") as file:
            file.write(json.dumps({"schema": SCHEMA, "clock": self.clock}) + "\n")
            file.writelines(_line(entry) + "\n" for entry in self.entries)

    @classmethod
    def read(cls, path: Path) -> Transcript:
        """Read what `write` wrote.

        Raises
        ------
        ConfigError
            When the file is no transcript; names file, line and what is wrong.
        """
        content = read_bounded(path, largest_bytes=_LARGEST_BYTES, otherwise="name a transcript (JSON lines)")
        try:
            lines = content.decode("utf-8").splitlines()
            header = json.loads(lines[0]) if lines else {}
            if header.get("schema") != SCHEMA:
                raise ConfigError(f"{path}:1: schema is {header.get('schema')!r}, not {SCHEMA!r}")
            transcript = cls(str(header["clock"]))
        except (ValueError, AttributeError, KeyError) as error:
            raise ConfigError(f"{path}:1: no transcript header: {error}") from None
        for number, line in enumerate(lines[1:], start=2):
            try:
                transcript.entries.append(_entry(json.loads(line)))
            except (ValueError, AttributeError, KeyError, TypeError) as error:
                raise ConfigError(f"{path}:{number}: not an entry: {error}") from None
        return transcript


class LatestTranscript(Transcript):
    """A transcript that forgets what is old, so that it never grows beyond a size.

    Parameters
    ----------
    most_bytes : int
        How many bytes of the line are kept; the entries are bounded with them.

    Attributes
    ----------
    dropped_bytes : int
        What was forgotten since `restart`.
    """

    def __init__(self, *, most_bytes: int) -> None:
        super().__init__()
        self._most_bytes = most_bytes
        self._latest: deque[TranscriptEntry] = deque()
        self.entries = self._latest
        self.restart()

    def restart(self) -> None:
        """Forget everything."""
        self._latest.clear()
        self._weight = 0
        self.dropped_bytes = 0

    def add(self, time_s: float, direction: Direction, data: bytes) -> None:
        """Append an entry, and forget the oldest that no longer fit."""
        self._latest.append(TranscriptEntry(time_s, direction, data))
        self._weight += len(data) + _ENTRY_BYTES
        while self._weight > self._most_bytes and len(self._latest) > 1:
            oldest = self._latest.popleft()
            self._weight -= len(oldest.data) + _ENTRY_BYTES
            self.dropped_bytes += len(oldest.data)


def _line(entry: TranscriptEntry) -> str:
    if entry.direction is Direction.MARK:
        return json.dumps({"t": entry.time_s, "mark": entry.data.decode()})
    return json.dumps({"t": entry.time_s, "dir": str(entry.direction), "hex": entry.data.hex()})


def _entry(item: dict[str, object]) -> TranscriptEntry:
    time_s = float(str(item["t"]))
    if "mark" in item:
        return TranscriptEntry(time_s, Direction.MARK, str(item["mark"]).encode())
    return TranscriptEntry(time_s, Direction(str(item["dir"])), bytes.fromhex(str(item["hex"])))
