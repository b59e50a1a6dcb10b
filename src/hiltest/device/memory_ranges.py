"""Reading many places of memory in few packets: each costs a halted processor a millisecond or more over a probe."""

from __future__ import annotations

from collections.abc import Iterable

from hiltest.device.places import ReadMemory

# What lies so near is read together [bytes]: a packet more costs more than these.
_NEAR = 128


def together(ranges: Iterable[tuple[int, int]]) -> tuple[tuple[int, int], ...]:
    """Return the ranges (address, size) that cover all given ones, near ones as one."""
    found: list[tuple[int, int]] = []
    for begin, size in sorted(ranges):
        if found and begin <= found[-1][0] + found[-1][1] + _NEAR:
            first, before = found[-1]
            found[-1] = first, max(before, begin + size - first)
        else:
            found.append((begin, size))
    return tuple(found)


class ReadAhead:
    """Memory of a halted processor of which some ranges were read at once; others are read when they are asked for.

    Parameters
    ----------
    memory
        ``memory(address, size)`` reads.
    """

    def __init__(self, memory: ReadMemory, ranges: Iterable[tuple[int, int]]) -> None:
        self._memory = memory
        self._read = [(begin, memory(begin, size)) for begin, size in ranges]

    def __call__(self, address: int, size: int) -> bytes:
        """Return bytes."""
        for begin, data in self._read:
            if begin <= address and address + size <= begin + len(data):
                return data[address - begin :][:size]
        return self._memory(address, size)
