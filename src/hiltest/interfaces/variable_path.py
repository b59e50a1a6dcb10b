"""Paths to variables, as in a rig: ``sfg.MagCal.fV[0]``, ``filter->state[CHX]``, ``magnetic.c:last``."""

from __future__ import annotations

import re
from dataclasses import dataclass
from typing import TypeAlias

from hiltest.errors import ConfigError

_LONGEST = 512
_NAME = r"[A-Za-z_$][A-Za-z0-9_$]*"
# A file has a dot in its name; a scope (a function or a namespace) has none and two colons after it.
_BEGIN = re.compile(rf"(?:(?P<file>[^:\[\]*]*\.[A-Za-z0-9+]+):(?!:))?(?P<scope>(?:{_NAME}::)*)(?P<name>{_NAME})")
_NUMBER = r"-?(?:0[xX][0-9a-fA-F]+|[0-9]+)"
_STEP = re.compile(
    rf"\s*(?:(?P<access>\.|->)\s*(?P<member>{_NAME})"
    rf"|\[\s*(?:(?P<number>{_NUMBER})|(?P<word>{_NAME}))\s*\])"
)


@dataclass(frozen=True, slots=True)
class MemberStep:
    """A member of a struct or union, or of a pointer's target with ``->``."""

    name: str
    by_pointer: bool


@dataclass(frozen=True, slots=True)
class IndexStep:
    """An element by its number, or by an enumerator's name."""

    index: int | str


@dataclass(frozen=True, slots=True)
class DereferenceStep:
    """The target of a pointer."""


Step: TypeAlias = MemberStep | IndexStep | DereferenceStep


@dataclass(frozen=True, slots=True)
class VariablePath:
    """A variable, and the steps from it to a value."""

    text: str
    """Text of the path."""
    file: str
    """Source file of a static variable; empty when it is not named."""
    scope: str
    """Function whose static variable it is, or namespace; empty for neither."""
    name: str
    steps: tuple[Step, ...]


def read_path(text: str) -> VariablePath:
    """Parse a path.

    Raises
    ------
    ConfigError
        If the text is not a path.
    """
    written = text.strip()
    bare = written.lstrip("* ")
    stars = written[: len(written) - len(bare)].count("*")
    begin = _BEGIN.match(bare) if len(bare) <= _LONGEST else None
    if begin is None:
        raise ConfigError(f"{text[:80]!r} is not a path to a variable; write one as in C: {_EXAMPLES}")
    at, steps = begin.end(), []
    while at < len(bare):
        step = _STEP.match(bare, at)
        if step is None:
            raise ConfigError(f"{text!r}: {bare[at:]!r} cannot be parsed; write paths as in C: {_EXAMPLES}")
        steps.append(_step(step))
        at = step.end()
    dereferences = [DereferenceStep()] * stars  # they bind weaker than the operators after a name
    scope = begin["scope"].removesuffix("::")
    return VariablePath(text, begin["file"] or "", scope, begin["name"], (*steps, *dereferences))


_EXAMPLES = "sfg.MagCal.fV[0], filter->state[CHX], *latest, magnetic.c:last, read_sensor::count"


def _step(match: re.Match[str]) -> Step:
    if match["member"] is not None:
        return MemberStep(match["member"], match["access"] == "->")
    if match["word"] is not None:
        return IndexStep(match["word"])
    return IndexStep(int(match["number"], 16 if "x" in match["number"].lower() else 10))
