"""Bytes on the line in both directions, with the time of the board's clock; and of a recorded run all else.

On disk a transcript is JSON lines: a header with schema and clock, then one entry a
line, ``{"t": seconds, "dir": ">", "hex": "7e01..."}``, or ``{"t": seconds, "mark": "text"}``.

The transcript of a recorded run has the run in its header, under ``recorded``, and two more kinds of entry: a question
to the bench that is no bytes, with its answer, ``{"t": seconds, "call": "stage.turn_to", "given": {...}, "gives": ...,
"until": seconds}`` (or ``raises``), and a reading of the host's clock, ``{"t": seconds, "dir": "@"}``. A read of the
line that brought nothing is there too. A file whose name ends in ``.gz`` is compressed with gzip.
"""

from __future__ import annotations

import gzip
import io
import json
import math
import zlib
from collections import deque
from collections.abc import Iterable, Iterator, Mapping, MutableSequence
from dataclasses import dataclass
from enum import StrEnum
from hashlib import sha256
from pathlib import Path
from types import TracebackType
from typing import Any, Self

from hiltest.errors import ConfigError
from hiltest.strict_json import parse_json, read_bounded

SCHEMA = "hiltest.transcript/1"
END = "end"
"""Text of the mark with which the transcript of a recorded run ends."""

_LARGEST_BYTES = 256 << 20  # two bytes of text for one of the line: three hours at 115 200 baud, without a pause
_FIRST_LINE = 2  # of an entry: the header has the first
_GZIP = b"\x1f\x8b"
_ENTRY_BYTES = 8  # an entry's time, in what a transcript may hold: single bytes must not cost nothing


class Direction(StrEnum):
    """Direction of bytes, or a note of the host."""

    TO_BOARD = ">"
    TO_HOST = "<"
    MARK = "#"
    CALL = "!"
    CLOCK = "@"


@dataclass(frozen=True, slots=True)
class TranscriptEntry:
    """Bytes that were written or read in one piece, the text of a mark, a call as JSON; a clock's reading has none."""

    time_s: float
    direction: Direction
    data: bytes


class Transcript:
    """A growing list of entries.

    Parameters
    ----------
    clock
        ``virtual`` or ``wall``: what `TranscriptEntry.time_s` counts. The session that fills an
        empty one says it.

    Attributes
    ----------
    recorded : dict or None
        Of a recorded run, what its header says of it; not checked.
    sha256 : str
        Of the file that it was read from.
    """

    def __init__(self, clock: str = "", entries: Iterable[TranscriptEntry] = ()) -> None:
        self.clock = clock
        self.recorded: dict[str, Any] | None = None
        self.sha256 = ""
        self.entries: MutableSequence[TranscriptEntry] = list(entries)

    def add(self, time_s: float, direction: Direction, data: bytes) -> None:
        """Append an entry."""
        self.entries.append(TranscriptEntry(time_s, direction, data))

    def mark(self, time_s: float, text: str) -> None:
        """Note something beside the bytes, such as the name of a test."""
        self.add(time_s, Direction.MARK, text.encode())

    def placed(self) -> Iterator[tuple[int, str, TranscriptEntry]]:
        """Yield each mark and entry with its line in the file, and the latest mark: the test that it belongs to."""
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
        """Read what `write` wrote.

        Raises
        ------
        ConfigError
            When the file is no transcript; names file, line and what is wrong.
        """
        content = read_bounded(path, largest_bytes=_LARGEST_BYTES, otherwise="name a transcript (JSON lines)")
        try:
            lines = _text(content, path).decode("utf-8").splitlines()
            header = parse_json(lines[0]) if lines else {}
            if header.get("schema") != SCHEMA:
                raise ConfigError(f"{path}:1: schema is {header.get('schema')!r}, not {SCHEMA!r}")
            transcript = cls(str(header["clock"]))
            transcript.recorded, transcript.sha256 = header.get("recorded"), sha256(content).hexdigest()
        except (ValueError, AttributeError, KeyError) as error:
            raise ConfigError(f"{path}:1: no transcript header: {error}") from None
        for number, line in enumerate(lines[1:], _FIRST_LINE):
            try:
                transcript.entries.append(_entry(parse_json(line)))
            except (ValueError, AttributeError, KeyError, TypeError) as error:
                raise ConfigError(f"{path}:{number}: not an entry: {error}") from None
        return transcript


class LatestTranscript(Transcript):
    """A transcript that forgets what is old, so that it never grows beyond a size.

    Parameters
    ----------
    most_bytes
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


class TranscriptFile:
    """The file of a transcript that grows: what has happened is in it, whatever ends the program.

    Parameters
    ----------
    path
        Compressed where its name ends in ``.gz``.
    clock
        As `Transcript` has it.
    recorded
        Of a recorded run.

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
            raise self._refused(error) from error
        # Without name and time: equal transcripts are equal files.
        packed = gzip.GzipFile("", "wb", fileobj=self._bytes, mtime=0) if path.name.endswith(".gz") else self._bytes
        self._file = io.TextIOWrapper(packed, encoding="utf-8")
        about = {} if recorded is None else {"recorded": recorded}
        self._write(json.dumps({"schema": SCHEMA, "clock": clock, **about}))

    def add(self, entry: TranscriptEntry) -> None:
        """Append an entry."""
        self._write(_line(entry))

    def flush(self) -> None:
        """Give what was added to the system."""
        try:
            self._file.flush()
        except OSError as error:
            raise self._refused(error) from error

    def close(self) -> None:
        """Close the file. Idempotent."""
        try:
            with self._bytes:
                self._file.close()
        except OSError as error:
            raise self._refused(error) from error

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.close()

    def _write(self, line: str) -> None:
        try:
            self._file.write(line + "\n")
        except OSError as error:
            raise self._refused(error) from error

    def _refused(self, error: OSError) -> ConfigError:
        return ConfigError(f"cannot write {self._path}: {error.strerror or error}; name another file")


def _text(content: bytes, path: Path) -> bytes:
    """Return what a file holds, uncompressed; of one that was cut, as by SIGKILL, what is there."""
    if not content.startswith(_GZIP):
        return content
    unzip = zlib.decompressobj(wbits=31)
    try:
        text = unzip.decompress(content, _LARGEST_BYTES)
    except zlib.error as error:
        raise ConfigError(f"{path}: damaged: {error}; name a transcript (JSON lines)") from error
    if unzip.unconsumed_tail:
        raise ConfigError(f"{path}: larger than {_LARGEST_BYTES} bytes; name a transcript (JSON lines)")
    return text if unzip.eof else text[: text.rfind(b"\n") + 1]


def _line(entry: TranscriptEntry) -> str:
    if entry.direction is Direction.MARK:
        return json.dumps({"t": entry.time_s, "mark": entry.data.decode()})
    if entry.direction is Direction.CALL:
        return f'{{"t": {entry.time_s!r}, {entry.data.decode()[1:]}'
    if entry.direction is Direction.CLOCK:
        return json.dumps({"t": entry.time_s, "dir": str(entry.direction)})
    return json.dumps({"t": entry.time_s, "dir": str(entry.direction), "hex": entry.data.hex()})


def call_entry(time_s: float, call: Mapping[str, Any]) -> TranscriptEntry:
    """Return the entry of a question that is no bytes, with its answer; `call` begins with its name."""
    text = json.dumps(call, allow_nan=False)
    return TranscriptEntry(time_s, Direction.CALL, text.encode())


def _entry(item: dict[str, object]) -> TranscriptEntry:
    time_s = float(str(item["t"]))
    if not math.isfinite(time_s):
        raise ValueError(f"t is {time_s}")
    if "mark" in item:
        return TranscriptEntry(time_s, Direction.MARK, str(item["mark"]).encode())
    if "call" in item:
        if not isinstance(item["call"], str) or not isinstance(item.get("given", {}), dict):
            raise ValueError("call is no name, or given no table")
        return call_entry(time_s, {key: value for key, value in item.items() if key != "t"})
    if item["dir"] == Direction.CLOCK:
        return TranscriptEntry(time_s, Direction.CLOCK, b"")
    return TranscriptEntry(time_s, Direction(str(item["dir"])), bytes.fromhex(str(item["hex"])))
