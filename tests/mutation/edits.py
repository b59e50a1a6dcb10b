"""The edits: one place of one source file each, and what must be said first of what it breaks."""

from __future__ import annotations

import tomllib
from dataclasses import dataclass
from pathlib import Path

from ..end_to_end.firmware_edits import Edit

FILE = Path(__file__).with_name("edits.toml")


@dataclass(frozen=True)
class Mutation:
    """One mistake.

    Attributes
    ----------
    name : str
        What is wrong then.
    mistake : str
        Kind: sign, swap, stale state and so on.
    edit : Edit
    first : str
        Regular expression that the first failure, its cause or the first test that is not green must match.
    """

    name: str
    mistake: str
    edit: Edit
    first: str


def mutations() -> tuple[Mutation, ...]:
    """Return all of them, in the order of the file."""
    rows = tomllib.loads(FILE.read_text(encoding="utf-8"))["edit"]
    return tuple(
        Mutation(row["name"], row["mistake"], Edit(row["file"], row["old"], row["new"]), row["first"]) for row in rows
    )
