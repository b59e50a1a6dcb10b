"""Timing profiles: versioned tables of clock cycles, with which the core prices instructions.

A table (``profiles/*.toml``) has a value, an uncertainty range (`band`) and a source in every row. The rules for the
effect of an instruction on the next one are in ``core/prices.c``.
"""

from __future__ import annotations

import hashlib
from collections.abc import Mapping
from dataclasses import dataclass, replace


@dataclass(frozen=True, slots=True)
class CostRow:
    """Cost of a class of instructions [cycles].

    `against` names a second row if a measurement gave only the sum of both: one is then at the top of its range if the
    other is at the bottom.
    """

    value: int
    band: tuple[int, int]
    source: str
    against: str = ""


Range = tuple[int, int]
"""First address and size [bytes]."""


@dataclass(frozen=True, slots=True)
class WaitingMemories:
    """Places of the memories that memory rows apply to: flash, RAMs that answer late, and blocks of all memories."""

    flash: Range
    late: tuple[Range, ...] = ()
    blocks: tuple[int, ...] = ()
    """First addresses of memories between which loads do not overlap."""


@dataclass(frozen=True, slots=True)
class CountError:
    """Interval of the true count relative to the model's [thousandths], from published counts of similar code."""

    permille: tuple[int, int]
    source: str


class TimingProfile:
    """A timing profile.

    Parameters
    ----------
    name
        Name and version, such as ``cortex-m4-trm/3``.
    memory
        Rows of the memories; with them, counts include waits for memories.
    waiting
        Places of the memories; None for those of the K64F.
    errors
        Errors of counts by the memory of the code: ``sram``, ``sram_u`` (from 0x20000000) or ``flash``; None if the
        ranges of rows are the only doubt.
    waits_for_flash
        False if code in flash has the range of its rows, because no memory waits.
    shipped
        True if the package's tests fix the numbers of this name; otherwise a digest is appended to the name, as in
        ``mine/1+0a1b2c3d``, so that counts of different tables are not compared.

    Attributes
    ----------
    digest : str
        Hash of the original name, and of every value and range.
    """

    def __init__(
        self,
        name: str,
        rows: dict[str, CostRow],
        memory: dict[str, CostRow] | None = None,
        *,
        waiting: WaitingMemories | None = None,
        errors: Mapping[str, CountError] | None = None,
        waits_for_flash: bool = True,
        shipped: bool = True,
    ) -> None:
        self.memory = memory or {}
        self.waiting = waiting
        self.errors = errors or {}
        self.waits_for_flash = waits_for_flash
        table = (*sorted(rows.items()), *sorted(self.memory.items()))
        text = (
            name + "".join(f";{key}={row.value}{row.band}" for key, row in table) + (repr(waiting) if waiting else "")
        )
        text += "".join(f";{place}={error.permille}" for place, error in sorted(self.errors.items()))
        self.digest = hashlib.sha256(text.encode()).hexdigest()
        self.name = name if shipped else f"{name}+{self.digest[:8]}"
        self.rows = rows


def replace_values(profile: TimingProfile, values: Mapping[str, int]) -> TimingProfile:
    """Return a profile with other values in some rows, which may be outside their ranges."""
    rows = profile.rows | {name: replace(profile.rows[name], value=value) for name, value in values.items()}
    return TimingProfile(
        profile.name,
        rows,
        profile.memory,
        waiting=profile.waiting,
        errors=profile.errors,
        waits_for_flash=profile.waits_for_flash,
        shipped=False,
    )
