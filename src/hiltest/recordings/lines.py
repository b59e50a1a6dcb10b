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

from hiltest.errors import ConfigError

# A table line is shorter by far; what is not must not fill the memory.
_LONGEST_LINE = 65_536
# Hours of any sensor. A small compressed file could otherwise go on for ever.
_MOST_BYTES = 512 << 20
#: How a file in UTF-16 begins, such as PowerShell writes with >.
UTF16_MARKS = (b"\xff\xfe", b"\xfe\xff")
_COMMENTS = ("#", "%", "//")
# As serial monitors put before what arrives: Arduino's "12:34:56.789 -> ", PlatformIO's "12:34:56.789 > ".
_STAMP = re.compile(r"(?P<hours>\d{1,2}):(?P<minutes>\d\d):(?P<seconds>\d\d(?:\.\d{1,9})?) -?> ?")


class Line(NamedTuple):
    """One line that is neither empty nor a comment.

    Attributes
    ----------
    number : int
        From 1.
    text : str
        With its line end; the last one of a file may have none.
    comment : str
        The comment line just before, without its mark.
    arrived_s : float
        Time of day that a serial monitor put before it [s]; NaN where none did.
    """

    number: int
    text: str
    comment: str
    arrived_s: float


def read_lines(path: Path) -> Iterator[Line]:
    """Yield the lines of a file: UTF-8, or UTF-16 with its mark; `#`, `%` or `//` comments.

    A file whose name ends in .gz is unpacked as it is read. Times that a serial monitor put before each line are taken
    off.

    Raises
    ------
    ConfigError
        When the file cannot be read or is no text; names file and line.
    """
    try:
        with path.open("rb") as file:
            yield from _lines(path, gzip.GzipFile(fileobj=file) if path.suffix == ".gz" else file)
    except (OSError, EOFError, zlib.error) as error:
        raise ConfigError(f"{path}: {getattr(error, 'strerror', None) or error}") from error


def _lines(path: Path, file: io.BufferedReader | gzip.GzipFile) -> Iterator[Line]:
    comment, stamped, arrived_s = "", None, math.nan
    for number, text in _decoded(path, file):
        stripped = text.strip()
        if stamped is None and stripped:
            stamped = _STAMP.match(stripped) is not None
        if stamped:
            arrived_s, text = _unstamped(text)
            stripped = text.strip()
        if stripped.startswith(_COMMENTS):
            comment = stripped.removeprefix(next(mark for mark in _COMMENTS if stripped.startswith(mark)))
        elif stripped:
            yield Line(number, text, comment, arrived_s)
            comment = ""


def _unstamped(text: str) -> tuple[float, str]:
    """Return when a line arrived [s], and the line; NaN where it has no stamp."""
    stamp = _STAMP.match(text)
    if stamp is None:
        return math.nan, text
    seconds_s = 3600.0 * int(stamp["hours"]) + 60.0 * int(stamp["minutes"]) + float(stamp["seconds"])
    return seconds_s, text[stamp.end() :]


def _decoded(path: Path, file: io.BufferedReader | gzip.GzipFile) -> Iterator[tuple[int, str]]:
    if file.peek(2)[:2] not in UTF16_MARKS:
        yield from _decoded_lines(path, file)
        return
    utf16 = _Utf16(file)
    try:
        yield from _decoded_lines(path, utf16)
    finally:
        utf16.detach()


def _decoded_lines(path: Path, lines: io.BufferedReader | gzip.GzipFile | _Utf16) -> Iterator[tuple[int, str]]:
    number, size = 0, 0
    while raw := lines.readline(_LONGEST_LINE + 1):
        number += 1
        size += len(raw)
        if size > _MOST_BYTES:
            raise ConfigError(f"{path}:{number}: more than {_MOST_BYTES >> 20} MB of text; cut the file")
        if number == 1:
            raw = raw.removeprefix(b"\xef\xbb\xbf")
        if b"\0" in raw:
            raise ConfigError(f"{path}:{number}: a zero byte: this is a binary file, not a text table")
        if len(raw) > _LONGEST_LINE:
            raise ConfigError(f"{path}:{number}: the line is longer than {_LONGEST_LINE} bytes: no table of readings")
        try:
            yield number, raw.decode("utf-8")
        except UnicodeDecodeError as error:
            bad = raw[error.start]
            raise ConfigError(f"{path}:{number}: byte 0x{bad:02x} is not UTF-8; save the file as UTF-8") from error


class _Utf16:
    """Lines of a file in UTF-16 as a file in UTF-8 gives them; what is no character comes as U+FFFD."""

    def __init__(self, file: io.BufferedReader | gzip.GzipFile) -> None:
        self._file = io.TextIOWrapper(cast(BinaryIO, file), "utf-16", errors="replace", newline="\n")

    def readline(self, limit: int) -> bytes:
        return self._file.readline(limit).encode("utf-8")

    def detach(self) -> None:
        """Leave the file to who opened it."""
        self._file.detach()
