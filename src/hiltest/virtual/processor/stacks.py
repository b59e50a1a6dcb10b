"""How deep the stacks of firmware have been, as the core has seen it by the stack pointer (stacks.c)."""

from __future__ import annotations

from dataclasses import dataclass

from hiltest.virtual.core.library import ffi, lib
from hiltest.virtual.core.machine import Machine


@dataclass(frozen=True, slots=True)
class Stack:
    """A stack that has been used."""

    top: int
    """Address above it: the stack pointer while it was empty."""
    lowest: int
    """Lowest address that the stack pointer has had."""
    first_pc: int
    """The code that ran when it was first seen: of a task the function that it begins with."""

    @property
    def used(self) -> int:
        """Bytes that it has held at most."""
        return self.top - self.lowest


def known_stacks(machine: Machine) -> list[Stack]:
    """Return the stacks in the order in which they were first seen; firmware starts with the first."""
    count = ffi.new("int32_t *")
    entries = lib.machine_stacks(machine.handle, count)
    return [Stack(entry.top, entry.lowest, entry.first_pc) for entry in entries[0 : count[0]]]
