"""Slices of an execution, which can be repeated to count their cycles by other price tables."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

from hiltest.errors import ConfigError
from hiltest.virtual.core.library import ffi, lib
from hiltest.virtual.core.machine import Machine, Snapshot
from hiltest.virtual.model.timing import TimingProfile


@dataclass(frozen=True, slots=True)
class Slice:
    """Execution from a snapshot to a load from a device, or to a function's return."""

    machine: Machine
    begin: Snapshot
    cycles: int
    instructions: int
    answers: Any
    """Answers of devices to its loads, in order."""


class PriceTables:
    """Counter of the cycles of slices by several price tables at once; it repeats the slices on a second machine.

    Parameters
    ----------
    machine
        Machine that executed the slices; the second one gets the same memories.
    profile
        The first table.
    moves
        Rows and values by which each other table differs from the first one.

    Raises
    ------
    ConfigError
        If there are too many tables.
    """

    def __init__(self, machine: Machine, profile: TimingProfile, moves: Sequence[Mapping[str, int]]) -> None:
        self._handle = ffi.gc(lib.machine_like(machine.handle), lib.machine_destroy)
        if self._handle == ffi.NULL:
            raise MemoryError
        for row, cost in profile.rows.items():
            lib.machine_set_price(self._handle, 0, row.encode(), cost.value)
        self._count = 1 + len(moves)
        if not lib.machine_set_tables(self._handle, self._count):
            raise ConfigError(f"the profile has too many uncertain rows: {len(moves)} moves")
        for table, values in enumerate(moves, start=1):
            for row, value in values.items():
                lib.machine_set_price(self._handle, table, row.encode(), value)

    def count(self, slices: Iterable[Slice]) -> list[int] | None:
        """Return the total cycles of all slices by each table.

        The result is None if the first table does not reproduce a slice's cycles, due to an exception or sleep.
        """
        totals = ffi.new("int64_t[]", self._count)
        for part in slices:
            answers = part.answers
            described = ffi.new(
                "struct slice *", (part.begin.handle, part.cycles, part.instructions, answers, len(answers))
            )
            if not lib.machine_count_again(self._handle, described, totals):
                return None
        return list(totals)
