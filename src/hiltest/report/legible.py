"""Text from outside as it is shown: what would be unseen, or would turn the text around it, is named."""

from __future__ import annotations

import unicodedata

# Control, format (zero widths, direction marks), surrogates and line or paragraph separators.
_UNSEEN = frozenset({"Cc", "Cf", "Cs", "Zl", "Zp"})
_KEPT = frozenset("\n\t")


def legible(text: str) -> str:
    """Return a text in which every character is seen.

    A firmware may call itself what it likes: a direction mark in its name would reverse the words behind it, and a
    zero byte is no text at all.

    Examples
    --------
    >>> legible("evil\\u202egnp.elf")
    'evil⟨U+202E⟩gnp.elf'
    """
    if text.isascii() and text.isprintable():
        return text
    return "".join(_named(each) if unicodedata.category(each) in _UNSEEN else each for each in text)


def _named(character: str) -> str:
    return character if character in _KEPT else f"⟨U+{ord(character):04X}⟩"
