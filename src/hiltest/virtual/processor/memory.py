"""The board's memories, shared by the core and Python."""

from __future__ import annotations

import struct
from contextlib import suppress
from functools import lru_cache

from hiltest.virtual.core.library import ffi, lib
from hiltest.virtual.core.machine import Machine
from hiltest.virtual.part.chip import MemoryMap, Region, memories

MK64FN1M0 = memories()
(FLASH,), (SRAM,) = MK64FN1M0.flash, MK64FN1M0.ram  # SRAM_L ends, and SRAM_U begins, at 0x20000000
PERIPHERALS = (0x40000000, 0x100000)
PRIVATE_PERIPHERALS = (0xE0000000, 0x100000)
#: First and last addresses where memories may be: not in bit-band aliases, devices or the processor's registers.
PLAIN = ((0x00000000, 0x21FFFFFF), (0x24000000, 0x3FFFFFFF), (0x60000000, 0xDFFFFFFF))


@lru_cache
def _words(count: int) -> struct.Struct:
    """Return the format of little-endian words."""
    return struct.Struct(f"<{count}I")


class SharedMemory:
    """One memory of the machine.

    Attributes
    ----------
    view : memoryview
        Its bytes, for reading only: `BoardMemory.write` writes them.
    """

    def __init__(self, machine: Machine, region: Region, *, writable: bool, alias: int | None = None) -> None:
        self.base, self.size = region
        if alias is None:
            self.view = machine.add_memory(self.base, self.size, writable=writable)
        else:
            self.view, self.base = machine.add_alias(alias, self.base, self.size), alias

    def __contains__(self, address: int) -> bool:
        return self.base <= address < self.base + self.size


class BoardMemory:
    """Flash and SRAM.

    Attributes
    ----------
    sram : SharedMemory
        The largest RAM, which has stack and arguments of called functions.
    """

    def __init__(self, machine: Machine, regions: MemoryMap = MK64FN1M0) -> None:
        self.map = regions
        self._handle = machine.handle
        self._flash = [SharedMemory(machine, region, writable=False) for region in regions.flash]
        self._ram = [SharedMemory(machine, region, writable=True) for region in regions.ram]
        self.sram = max(self._ram, key=lambda memory: memory.size)
        aliases = [SharedMemory(machine, region, writable=False, alias=base) for base, region in regions.aliases]
        self._plain = (*self._flash, *self._ram, *aliases)

    def read(self, address: int, size: int) -> bytes:
        """Read flash or SRAM.

        Raises
        ------
        ValueError
            If the range is in neither.
        """
        memory = self._holding(address, size)
        return bytes(memory.view[address - memory.base : address - memory.base + size])

    def code_at(self, address: int) -> bytes:
        """Return the four bytes at an address, two at the end of a memory, none outside of memories."""
        for size in (4, 2):
            with suppress(ValueError):
                return self.read(address, size)
        return b""

    def write(self, address: int, data: bytes) -> None:
        """Write flash or SRAM, as a programmer or a debugger does."""
        self._holding(address, len(data))
        lib.machine_write(self._handle, address, len(data), ffi.from_buffer(data))

    def _holding(self, address: int, size: int) -> SharedMemory:
        for memory in self._plain:
            if memory.base <= address and address + size <= memory.base + memory.size:
                return memory
        raise ValueError(f"0x{address:08x}..+{size} is neither flash nor SRAM")

    def holds_stack(self, address: int, size: int) -> bool:
        """Return whether a range is in RAM, where a stack may be."""
        return any(memory.base <= address and address + size <= memory.base + memory.size for memory in self._ram)

    def read_words(self, address: int, count: int) -> tuple[int, ...]:
        memory = self._holding(address, 4 * count)
        return _words(count).unpack_from(memory.view, address - memory.base)

    def write_words(self, address: int, values: list[int]) -> None:
        self.write(address, _words(len(values)).pack(*values))

    def clear(self) -> None:
        """Erase flash and clear SRAM, as at power-on."""
        for memory in self._flash:
            self.write(memory.base, b"\xff" * memory.size)
        for memory in self._ram:
            self.write(memory.base, bytes(memory.size))
