"""Reading many places of memory in few packets: over a probe each packet halts the processor a millisecond longer."""

from __future__ import annotations

from collections.abc import Iterable

from hiltest.interfaces.places import ReadMemory

# Largest gap that is read along [byte]: another packet would cost more.
_NEAR = 128


def together(ranges: Iterable[tuple[int, int]]) -> tuple[tuple[int, int], ...]:
    """Return ranges (address, size) that cover all given ones, with near ones merged."""
    merged: list[tuple[int, int]] = []
    for begin, size in sorted(ranges):
        if merged and begin <= merged[-1][0] + merged[-1][1] + _NEAR:
            first, before = merged[-1]
            merged[-1] = first, max(before, begin + size - first)
        else:
            merged.append((begin, size))
    return tuple(merged)


class ReadAhead:
    """Memory of a halted processor with some ranges read in advance; others are read on request.

    Parameters
    ----------
    memory
        ``memory(address, size)`` reads memory.
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
