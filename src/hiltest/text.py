"""Numbers, lists and names for human readers, and texts with visible characters only."""

from __future__ import annotations

import re
import unicodedata
from collections.abc import Sequence

# Control, format (zero widths, direction marks), surrogates and line or paragraph separators.
_UNSEEN = frozenset({"Cc", "Cf", "Cs", "Zl", "Zp"})
_ALLOWED = frozenset("\n\t")
# Noise prints 24 bytes in a row once in 10^10 times, since 97 of 256 bytes are printable.
_FEWEST_BYTES, _MOST_IS_PRINTED = 24, 0.95
_REPETITION = re.compile(r"(?P<separator>[\[-])\d+-\d+\]$")


def format_number(value: float | int | None, digits: int = 4) -> str:
    """Return a number for a human reader: thousands separated, and `digits` significant ones below a thousand.

    Examples
    --------
    >>> format_number(11061.25)
    '11 061.2'
    >>> format_number(1.96875)
    '1.969'
    >>> format_number(131.2, 2)
    '131'
    >>> format_number(None)
    '-'
    """
    if value is None:
        return "-"
    if abs(value) < 1000:
        digits_text = f"{value:.{digits}g}"
        return f"{value:.0f}" if "e+" in digits_text else digits_text
    return f"{value:,.1f}".removesuffix(".0").replace(",", " ")


def hundredths(value: float) -> str:
    """Return two decimals, or two significant digits of a value below a tenth: degrees and percents in a sentence.

    Examples
    --------
    >>> hundredths(0.8911)
    '0.89'
    >>> hundredths(0.00196)
    '0.002'
    """
    return f"{value:.2f}" if abs(value) >= 0.1 or not value else f"{value:.2g}"


def number(value: float | int | None, unit: str = "") -> str:
    """Return a measured value as in every report: degrees and percents to hundredths, others as `format_number` does.

    Examples
    --------
    >>> number(0.8911, "deg"), number(10838, "cycle"), number(None, "deg")
    ('0.89', '10 838', '-')
    """
    return hundredths(value) if value is not None and unit in ("deg", "%") else format_number(value)


def format_with_unit(value: float | int | None, unit: str) -> str:
    """Return a value followed by its unit, with cycles in the plural.

    Examples
    --------
    >>> format_with_unit(10838, "cycle"), format_with_unit(26, "")
    ('10 838 cycles', '26')
    """
    return f"{number(value, unit)} {'cycles' if unit == 'cycle' else unit}".rstrip()


def format_count(count: int, word: str) -> str:
    """Return a count with its noun.

    Examples
    --------
    >>> format_count(1, "test"), format_count(28, "test")
    ('1 test', '28 tests')
    """
    return f"{format_number(count)} {word}{'s' * (count != 1)}"


def join_words(texts: Sequence[str], at_most: int) -> str:
    """Return the first texts separated by commas, and the number of others.

    Examples
    --------
    >>> join_words(["a", "b", "c"], 2)
    'a, b and 1 more'
    """
    more = len(texts) - at_most
    return ", ".join(texts[:at_most]) + (f" and {more} more" if more > 0 else "")


def short_test_id(test: str) -> str:
    """Return a test's id with only the name of its file; the rest may contain slashes of its own.

    Examples
    --------
    >>> short_test_id("hil/suites/test_link.py::test_rate[1/2]")
    'test_link.py::test_rate[1/2]'
    """
    file, colons, name = test.partition("::")
    return file.rpartition("/")[2] + colons + name


def id_without_repetition(test: str) -> str:
    """Return a test's id without the number of its repetition, which pytest-repeat appends to its parameters.

    Examples
    --------
    >>> id_without_repetition("test_link.py::test_rate[57600-2-3]")
    'test_link.py::test_rate[57600]'
    >>> id_without_repetition("test_link.py::test_identity[2-3]")
    'test_link.py::test_identity'
    """
    return _REPETITION.sub(lambda match: "]" if match["separator"] == "-" else "", test)


def legible(text: str) -> str:
    """Return a text in which every character is visible.

    Firmware can choose any name: a direction mark in its name would reverse the words after it, and a
    zero byte is not printable.

    Examples
    --------
    >>> legible("evil\\u202egnp.elf")
    'evil⟨U+202E⟩gnp.elf'
    """
    if text.isascii() and text.isprintable():
        return text
    return "".join(
        _name_invisible(character) if unicodedata.category(character) in _UNSEEN else character for character in text
    )


def is_text(data: bytes) -> bool:
    r"""Return whether bytes are printed text: nearly all of them are printable, and their number exceeds luck.

    Examples
    --------
    >>> is_text(b"heading=12.3\r\nheading=12.4\r\n"), is_text(bytes(range(40))), is_text(b"ok")
    (True, False, False)
    """
    printed = sum(0x20 <= byte < 0x7F or byte in b"\t\r\n" for byte in data)
    return len(data) >= _FEWEST_BYTES and printed >= _MOST_IS_PRINTED * len(data)


def _name_invisible(character: str) -> str:
    return character if character in _ALLOWED else f"⟨U+{ord(character):04X}⟩"
