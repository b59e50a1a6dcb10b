"""Lines in a stream of bytes, and patterns that are searched in them, both with limits."""

from __future__ import annotations

import re
from collections.abc import Iterator
from functools import reduce
from operator import xor

import regex

from hiltest.budgets import PATTERN

# NMEA 0183 allows 82; a line of JSON with every quantity has some 600.
LONGEST_LINE = 1024
# NMEA 0183, proprietary sentences too: $PFEC,...*hh.
_WITH_CHECK_SUM = re.compile(r"\s*\$(?P<checked>[^$*]*)\*(?P<sum>[0-9A-Fa-f]{2})\s*")
# One item of a pattern: an escape, a class, a counted repetition, or a character.
_TOKEN = re.compile(r"\\.|\[\^?\]?(?:\\.|[^\]\\])*+\]|\{(?P<fewest>\d*+)(?:,(?P<most>\d*+))?\}|.", re.DOTALL)
_LINE_END = re.compile(rb"[\r\n]")
# A sensible search takes microseconds; the margin is for a busy host.
_LONGEST_SEARCH_S = 1.0


class LineSplitter:
    r"""Splitter of bytes that arrive in pieces into lines, which end with ``\n``, ``\r\n`` or ``\r``.

    Examples
    --------
    >>> splitter = LineSplitter()
    >>> list(splitter.feed(b"a\r\nb")), list(splitter.feed(b"c\n\nd"))
    (['a'], ['bc'])

    Attributes
    ----------
    unfinished : bytearray
        Bytes since the last line end, cut if the line is too long.
    """

    def __init__(self) -> None:
        self.unfinished = bytearray()

    def feed(self, data: bytes) -> Iterator[str | None]:
        """Yield the non-empty lines that bytes complete; None for one that is too long."""
        *ended, rest = _LINE_END.split(data)
        for piece in ended:
            self._keep(piece)
            if self.unfinished:
                yield self._line()
            self.unfinished.clear()
        self._keep(rest)

    def _keep(self, piece: bytes) -> None:
        self.unfinished += piece[: LONGEST_LINE + 1 - len(self.unfinished)]

    def _line(self) -> str | None:
        return None if len(self.unfinished) > LONGEST_LINE else self.unfinished.decode("utf-8", errors="replace")


def is_intact(line: str) -> bool | None:
    """Return whether a line's checksum is correct; None for a line without one.

    Examples
    --------
    >>> is_intact("$HCHDM,101.1,M*28"), is_intact("$HCHDM,101.2,M*28"), is_intact("HDG=101.1")
    (True, False, None)
    """
    match = _WITH_CHECK_SUM.fullmatch(line)
    if match is None:
        return None
    return reduce(xor, match["checked"].encode(), 0) == int(match["sum"], 16)


def written_out_size(pattern: str) -> int:
    r"""Return the number of characters of a pattern whose counted repetitions are written out, as its compiler does.

    Examples
    --------
    >>> written_out_size("a{3}"), written_out_size(r"(?:[ab]\{2}x){2,10}c"), written_out_size("(a{10}){10}")
    (3, 121, 110)
    """
    sizes, last = [0], 0  # of each open group, and of the last item
    for token in _TOKEN.finditer(pattern):
        counts = [int(count) for count in token.group("fewest", "most") if count]
        if counts and last:
            sizes[-1] += last * (max(counts) - 1)
            last *= max(counts)
            continue
        if token[0] == "(":
            sizes.append(0)
            continue
        last = sizes.pop() + 1 if token[0] == ")" and len(sizes) > 1 else len(token[0])
        sizes[-1] += last
    return sum(sizes)


class Pattern:
    """A regular expression that is disabled once a search has taken too long.

    Raises
    ------
    ValueError
        When the text is over its budget, or not a regular expression.

    Attributes
    ----------
    text : str
    groups : frozenset of str
        Names of its groups.
    given_up : bool
        True if it is disabled.
    """

    def __init__(self, text: str) -> None:
        self.text = text
        PATTERN.check(size=len(text.encode("utf-8", errors="replace")), items=written_out_size(text))
        try:
            self._compiled = regex.compile(text)
        except (regex.error, OverflowError, RecursionError) as error:
            raise ValueError(f"'{text}' is not a regular expression: {error}") from error
        self.groups = frozenset(self._compiled.groupindex)
        self.given_up = False

    def search(self, line: str) -> regex.Match[str] | None:
        """Return the first match in a line."""
        if self.given_up:
            return None
        try:
            return self._compiled.search(line, timeout=_LONGEST_SEARCH_S)
        except TimeoutError:
            self.given_up = True
            return None
