"""Lines of text of any file, within bounds."""

from __future__ import annotations

import gzip
import io
import math
import re
import zlib
from collections.abc import Iterator
from pathlib import Path
from typing import BinaryIO, NamedTuple, cast

from hiltest.budgets import TABLE, TABLE_DOCUMENT, Budget, BudgetError
from hiltest.errors import ConfigError

# Bytes of a file that are in memory at once: a table line is far shorter, and other files must not fill the memory.
_LONGEST_LINE = 65_536
# Smallest part of these that is offered at once: some lines of a table.
_LEAST_AHEAD = 512
# Lines after a wrong byte in which a binary file has a zero byte: a PNG has one in the third.
_LINES_OF_A_BINARY = 4
#: First bytes of a UTF-16 file, such as PowerShell writes with >.
UTF16_MARKS = (b"\xff\xfe", b"\xfe\xff")
_COMMENTS = ("#", "%", "//")
# A line between header and rows, or around a table; "---" alone ends a record of ROS.
_RULE = re.compile(r"[-_=+|:\s]{4,}")
# First characters of lines that may have a prefix: a colour, a bracket, a digit, a level.
_BEFORE_PREFIX = ("\x1b", "[", "<", *"0123456789EWIDV")
# Colours of a terminal, also without the escape character that a monitor may remove.
_COLOURS = re.compile(r"\x1b\[[\d;]*[A-Za-z]|\[\d{1,2}(?:;\d{1,3})+m|\[0m")
_CLOCK = r"(?P<hours>\d{1,2}):(?P<minutes>\d\d):(?P<seconds>\d\d(?:[.,:]\d{1,9})?)(?:,\d{3})?Z?"
# Prefixes that serial monitors and logging libraries write, in this order: a time in brackets or before an arrow
# (Arduino's "12:34:56.789 -> ", PlatformIO's "12:34:56.789 > ", "[2024-03-05 12:34:56.789] "), seconds in brackets
# ("[    1.234567] "), and level and module of ESP-IDF, Zephyr, ESPHome and ROS.
_PREFIXES = (
    re.compile(rf"(?P<open>\[)?(?:[\w ,./-]{{5,16}}[T ])?{_CLOCK}(?(open)(?: \d{{4}})?\](?:\s*-?>)?|\s*-?>) ?"),
    re.compile(r"\[\s*(?P<seconds>\d+\.\d{3,9})\]\s+(?=[A-Za-z])"),
    re.compile(rf"[EWIDV] \((?:(?P<ms>\d+)|{_CLOCK})\) [^\s:]{{1,40}}: "),
    re.compile(r"<(?:err|wrn|inf|dbg)> [^\s:]{1,60}: "),
    re.compile(r"(?:\[[A-Z]+\])?\[[\w. ]{1,40}:\d+\](?:\[[^\]]{1,40}\])?: ?"),
    re.compile(r"\[(?:DEBUG|INFO|WARN|ERROR)\] \[(?P<seconds>\d+\.\d+)\] ?(?:\[[^\]]{1,80}\])?: "),
)
# Bytes of plain lines, which need no decoding and are not comments.
_PLAIN = bytes({*range(0x20, 0x7F), *b"\t\r\n"} - {*b"#%/"})


class Line(NamedTuple):
    """A line that is neither empty nor a comment."""

    number: int
    """Number of the line, from 1."""
    text: str
    """Text with its line end; the last one of a file may have none."""
    comment: str
    """Comment line just before, without its mark."""
    arrived_s: float
    """Time of day, or since a start, from a prefix [s]; NaN without one."""


class Lines:
    """The lines of a file, for one pass: UTF-8, or UTF-16 with its mark; without `#`, `%` or `//` comments.

    A file whose name ends in .gz is decompressed. Colours are removed, and the prefixes of serial monitors and logging
    libraries. Many plain lines can be read at once, see `ahead`.

    Raises
    ------
    ConfigError
        During iteration, when the file cannot be read or is not text; the message has file and line.
    """

    def __init__(self, path: Path, *, comments: tuple[str, ...] = _COMMENTS) -> None:
        self._path, self._number, self._size, self._comments = path, 0, 0, comments
        self._file: io.BufferedReader | gzip.GzipFile | None = None
        self._stamped = False
        self._reach, self._refused_to = _LONGEST_LINE, 0

    def __iter__(self) -> Iterator[Line]:
        try:
            with cast(io.BufferedReader, self._path.open("rb", buffering=_LONGEST_LINE)) as file:
                yield from self._read_lines(gzip.GzipFile(fileobj=file) if self._path.suffix == ".gz" else file)
        except (OSError, EOFError, zlib.error) as error:
            raise ConfigError(f"{self._path}: {getattr(error, 'strerror', None) or error}") from error

    def ahead(self) -> bytes:
        """Return the next complete lines in memory that have only plain text, without comments; b"" for none.

        They are not consumed: `take` them, or `refuse` them to get a part of them, or later lines.
        """
        while self._file is not None and not self._stamped and self._size >= self._refused_to:
            try:
                ahead = self._file.peek(self._reach)[: self._reach]
            except (OSError, EOFError, zlib.error):
                return b""  # which the iteration also reports
            text = ahead[: ahead.rfind(b"\n") + 1]
            if not text and len(ahead) == self._reach < _LONGEST_LINE:
                self._reach *= 2
                continue
            if not text or self._size + len(text) > TABLE.bytes or self._number >= TABLE.items:
                return b""
            if not text.translate(None, _PLAIN):
                return text
            self.refuse(text)
        return b""

    def take(self, text: bytes) -> int:
        """Consume the lines that `ahead` returned; return the number of the first."""
        if self._file is None:
            raise ValueError("nothing is ahead")
        self._file.read(len(text))
        first = self._number + 1
        self._number += text.count(b"\n")
        self._size += len(text)
        self._reach = min(2 * self._reach, _LONGEST_LINE)
        return first

    def refuse(self, text: bytes) -> None:
        """Let the text from `ahead` be read line by line, or offer a part of it."""
        if self._reach > _LEAST_AHEAD:
            self._reach //= 2
        else:
            self._refused_to = self._size + len(text)

    @property
    def _where(self) -> str:
        return f"{self._path}:{self._number}"

    def _read_lines(self, file: io.BufferedReader | gzip.GzipFile) -> Iterator[Line]:
        comment, arrived_s = "", math.nan
        for text in self._decoded(file):
            stripped = text.strip()
            if stripped[:1] in _BEFORE_PREFIX:
                arrived_s, text = _split_prefix(text)
                self._stamped = self._stamped or not math.isnan(arrived_s)
                stripped = text.strip()
            if mark := next((mark for mark in self._comments if stripped.startswith(mark)), ""):
                comment = stripped.removeprefix(mark)
            elif stripped and not _RULE.fullmatch(stripped):
                yield Line(self._number, text, comment, arrived_s)
                comment = ""

    def _decoded(self, file: io.BufferedReader | gzip.GzipFile) -> Iterator[str]:
        if file.peek(2)[:2] not in UTF16_MARKS:
            self._file = file
            yield from self._decoded_lines(file)
            self._file = None
            return
        utf16 = _Utf16(file)
        try:
            yield from self._decoded_lines(utf16)
        finally:
            utf16.detach()

    def _decoded_lines(self, lines: io.BufferedReader | gzip.GzipFile | _Utf16) -> Iterator[str]:
        while raw := lines.readline(_LONGEST_LINE + 1):
            self._number += 1
            self._size += len(raw)
            self._check_budget(TABLE, size=self._size, items=self._number)
            if self._number == 1:
                raw = raw.removeprefix(b"\xef\xbb\xbf")
            if b"\0" in raw:
                raise ConfigError(f"{self._where}: a zero byte: this is a binary file, not a text table")
            if len(raw) > _LONGEST_LINE and self._number == 1 and raw.lstrip()[:1] in (b"[", b"{"):
                raw += lines.readline(TABLE_DOCUMENT.bytes)
                self._size = len(raw)
                self._check_budget(TABLE_DOCUMENT, size=self._size)
            elif len(raw) > _LONGEST_LINE:
                raise ConfigError(f"{self._where}: the line is longer than {_LONGEST_LINE} bytes: no table of readings")
            try:
                yield raw.decode("utf-8")
            except UnicodeDecodeError as error:
                if b"\0" in b"".join(lines.readline(_LONGEST_LINE) for _ in range(_LINES_OF_A_BINARY)):
                    raise ConfigError(f"{self._where}: this is a binary file, not a text table") from error
                bad = raw[error.start]
                raise ConfigError(f"{self._where}: byte 0x{bad:02x} is not UTF-8; save the file as UTF-8") from error

    def _check_budget(self, budget: Budget, **counts: int) -> None:
        try:
            budget.check(**counts)
        except BudgetError as error:
            raise ConfigError(f"{self._where}: {error}; cut the file") from error


def _split_prefix(text: str) -> tuple[float, str]:
    """Split a line into the time of its prefixes [s] and its text without colours; NaN without a time."""
    text, arrived_s = _COLOURS.sub("", text), math.nan
    for prefix in _PREFIXES:
        if (matched := prefix.match(text)) is None:
            continue
        text, parts = text[matched.end() :], matched.groupdict()
        if parts.get("seconds"):
            seconds_s = float(re.sub("[,:]", ".", parts["seconds"]))
            arrived_s = 3600.0 * int(parts.get("hours") or 0) + 60.0 * int(parts.get("minutes") or 0) + seconds_s
        elif parts.get("ms"):
            arrived_s = 1e-3 * int(parts["ms"])
    return arrived_s, text


class _Utf16:
    """Lines of a UTF-16 file in the form of a UTF-8 file; invalid characters become U+FFFD."""

    def __init__(self, file: io.BufferedReader | gzip.GzipFile) -> None:
        self._file = io.TextIOWrapper(cast(BinaryIO, file), "utf-16", errors="replace", newline="\n")

    def readline(self, limit: int) -> bytes:
        return self._file.readline(limit).encode("utf-8")

    def detach(self) -> None:
        """Detach from the file without closing it."""
        self._file.detach()
