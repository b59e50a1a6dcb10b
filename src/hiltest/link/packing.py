"""PACK_POINTS, points packed for `direct-fast` when they are stored: what the host asks, and what it is answered."""

from __future__ import annotations

import struct
from collections.abc import Sequence
from dataclasses import dataclass

from hiltest.link.fields import FieldReader
from hiltest.link.replies import RunCost, Status
from hiltest.link.request import Request, within

__all__ = ["PackPoints", "PackingReply"]


@dataclass(frozen=True, slots=True)
class PackingReply:
    """What storing points costs, of all of them together.

    Attributes
    ----------
    range_cost, packing_cost : RunCost or None
        To keep their range, and to pack them; None when the core counts no cycles.
    """

    range_cost: RunCost | None
    packing_cost: RunCost | None

    @classmethod
    def parse(cls, fields: FieldReader) -> PackingReply:
        """Read the reply; empty steps of no cycles are a counter that is not there."""
        kept, packed = fields.number("I", "range cycles"), fields.number("I", "packing cycles")
        overhead = fields.number("I", "overhead cycles")
        return cls(RunCost(kept, overhead), RunCost(packed, overhead)) if overhead else cls(None, None)


@dataclass(frozen=True)
class PackPoints(Request[PackingReply]):
    """Store the first n points again, and pack them about a centre [counts] known beforehand."""

    code = 0x27
    command = "PACK_POINTS"
    answered_with = frozenset({Status.OK, Status.NO_CYCLE_COUNTER})
    n: int
    centre: Sequence[int]

    def payload(self) -> bytes:
        x, y, z = (within(each, -32768, 32767, "counts") for each in self.centre)
        return struct.pack("<H3h", within(self.n, 1, 0xFFFF, "points"), x, y, z)

    def parse(self, fields: FieldReader) -> PackingReply:
        return PackingReply.parse(fields)
