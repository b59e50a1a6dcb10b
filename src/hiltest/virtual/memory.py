"""The board's memories, shared between the emulator and Python.

The emulator works on buffers that Python owns, so a stack frame or a register
of a peripheral is a slice of a `memoryview`, not a call.
"""

from __future__ import annotations

import ctypes
import struct
from typing import Any

from unicorn import UC_PROT_EXEC, UC_PROT_READ, UC_PROT_WRITE

_PAGE = 4096

FLASH = (0x00000000, 0x100000)
SRAM = (0x1FFF0000, 0x40000)  # SRAM_L 64 KiB, then SRAM_U 192 KiB from 0x20000000
PERIPHERALS = (0x40000000, 0x100000)
PRIVATE_PERIPHERALS = (0xE0000000, 0x100000)


class SharedMemory:
    """A range of target addresses backed by a buffer of ours.

    Parameters
    ----------
    engine : Uc
        The emulator.
    region : tuple of int
        First address and size.
    permissions : int
        The emulator's ``UC_PROT_*`` bits.
    """

    def __init__(self, engine: Any, region: tuple[int, int], permissions: int) -> None:
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
    """

    def __init__(self, engine: Any) -> None:
        self.flash = SharedMemory(engine, FLASH, UC_PROT_READ | UC_PROT_EXEC)
        self.sram = SharedMemory(engine, SRAM, UC_PROT_READ | UC_PROT_WRITE | UC_PROT_EXEC)
        self._plain = (self.flash, self.sram)

    def read(self, address: int, size: int) -> bytes:
        """Read flash or SRAM.

        Raises
        ------
        ValueError
            If the range is neither.
        """
        for memory in self._plain:
            if memory.base <= address and address + size <= memory.base + memory.size:
                return bytes(memory.view[address - memory.base : address - memory.base + size])
        raise ValueError(f"0x{address:08x}..+{size} is neither flash nor SRAM")

    def write(self, address: int, data: bytes) -> None:
        """Write flash or SRAM, as a programmer or a debugger does."""
        for memory in self._plain:
            if memory.base <= address and address + len(data) <= memory.base + memory.size:
                memory.view[address - memory.base : address - memory.base + len(data)] = data
                return
        raise ValueError(f"0x{address:08x}..+{len(data)} is neither flash nor SRAM")

    def holds_stack(self, address: int, size: int) -> bool:
        """Whether a range is RAM, where a stack may be."""
        return self.sram.base <= address and address + size <= self.sram.base + self.sram.size

    def read_words(self, address: int, count: int) -> tuple[int, ...]:
        """Read little-endian words."""
        return struct.unpack(f"<{count}I", self.read(address, 4 * count))

    def write_words(self, address: int, values: list[int]) -> None:
        """Write little-endian words."""
        self.write(address, struct.pack(f"<{len(values)}I", *values))

    def clear(self) -> None:
        """Power-on content: flash erased, SRAM zero."""
        self.flash.view[:] = b"\xff" * self.flash.size
        self.sram.view[:] = bytes(self.sram.size)
