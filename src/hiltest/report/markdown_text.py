"""Markdown of arbitrary texts: escaped, in tables, folded, and cut to a length."""

from __future__ import annotations

import re
from collections.abc import Iterable, Iterator

from hiltest.text import legible

# Characters with a meaning in Markdown or in GitHub's mathematics.
_SPECIAL = re.compile(r"([\\`*_{}\[\]<>#|~&$])")
# Texts that GitHub turns into links without mark-up; a comment inside prevents that.
_LINKED = re.compile(r"(://|\bwww\.|(?<!\w)@(?=\w))", re.I)
_OPENED, _CLOSED = "<details>", "</details>"


def plain_text(text: str) -> str:
    """Return a text escaped for Markdown, on one line.

    Examples
    --------
    >>> plain_text("<script>|")
    '\\\\<script\\\\>\\\\|'
    >>> plain_text("see https://x")
    'see https:<!-- -->//x'
    """
    escaped = _SPECIAL.sub(r"\\\1", legible(" ".join(text.split())))
    return _LINKED.sub(lambda match: f"{match[0][0]}<!-- -->{match[0][1:]}", escaped)


def table(headings: list[str], rows: Iterable[list[str]]) -> Iterator[str]:
    """Yield the lines of a table of plain texts."""
    yield f"| {' | '.join(headings)} |"
    yield f"|{' --- |' * len(headings)}"
    for row in rows:
        yield f"| {' | '.join(plain_text(cell) for cell in row)} |"


def folded(heading: str, lines: Iterable[str]) -> Iterator[str]:
    """Yield lines that a reader has to open; `heading` is trusted text."""
    yield from ("", f"{_OPENED}<summary>{heading}</summary>", "")
    yield from lines
    yield from ("", _CLOSED)


def cut(text: str, most_bytes: int, whole_is: str) -> str:
    """Return as many whole lines of a page as fit, with a remark if lines are left out.

    Parameters
    ----------
    text
        Page without nested folded parts.
    most_bytes
        Limit on the whole result, in UTF-8.
    whole_is
        Position of the whole page, as plain text.

    Returns
    -------
    str
        Empty if not even the remark fits.
    """
    if len(_bytes(text)) <= most_bytes:
        return text
    ending = f"\n**Truncated to the size limit. The complete report is in {plain_text(whole_is)}.**\n"
    remaining = most_bytes - len(_bytes(ending)) - len(_bytes(f"\n{_CLOSED}\n"))
    fitting_lines, is_open = [], False
    for line in text.splitlines(keepends=True):
        remaining -= len(_bytes(line))
        if remaining < 0:
            break
        fitting_lines.append(line)
        is_open = line.startswith(_OPENED) or (is_open and not line.startswith(_CLOSED))
    cut_text = "".join(fitting_lines) + (f"\n{_CLOSED}\n" if is_open else "") + ending
    return cut_text if len(_bytes(cut_text)) <= most_bytes else ""


def _bytes(text: str) -> bytes:
    # A file's name may hold half a surrogate pair, which no encoding can represent.
    return text.encode("utf-8", errors="backslashreplace")
