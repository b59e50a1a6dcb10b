"""Versioned tables of clock cycles, by which the core prices instructions.

A table (``profiles/*.toml``) holds a value, an uncertainty range (`band`) and a source for every row. The rules for the
effect of an instruction on the next one are in ``core/prices.c``.
"""

from __future__ import annotations

import hashlib
from collections.abc import Mapping
from dataclasses import dataclass, replace


@dataclass(frozen=True, slots=True)
class CostRow:
    """One priced class of instructions [cycles].

    `against` names a row that a measurement ties it to: only the sum of the two is known, so one is at the top of its
    range if the other is at the bottom.
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
        Name and version, such as ``cortex-m4-trm/2``.
    memory
        Rows of the memories, for counts with every access.
    shipped
        True if a test checks the numbers under that name; otherwise a digest is appended to the name, so that two
        tables with the same name are not compared: ``mine/1+0a1b2c3d``.

    Attributes
    ----------
    digest : str
        Hash of the original name and of every value and range.
    """

    def __init__(
        self, name: str, rows: dict[str, CostRow], memory: dict[str, CostRow] | None = None, *, shipped: bool = True
    ) -> None:
        self.memory = memory or {}
        table = (*sorted(rows.items()), *sorted(self.memory.items()))
        text = name + "".join(f";{key}={row.value}{row.band}" for key, row in table)
        self.digest = hashlib.sha256(text.encode()).hexdigest()
        self.name = name if shipped else f"{name}+{self.digest[:8]}"
        self.rows = rows


def replace_values(profile: TimingProfile, values: Mapping[str, int]) -> TimingProfile:
    """Return a profile with other values in some rows, within their ranges or not."""
    rows = profile.rows | {name: replace(profile.rows[name], value=value) for name, value in values.items()}
    return TimingProfile(profile.name, rows, profile.memory, shipped=False)
