"""The board's memories, shared between the emulator and Python.

The emulator works on buffers that Python owns, so a stack frame or a register
of a peripheral is a slice of a `memoryview`, not a call.
"""

from __future__ import annotations

import ctypes
import struct
from functools import lru_cache
from typing import Any

from unicorn import UC_PROT_EXEC, UC_PROT_READ, UC_PROT_WRITE

from hiltest.virtual.chip import MemoryMap, Region, memories

_PAGE = 4096

MK64FN1M0 = memories()
(FLASH,), (SRAM,) = MK64FN1M0.flash, MK64FN1M0.ram  # SRAM_L ends, and SRAM_U begins, at 0x20000000
PERIPHERALS = (0x40000000, 0x100000)
PRIVATE_PERIPHERALS = (0xE0000000, 0x100000)
#: Where memories may be, first and last address: neither bit-band alias nor devices nor the processor's own registers.
PLAIN = ((0x00000000, 0x21FFFFFF), (0x24000000, 0x3FFFFFFF), (0x60000000, 0xDFFFFFFF))


@lru_cache
def _words(count: int) -> struct.Struct:
    """Return the format of little-endian words."""
    return struct.Struct(f"<{count}I")


class SharedMemory:
    """A range of target addresses backed by a buffer of ours.

    Parameters
    ----------
    engine : Uc
        The emulator.
    region : Region
    permissions : int
        The emulator's ``UC_PROT_*`` bits.
    """

    def __init__(self, engine: Any, region: Region, permissions: int) -> None:
        self.base, self.size = region
        self._buffer = ctypes.create_string_buffer(self.size + _PAGE)
        start = (ctypes.addressof(self._buffer) + _PAGE - 1) & ~(_PAGE - 1)
        offset = start - ctypes.addressof(self._buffer)
        self.view = memoryview(self._buffer).cast("B")[offset : offset + self.size]
        engine.mem_map_ptr(self.base, self.size, permissions, start)

    def __contains__(self, address: int) -> bool:
        return self.base <= address < self.base + self.size


class BoardMemory:
    """Flash and SRAM.

    Parameters
    ----------
    engine : Uc
        The emulator.
    regions : MemoryMap
        Where they are.

    Attributes
    ----------
    sram : SharedMemory
        The RAM for stack and arguments of a called function: the largest.
    """

    def __init__(self, engine: Any, regions: MemoryMap = MK64FN1M0) -> None:
        self.map = regions
        self._flash = [SharedMemory(engine, each, UC_PROT_READ | UC_PROT_EXEC) for each in regions.flash]
        self._ram = [SharedMemory(engine, each, UC_PROT_READ | UC_PROT_WRITE | UC_PROT_EXEC) for each in regions.ram]
        self.sram = max(self._ram, key=lambda each: each.size)
        self._plain = (*self._flash, *self._ram)

    def read(self, address: int, size: int) -> bytes:
        """Read flash or SRAM.

        Raises
        ------
        ValueError
            If the range is neither.
        """
        memory = self._holding(address, size)
        return bytes(memory.view[address - memory.base : address - memory.base + size])

    def write(self, address: int, data: bytes) -> None:
        """Write flash or SRAM, as a programmer or a debugger does."""
        memory = self._holding(address, len(data))
        memory.view[address - memory.base : address - memory.base + len(data)] = data

    def _holding(self, address: int, size: int) -> SharedMemory:
        for memory in self._plain:
            if memory.base <= address and address + size <= memory.base + memory.size:
                return memory
        raise ValueError(f"0x{address:08x}..+{size} is neither flash nor SRAM")

    def holds_stack(self, address: int, size: int) -> bool:
        """Whether a range is RAM, where a stack may be."""
        for each in self._ram:  # noqa: SIM110 - twice an exception, and a generator costs more than what it asks
            if each.base <= address and address + size <= each.base + each.size:
                return True
        return False

    def read_words(self, address: int, count: int) -> tuple[int, ...]:
        """Read little-endian words."""
        memory = self._holding(address, 4 * count)
        return _words(count).unpack_from(memory.view, address - memory.base)

    def write_words(self, address: int, values: list[int]) -> None:
        """Write little-endian words."""
        self.write(address, _words(len(values)).pack(*values))

    def clear(self) -> None:
        """Power-on content: flash erased, SRAM zero."""
        for each in self._flash:
            each.view[:] = b"\xff" * each.size
        for each in self._ram:
            each.view[:] = bytes(each.size)
