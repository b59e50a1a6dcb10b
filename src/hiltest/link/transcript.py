"""Bytes on the line in both directions, with the time of the board's clock; and the other questions of a recorded run.

On disk a transcript is JSON lines: a header with schema and clock, then one entry a
line, ``{"t": seconds, "dir": ">", "hex": "7e01..."}``, or ``{"t": seconds, "mark": "text"}``.

The transcript of a recorded run has the run in its header, under ``recorded``, and two more kinds of entry: a question
to the bench other than bytes, with its answer, ``{"t": seconds, "call": "stage.turn_to", "given": {...}, "gives": ...,
"until": seconds}`` (or ``raises``), and a reading of the host's clock, ``{"t": seconds, "dir": "@"}``. A read of the
line without bytes is recorded too. A file whose name ends in ``.gz`` is compressed with gzip.
"""

from __future__ import annotations

import gzip
import io
import json
import math
import zlib
from collections import deque
from collections.abc import Callable, Iterator, Mapping, MutableSequence
from dataclasses import dataclass
from enum import StrEnum
from hashlib import sha256
from pathlib import Path
from typing import Any, Self

from hiltest.budgets import LINE, RECORDING, BudgetError, count_separators
from hiltest.errors import ConfigError
from hiltest.json_files import parse_json, read_pieces

SCHEMA = "hiltest.transcript/1"
END = "end"
"""Text of the mark at the end of a recorded run's transcript."""

_OTHERWISE = "name a recording (JSON lines)"
_FIRST_LINE = 2  # line of the first entry, after the header
_GZIP = b"\x1f\x8b"
_UNPACKED_BYTES = 1 << 20  # that are in memory at once
_ENTRY_BYTES = 8  # bytes that an entry's time counts towards the limit, so that single-byte entries are bounded too


class Direction(StrEnum):
    """Direction of bytes, or a note of the host."""

    TO_BOARD = ">"
    TO_HOST = "<"
    MARK = "#"
    CALL = "!"
    CLOCK = "@"


@dataclass(frozen=True, slots=True)
class TranscriptEntry:
    """Bytes that were written or read in one piece, the text of a mark, a call, or a clock's reading."""

    time_s: float
    direction: Direction
    data: bytes = b""
    call: Mapping[str, Any] | None = None
    """A question other than bytes, with its answer; begins with its name. Other entries have none."""


class Transcript:
    """A growing list of entries.

    Parameters
    ----------
    clock
        ``virtual`` or ``wall``: clock of `TranscriptEntry.time_s`. The session that fills an empty transcript sets it.

    Attributes
    ----------
    recorded : dict or None
        Description of a recorded run from its header, unchecked.
    sha256 : str
        Digest of the file that it was read from.
    """

    def __init__(self, clock: str = "") -> None:
        self.clock = clock
        self.recorded: dict[str, Any] | None = None
        self.sha256 = ""
        self.entries: MutableSequence[TranscriptEntry] = []

    def add(self, time_s: float, direction: Direction, data: bytes) -> None:
        """Append an entry."""
        self.entries.append(TranscriptEntry(time_s, direction, data))

    def mark(self, time_s: float, text: str) -> None:
        """Add a note between the bytes, such as the name of a test."""
        self.add(time_s, Direction.MARK, text.encode())

    def placed(self) -> Iterator[tuple[int, str, TranscriptEntry]]:
        """Yield each entry with its line in the file, and the latest mark, which is its test."""
        test = ""
        for line, entry in enumerate(self.entries, _FIRST_LINE):
            if entry.direction is Direction.MARK:
                test = entry.data.decode(errors="replace")
            yield line, test, entry

    def write(self, path: Path) -> None:
        """Write the transcript to a file."""
        with TranscriptFile(path, self.clock) as file:
            for entry in self.entries:
                file.add(entry)

    @classmethod
    def read(cls, path: Path) -> Transcript:
        """Read a file from `write`.

        Raises
        ------
        ConfigError
            When the file is not a transcript; the message has file, line and reason.
        """
        for _ in _texts(path):  # refuse a file over its budget before any of it becomes an object
            pass
        digest = sha256()
        lines = (line for text in _texts(path, digest.update) for line in text.splitlines())
        try:
            header = parse_json(next(lines, b"{}"), LINE)
            if header.get("schema") != SCHEMA:
                raise ConfigError(f"{path}:1: schema is {header.get('schema')!r}, not {SCHEMA!r}")
            transcript = cls(str(header["clock"]))
            transcript.recorded = header.get("recorded")
        except (ValueError, AttributeError, KeyError) as error:
            raise ConfigError(f"{path}:1: no transcript header: {error}") from None
        for number, line in enumerate(lines, _FIRST_LINE):
            try:
                transcript.entries.append(_entry(parse_json(line, LINE)))
            except (ValueError, AttributeError, KeyError, TypeError) as error:
                raise ConfigError(f"{path}:{number}: not an entry: {error}") from None
        transcript.sha256 = digest.hexdigest()
        return transcript


class LatestTranscript(Transcript):
    """A transcript of bounded size that drops its oldest entries.

    Parameters
    ----------
    most_bytes
        Maximum number of bytes of the line, which also bounds the entries.

    Attributes
    ----------
    dropped_bytes : int
        Number of bytes that were dropped since `restart`.
    """

    def __init__(self, *, most_bytes: int) -> None:
        super().__init__()
        self._most_bytes = most_bytes
        self._latest: deque[TranscriptEntry] = deque()
        self.entries = self._latest
        self.restart()

    def restart(self) -> None:
        """Clear all entries."""
        self._latest.clear()
        self._weight = 0
        self.dropped_bytes = 0

    def add(self, time_s: float, direction: Direction, data: bytes) -> None:
        """Append an entry, and drop the oldest that no longer fit."""
        self._latest.append(TranscriptEntry(time_s, direction, data))
        self._weight += len(data) + _ENTRY_BYTES
        while self._weight > self._most_bytes and len(self._latest) > 1:
            oldest = self._latest.popleft()
            self._weight -= len(oldest.data) + _ENTRY_BYTES
            self.dropped_bytes += len(oldest.data)


class TranscriptFile:
    """The file of a growing transcript, which is complete up to any end of the program.

    Parameters
    ----------
    path
        Path; compressed if its name ends in ``.gz``.
    clock
        See `Transcript`.
    recorded
        Description of a recorded run.

    Raises
    ------
    ConfigError
        When the file cannot be written.
    """

    def __init__(self, path: Path, clock: str, recorded: Mapping[str, Any] | None = None) -> None:
        self._path = path
        try:
            self._bytes = path.open("wb")
        except OSError as error:
            raise self._write_error(error) from error
        # Without name and time, so that equal transcripts are equal files.
        packed = gzip.GzipFile("", "wb", fileobj=self._bytes, mtime=0) if path.name.endswith(".gz") else self._bytes
        self._file = io.TextIOWrapper(packed, encoding="utf-8")
        about = {} if recorded is None else {"recorded": recorded}
        self._write(json.dumps({"schema": SCHEMA, "clock": clock, **about}))

    def add(self, entry: TranscriptEntry) -> None:
        """Append an entry."""
        self._write(_line(entry))

    def flush(self) -> None:
        """Flush added entries to the system."""
        try:
            self._file.flush()
        except OSError as error:
            raise self._write_error(error) from error

    def close(self) -> None:
        """Close the file. Idempotent."""
        try:
            with self._bytes:
                self._file.close()
        except OSError as error:
            raise self._write_error(error) from error

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    def _write(self, line: str) -> None:
        try:
            self._file.write(line + "\n")
        except OSError as error:
            raise self._write_error(error) from error

    def _write_error(self, error: OSError) -> ConfigError:
        return ConfigError(f"cannot write {self._path}: {error.strerror or error}; name another file")


def _texts(path: Path, take: Callable[[bytes], object] = bytes) -> Iterator[bytes]:
    """Yield the uncompressed lines of a file, many at once; of a truncated one, as after SIGKILL, the intact ones.

    `take` is called with the bytes of the file.
    """
    unzip, rest, size, items = None, b"", 0, 0
    for number, piece in enumerate(read_pieces(path, RECORDING, otherwise=_OTHERWISE)):
        take(piece)
        if number == 0 and piece.startswith(_GZIP):
            unzip = zlib.decompressobj(wbits=31)
        while piece:
            try:
                text = piece if unzip is None else unzip.decompress(piece, _UNPACKED_BYTES)
                size, items = size + len(text), items + count_separators(text)
                RECORDING.check(size=size, items=items)
                LINE.check(size=len(rest))
            except BudgetError as error:
                raise ConfigError(f"{path}: {error}; {_OTHERWISE}") from error
            except zlib.error as error:
                raise ConfigError(f"{path}: damaged: {error}; {_OTHERWISE}") from error
            piece = b"" if unzip is None else unzip.unconsumed_tail
            text = rest + text
            end = text.rfind(b"\n") + 1
            rest = text[end:]
            yield text[:end]
    if unzip is None or unzip.eof:
        yield rest


def _line(entry: TranscriptEntry) -> str:
    if entry.call is not None:
        content = dict(entry.call)
    elif entry.direction is Direction.MARK:
        content = {"mark": entry.data.decode()}
    else:
        content = {"dir": str(entry.direction)}
        if entry.direction is not Direction.CLOCK:
            content["hex"] = entry.data.hex()
    return json.dumps({"t": entry.time_s, **content}, allow_nan=False)


def _entry(item: dict[str, object]) -> TranscriptEntry:
    time_s = float(str(item["t"]))
    if not math.isfinite(time_s):
        raise ValueError(f"t is {time_s}")
    if "mark" in item:
        return TranscriptEntry(time_s, Direction.MARK, str(item["mark"]).encode())
    if "call" in item:
        if not isinstance(item["call"], str) or not isinstance(item.get("given", {}), dict):
            raise ValueError("call is not a name, or its arguments are not a table")
        call = {key: value for key, value in item.items() if key != "t"}
        return TranscriptEntry(time_s, Direction.CALL, call=call)
    if item["dir"] == Direction.CLOCK:
        return TranscriptEntry(time_s, Direction.CLOCK)
    return TranscriptEntry(time_s, Direction(str(item["dir"])), bytes.fromhex(str(item["hex"])))
