"""Versioned tables of clock cycles, which the core prices instructions by.

The table (``profiles/*.toml``) holds a value, an uncertainty range (`band`) and a source for every row. The rules that
say what one instruction does to the next are in ``core/prices.c``.
"""

from __future__ import annotations

import hashlib
from collections.abc import Mapping
from dataclasses import dataclass, replace


@dataclass(frozen=True, slots=True)
class CostRow:
    """One priced class of instructions [cycles].

    `against` names a row that a measurement ties it to: of the two only the sum is known, so one is at the top of its
    range where the other is at the bottom.
    """

    value: int
    band: tuple[int, int]
    source: str
    against: str = ""


class TimingProfile:
    """A table of prices.

    Parameters
    ----------
    name
        Name and version, e.g. ``cortex-m4-trm/2``.
    rows
        The table.
    memory
        What the memories add, for counting that looks at every access.
    shipped
        Whether a test checks the numbers under that name; otherwise the name gets the digest as an ending, so that two
        tables which call themselves alike are not compared: ``mine/1+0a1b2c3d``.

    Attributes
    ----------
    digest : str
        A hash of the given name and of every value and range.
    """

    def __init__(
        self, name: str, rows: dict[str, CostRow], memory: dict[str, CostRow] | None = None, *, shipped: bool = True
    ) -> None:
        self.memory = memory or {}
        each = (*sorted(rows.items()), *sorted(self.memory.items()))
        text = name + "".join(f";{key}={row.value}{row.band}" for key, row in each)
        self.digest = hashlib.sha256(text.encode()).hexdigest()
        self.name = name if shipped else f"{name}+{self.digest[:8]}"
        self.rows = rows


def moved(profile: TimingProfile, values: Mapping[str, int]) -> TimingProfile:
    """Return a profile with other values in some rows, within their ranges or not."""
    rows = profile.rows | {name: replace(profile.rows[name], value=value) for name, value in values.items()}
    return TimingProfile(profile.name, rows, profile.memory, shipped=False)
