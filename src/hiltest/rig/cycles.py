"""The table ``[cycles]``: functions of the firmware whose cycles are counted while it runs."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

from hiltest.rig.toml_tables import StrictTable, require


@dataclass(frozen=True, slots=True)
class CountedFunctions(StrictTable):
    """Functions that are counted under one name; in the file a single one may be a string."""

    functions: tuple[str, ...]
    """Symbols of the firmware. Several functions are called in turn, once for each slice of a solution."""
    ends: str | None = None
    """A word in memory that marks a complete solution, such as ``sfg+0xa80``; None if each call counts separately."""
    ends_when: Literal["zero", "changed"] = "zero"
    """State of the word at the return of the last slice: ``zero`` or ``changed``."""
    ends_bytes: Literal[1, 2, 4] = 4
    """Size of the word."""

    def __post_init__(self) -> None:
        require(bool(self.functions), "functions", "name one at least")
        require(
            self.ends is not None or len(self.functions) == 1,
            "ends",
            "functions that are counted together make a solution: name the word in memory that ends one",
        )


def as_tables(cycles: object) -> object:
    """Return the table of a file with strings replaced by tables."""
    if not isinstance(cycles, dict):
        return cycles
    return {name: {"functions": [entry]} if isinstance(entry, str) else entry for name, entry in cycles.items()}
