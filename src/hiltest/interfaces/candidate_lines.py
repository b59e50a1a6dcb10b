"""Candidates among the texts of firmware: labels before the numbers of printf, and labels alone."""

from __future__ import annotations

import re
from collections.abc import Iterable, Iterator
from dataclasses import replace

from hiltest.interfaces.candidates import Candidate, Meaning, meaning_of, unit_of
from hiltest.interfaces.quantities import Quantity
from hiltest.virtual.program.elf import FirmwareImage

_MOST_BYTES = 1 << 20  # bytes of all segments: the flash of the chip
_TEXT = re.compile(rb"[\t\r\n\x20-\x7e]{3,240}(?=\0)")
# A number of printf; firmware without floats prints sign, whole and fraction apart: %s%d.%02d.
_ONE = r"%[-+ #0]*[0-9*]*(?:\.[0-9*]+)?(?:hh|h|ll|l|L|z|j)?[diufFgGeEs]"
_NUMBER = re.compile(rf"(?:%s)?{_ONE}(?:\.{_ONE})?")
_BETWEEN = re.compile(r"[\s,;]*")
_LABEL = r"(?P<label>\$[A-Z]{2}HD[GMT]|\"?[A-Za-z][A-Za-z0-9_ .]*\"?(?: ?[\[(][A-Za-z/%]+[\])])?)"
_BEFORE_NUMBER = re.compile(_LABEL + r"(?P<between>\s*[:=,]\s*[\[({]?\s*|\s+)$")
_ALONE = re.compile(r"[\s,;{]*" + _LABEL + r"(?P<between>\s*[:=]\s*)(?P<flag>[01]?)\s*")
_LONGEST_LABEL = 40
_PRINTED, _SEVERAL, _DIGIT = r"[-+]?[0-9]+(?:\.[0-9]*)?", r"\S+", "[01]"


def line_candidates(image: FirmwareImage) -> list[Candidate]:
    """Return candidates for values in the printed lines, from the texts of an image."""
    return [
        candidate
        for text in _texts(image)
        for candidate in (_format_candidates(text) if "%" in text else _label_candidates(text))
    ]


def _texts(image: FirmwareImage) -> Iterator[str]:
    """Yield the texts in an image that end with a zero."""
    remaining = _MOST_BYTES
    for segment in image.segments:
        for match in _TEXT.finditer(segment.data[:remaining]):
            yield match[0].decode("ascii")
        remaining -= min(remaining, len(segment.data))


def _label_candidates(text: str) -> Iterator[Candidate]:
    """Yield the candidates of a text that is only a label: firmware may print the number after it by other means."""
    match = _ALONE.fullmatch(text)
    meaning = _meaning(match["label"], None) if match else None
    if match is None or meaning is None or bool(match["flag"]) > (meaning.quantity is Quantity.CALIBRATED):
        return
    form = _DIGIT if match["flag"] else _PRINTED if meaning.quantity.size == 1 else _SEVERAL
    yield _candidate(meaning, match, form, text)


def _format_candidates(text: str) -> Iterator[Candidate]:
    """Yield the candidates of the labelled numbers of a format."""
    behind = 0
    for run in _runs(text):
        before = text[max(behind, run[0].start() - _LONGEST_LABEL) : run[0].start()]
        match, behind = _BEFORE_NUMBER.search(before), run[-1].end()
        if match is not None and (meaning := _meaning(match["label"], len(run))) is not None:
            unit = re.match(r"\s?[\[(]?([A-Za-z/%]+)", text[behind:])
            meaning = replace(meaning, unit=meaning.unit or (unit_of(meaning.quantity, unit[1]) if unit else ""))
            more = rf"(?:[\s,;]+{_PRINTED}){{{len(run) - 1}}}" if len(run) > 1 else ""
            yield _candidate(meaning, match, _PRINTED + more, text)


def _runs(text: str) -> Iterable[list[re.Match[str]]]:
    """Return the numbers of a format in groups that only blanks and commas separate."""
    runs: list[list[re.Match[str]]] = []
    for number in _NUMBER.finditer(text):
        if runs and _BETWEEN.fullmatch(text[runs[-1][-1].end() : number.start()]):
            runs[-1].append(number)
        else:
            runs.append([number])
    return runs


def _meaning(label: str, size: int | None) -> Meaning | None:
    """Return the meaning of a label; a label among other words is prose and has none."""
    if label.startswith("$"):  # NMEA 0183: a talker, and HDG, HDM or HDT
        return Meaning(Quantity.HEADING, "deg", is_sure=True) if size in (None, 1) else None
    meaning = meaning_of([label], size, is_whole=True)
    return meaning if meaning is not None and meaning.is_sure else None


def _candidate(meaning: Meaning, match: re.Match[str], form: str, text: str) -> Candidate:
    # Formats of a fixed width may have many blanks before the number.
    label, between = match["label"], match["between"].strip()
    begin = rf"\b{re.escape(label)}" if label[0].isalpha() else re.escape(label)
    pattern = rf"{begin}{re.escape(between)}\s*(?P<{meaning.quantity.key}>{form})".replace(r"\ ", " ")
    example = f"{label}{match['between'].rstrip() or ' '}123.4"
    return Candidate(meaning, pattern, f"in {text.strip()!r}", example)
