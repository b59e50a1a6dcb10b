"""The kinds of measurement that hiltest makes, read from ``measurements.toml``, the one table of names and meanings.

A name such as ``heading.{calibrator}.max`` declares its subject in braces; `identify` finds the kind and the subject of
``heading.direct.max``. A measurement with any other name is the user's own: it has no kind.
"""

from __future__ import annotations

import re
import tomllib
from collections.abc import Iterator, Mapping
from functools import cache
from itertools import product
from pathlib import Path
from typing import Any

from hiltest.measurement.deviations import DEVIATIONS
from hiltest.measurement.kind import (
    EXACT,
    Allowance,
    Better,
    Deviation,
    Kind,
    NamedKind,
    Reference,
    Section,
    Tolerance,
)
from hiltest.measurement.limit import Limit

_TABLE = Path(__file__).with_name("measurements.toml")
_PHRASE = re.compile(r"\{(\w+)\}")


def _read_kinds() -> Iterator[Kind]:
    """Yield the kinds of the table."""
    sections = tomllib.loads(_TABLE.read_text(encoding="utf-8"))
    phrases, subjects = sections.pop("phrases"), sections.pop("subjects")

    def complete(text: str) -> str:
        return _PHRASE.sub(lambda match: phrases.get(match[1], match[0]), text)

    def take_allowance(row: dict[str, Any], better: Better | None = None) -> Allowance:
        tolerance = Tolerance(row.pop("absolute", 0), row.pop("relative", 0))
        return Allowance(tolerance, complete(row.pop("reason")), better)

    for section, rows in sections.items():
        for name, row in rows.items():
            yield Kind(
                name=name,
                unit=row.pop("unit", None),
                better=Better(row.pop("better", Better.LOWER)),
                allowance=take_allowance(row),
                section=Section[section.upper()],
                subjects={
                    subject: take_allowance(other, Better(other["better"]) if "better" in other else None)
                    for subject, other in subjects.get(name, {}).items()
                },
                reference=Reference[row.pop("reference", "none").upper()],
                next_step=complete(row.pop("next_step", "")),
                **row,
            )


KINDS: Mapping[str, Kind] = {kind.name: kind for kind in _read_kinds()}
"""Every kind, by name."""

_SUBJECT = "{}"
_LETTERS_AT_MOST = 2  # by which a misspelt name differs
# The name of a calibrator, of one of its further calibrations (direct@100), of an axis, a source or a function.
_SUBJECT_NAME = re.compile(r"[A-Za-z0-9_-]+(?:@[0-9]+)?")


def _form(name: str) -> tuple[str, ...]:
    """Return the parts of a kind's name, with the subject's place marked."""
    return tuple(_SUBJECT if part.startswith("{") else part for part in name.split("."))


_BY_FORM = {_form(name): kind for name, kind in KINDS.items()}


@cache
def identify(name: str) -> NamedKind:
    """Return kind and subject of a measurement's name; no other function splits names.

    A kind without a subject takes precedence: ``cycles.fusion.update`` belongs to no calibrator. A subject of several
    parts has dots between them, as in the name.
    """
    parts = name.split(".")
    for marked in sorted(product((False, True), repeat=len(parts)), key=sum):
        form = tuple(_SUBJECT if is_subject else part for part, is_subject in zip(parts, marked, strict=True))
        subject = [part for part, is_subject in zip(parts, marked, strict=True) if is_subject]
        if (kind := _BY_FORM.get(form)) is not None and all(map(_SUBJECT_NAME.fullmatch, subject)):
            return NamedKind(kind, ".".join(subject))
    return NamedKind(None)


def nearest_name(name: str) -> str | None:
    """Return the known name within two letters of `name`, with the subject of `name`."""
    if "*" in name:
        name = name.replace("*", "direct")  # the name is a pattern, and each limit belongs to one measurement
    parts = name.split(".")
    candidates = (
        ".".join(subject_part if part == _SUBJECT else part for part, subject_part in zip(form, parts, strict=True))
        for form in _BY_FORM
        if len(form) == len(parts)
    )
    near = sorted(
        (distance, candidate)
        for candidate in candidates
        if (distance := _edit_distance(name, candidate)) <= _LETTERS_AT_MOST
    )
    return near[0][1] if near else None


def _edit_distance(one: str, other: str) -> int:
    """Return the number of letters to insert, delete or replace (Levenshtein distance)."""
    row = list(range(len(other) + 1))
    for number, letter in enumerate(one, start=1):
        before, row[0] = row[0], number
        for place, against in enumerate(other, start=1):
            before, row[place] = row[place], min(row[place] + 1, row[place - 1] + 1, before + (letter != against))
    return row[-1]


def better_of(name: str, limit: Limit | None, unit: str = "") -> Better:
    """Return the better direction; for a user's own measurement fewer cycles are better, else its limit decides."""
    if (better := identify(name).better) is not None:
        return better
    if unit == "cycle":
        return Better.LOWER
    return limit.better if limit else Better.NEITHER


def tolerance_of(name: str, of_rig: Mapping[str, Tolerance]) -> Tolerance:
    """Return the tolerance of a measurement: the rig's, or else the kind's; exact for a user's own."""
    if (stated := of_rig.get(name)) is not None:
        return stated
    allowance = identify(name).allowance
    return allowance.tolerance if allowance else EXACT


def deviation_of(name: str) -> Deviation | None:
    """Return the deviation of a measurement between runs on the default rig that differ only in their noise.

    For a subject that the packaged firmware does not have, such as a calibrator of the user's own, it is the largest of
    its kind. The result is None if nothing differs, and for a user's own measurement.
    """
    kind = identify(name).kind
    deviation = DEVIATIONS.get(name) or (_largest_deviations().get(kind.name) if kind else None)
    return deviation if deviation and deviation.value else None


@cache
def _largest_deviations() -> Mapping[str, Deviation]:
    by_kind: dict[str, Deviation] = {}
    for name, deviation in sorted(DEVIATIONS.items(), key=lambda entry: entry[1].value):
        if (kind := identify(name).kind) is not None:
            by_kind[kind.name] = deviation
    return by_kind


def is_compared(name: str) -> bool:
    """Return whether comparisons include a measurement."""
    kind = identify(name).kind
    return kind is None or kind.compared


def is_direction(name: str) -> bool:
    """Return whether a measurement is a direction [deg]: 330 and 30 are 60 apart, and ratios have no meaning."""
    kind = identify(name).kind
    return kind is not None and kind.direction
