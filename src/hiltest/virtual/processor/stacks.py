"""Depths of the firmware's stacks, which the core records from the stack pointer (stacks.c)."""

from __future__ import annotations

from dataclasses import dataclass

from hiltest.virtual.core.library import ffi, lib
from hiltest.virtual.core.machine import Machine


@dataclass(frozen=True, slots=True)
class Stack:
    """A stack that has been used."""

    top: int
    """Stack pointer of the empty stack, the address above it."""
    lowest: int
    """Lowest value of the stack pointer."""
    first_pc: int
    """Code that first used the stack: for a task the function that it begins with."""

    @property
    def used(self) -> int:
        """Largest use [bytes]."""
        return self.top - self.lowest


def known_stacks(machine: Machine) -> list[Stack]:
    """Return the stacks in the order of their first use; firmware starts with the first."""
    count = ffi.new("int32_t *")
    entries = lib.machine_stacks(machine.handle, count)
    return [Stack(entry.top, entry.lowest, entry.first_pc) for entry in entries[0 : count[0]]]
