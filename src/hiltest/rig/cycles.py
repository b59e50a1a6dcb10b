"""The table ``[cycles]``: functions of the firmware whose cycles are counted while it runs."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, ClassVar, Literal

from hiltest.rig.tables import STRICT, require


@dataclass(frozen=True, slots=True)
class CountedFunctions:
    """Functions that are counted under one name; in the file one alone is written as a string."""

    __pydantic_config__: ClassVar[dict[str, Any]] = STRICT
    functions: tuple[str, ...]
    """Symbols of the firmware. Several are called in turn, once for each slice of a solution."""
    ends: str | None = None
    """A word in memory that tells when a solution is complete, such as ``sfg+0xa80``; None: each call counts for
    itself."""
    ends_when: Literal["zero", "changed"] = "zero"
    """What the word shows at the return of the last slice: ``zero``, or that it has ``changed``."""
    ends_bytes: Literal[1, 2, 4] = 4
    """Its size."""

    def __post_init__(self) -> None:
        require(bool(self.functions), "functions", "name one at least")
        require(
            self.ends is not None or len(self.functions) == 1, "ends",
            "functions that are counted together make a solution: name the word in memory that ends one",
        )  # fmt: skip


def as_tables(cycles: object) -> object:
    """Return the table of a file with a table for each function that is named alone."""
    if not isinstance(cycles, dict):
        return cycles
    return {name: {"functions": [given]} if isinstance(given, str) else given for name, given in cycles.items()}
