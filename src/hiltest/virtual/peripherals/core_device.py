"""A peripheral that the core's library has: what Python asks of its registers goes there."""

from __future__ import annotations

from hiltest.state import Restorable
from hiltest.virtual.core.library import lib
from hiltest.virtual.core.machine import Machine


class CoreDevice(Restorable):
    """A block of registers in C, which the core reaches without Python.

    Parameters
    ----------
    machine
        It has the block already.
    name
        As the reference manual calls it.
    base
        First address.
    """

    def __init__(self, machine: Machine, name: str, base: int) -> None:
        self.name = name
        self.base = base
        self._handle = machine.handle
        self._clocked = True

    @property
    def clocked(self) -> bool:
        """Whether its clock gate is open."""
        return self._clocked

    @clocked.setter
    def clocked(self, clocked: bool) -> None:
        self._clocked = clocked
        lib.machine_set_clocked(self._handle, self.base, clocked)

    def read(self, offset: int, size: int) -> int:
        """Answer a read of 1, 2 or 4 bytes."""
        value: int = lib.machine_read_device(self._handle, self.base + offset, size)
        return value

    def write(self, offset: int, size: int, value: int) -> None:
        """Take a write of 1, 2 or 4 bytes."""
        lib.machine_write_device(self._handle, self.base + offset, size, value)

    def reset(self) -> None:
        """Return to the state after a chip reset."""
        lib.machine_reset_device(self._handle, self.base)
