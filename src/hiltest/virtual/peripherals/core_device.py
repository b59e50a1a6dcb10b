"""Access from Python to peripherals in the core's library."""

from __future__ import annotations

from hiltest.state import Restorable
from hiltest.virtual.core.library import lib
from hiltest.virtual.core.machine import Machine


class CoreDevice(Restorable):
    """A peripheral in C, which the core accesses without Python.

    Parameters
    ----------
    machine
        Machine that already has the peripheral.
    name
        Name in the reference manual.
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
        """Return whether the clock gate is open."""
        return self._clocked

    @clocked.setter
    def clocked(self, clocked: bool) -> None:
        self._clocked = clocked
        lib.machine_set_clocked(self._handle, self.base, clocked)

    def read(self, offset: int, size: int) -> int:
        value: int = lib.machine_read_device(self._handle, self.base + offset, size)
        return value

    def write(self, offset: int, size: int, value: int) -> None:
        lib.machine_write_device(self._handle, self.base + offset, size, value)

    def reset(self) -> None:
        lib.machine_reset_device(self._handle, self.base)
