"""Depths of the firmware's stacks, as the core records them from the stack pointer (stacks.c)."""

from __future__ import annotations

from dataclasses import dataclass

from hiltest.virtual.core.library import ffi, lib
from hiltest.virtual.core.machine import Machine


@dataclass(frozen=True, slots=True)
class Stack:
    """A stack that has been used."""

    top: int
    """Stack pointer of the empty stack."""
    lowest: int
    """Lowest value of the stack pointer."""
    first_pc: int
    """Address of the code that first used the stack; for a task, its first function."""

    @property
    def used(self) -> int:
        """Largest use [bytes]."""
        return self.top - self.lowest


def forget_stacks(machine: Machine) -> None:
    """Forget all stacks; the next move of the stack pointer begins one."""
    lib.machine_forget_stacks(machine.handle)


def known_stacks(machine: Machine) -> list[Stack]:
    """Return the stacks in the order of their first use; firmware starts on the first one."""
    count = ffi.new("int32_t *")
    entries = lib.machine_stacks(machine.handle, count)
    return [Stack(entry.top, entry.lowest, entry.first_pc) for entry in entries[0 : count[0]]]
