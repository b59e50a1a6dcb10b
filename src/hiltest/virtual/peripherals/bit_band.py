"""The bit-band aliases: a word for every bit of the first megabyte of SRAM_U, and of the peripherals."""

from __future__ import annotations

from typing import Protocol

from hiltest.virtual.memory import BoardMemory

_WINDOW = 0x02000000  # 32 addresses for each byte of a megabyte
SRAM_ALIAS = (0x22000000, _WINDOW)
PERIPHERAL_ALIAS = (0x42000000, _WINDOW)


class AliasedBytes(Protocol):
    """A memory or peripheral whose bits are aliased."""

    def read(self, address: int, size: int) -> int:
        """Answer a read of 1, 2 or 4 bytes."""
        ...

    def write(self, address: int, size: int, value: int) -> None:
        """Take a write."""
        ...

    def reason_against(self, address: int, size: int) -> str | None:
        """Say why an access is a bus error, if it is."""
        ...


class AliasedSram:
    """SRAM_U, as its alias reaches it.

    Parameters
    ----------
    memory : BoardMemory
        Has it.
    """

    def __init__(self, memory: BoardMemory) -> None:
        self._memory = memory

    def read(self, address: int, size: int) -> int:
        """Answer a read."""
        return int.from_bytes(self._memory.read(address, size), "little")

    def write(self, address: int, size: int, value: int) -> None:
        """Take a write."""
        self._memory.write(address, value.to_bytes(size, "little"))

    def reason_against(self, address: int, size: int) -> str | None:
        """Say where there is no memory."""
        return None if self._memory.holds_stack(address, size) else f"unmapped address 0x{address:08x}"


class BitBandAlias:
    """One of the two windows; a write reads what has the bit and writes it back, in the size of the access.

    Parameters
    ----------
    region : tuple of int
        First address of the window, and its size.
    target : AliasedBytes
        What it is an alias of, from 32 MiB below on.
    """

    def __init__(self, region: tuple[int, int], target: AliasedBytes) -> None:
        self.region = region
        self._target = target
        self._first = region[0] - _WINDOW

    def _locate(self, address: int, size: int) -> tuple[int, int]:
        """Find the address of what has a bit, and the bit's place in it."""
        bit = address - self.region[0] >> 2
        return self._first + (bit >> 3 & -size), bit & 8 * size - 1

    def read(self, address: int, size: int) -> int:
        """Answer one bit."""
        where, bit = self._locate(address, size)
        return self._target.read(where, size) >> bit & 1

    def write(self, address: int, size: int, value: int) -> None:
        """Set or clear one bit."""
        where, bit = self._locate(address, size)
        before = self._target.read(where, size)
        self._target.write(where, size, before & ~(1 << bit) | (value & 1) << bit)

    def reason_against(self, address: int, size: int) -> str | None:
        """Say why an access is a bus error, if it is."""
        reason = self._target.reason_against(self._locate(address, size)[0], size)
        return reason and f"{reason} through its bit-band alias 0x{address:08x}"
