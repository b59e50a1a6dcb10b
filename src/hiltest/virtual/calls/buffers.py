"""Buffers as arguments of a called function, including C structs with pointers."""

from __future__ import annotations

import struct
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from typing import Any

_POINTER_BYTES = 4


@dataclass(frozen=True, slots=True)
class Address:
    """A member of a `Structure` that points to another buffer."""

    buffer: Any


class Structure:
    """A C struct, which is passed by address.

    Parameters
    ----------
    *members
        Members in order. As in the procedure call standard, each is aligned to its item size, and the size of the
        struct is a multiple of the largest item size.

    Examples
    --------
    A pointer, a count and two limits, in 12 bytes::

        Structure(Address(points), np.array([len(points)], np.uint16), np.array([low, high], np.int16))
    """

    def __init__(self, *members: Any) -> None:
        self.members = members

    @property
    def alignment(self) -> int:
        return max((_alignment(member) for member in self.members), default=1)

    @property
    def size(self) -> int:
        """Size with padding [bytes]."""
        end = max((offset + _size(member) for offset, member in self.layout()), default=0)
        return _round_up(end, self.alignment)

    def layout(self) -> Iterator[tuple[int, Any]]:
        """Yield each member with its offset [bytes]."""
        offset = 0
        for member in self.members:
            offset = _round_up(offset, _alignment(member))
            yield offset, member
            offset += _size(member)


def place(buffer: Any, reserve: Callable[[int], int], write: Callable[[int, Any], None]) -> int:
    """Copy a buffer to target memory, after the buffers that it points to.

    Parameters
    ----------
    reserve
        ``reserve(size)`` allocates memory and returns its address.
    write
        ``write(address, buffer)`` copies a plain buffer.

    Returns
    -------
    int
        Address of the buffer.
    """
    if not isinstance(buffer, Structure):
        address = reserve(memoryview(buffer).nbytes)
        write(address, buffer)
        return address
    targets = {
        offset: place(member.buffer, reserve, write)
        for offset, member in buffer.layout()
        if isinstance(member, Address)
    }
    address = reserve(buffer.size)
    write(address, bytes(buffer.size))
    for offset, member in buffer.layout():
        write(address + offset, struct.pack("<I", targets[offset]) if offset in targets else member)
    return address


def _alignment(member: Any) -> int:
    return _POINTER_BYTES if isinstance(member, Address) else max(memoryview(member).itemsize, 1)


def _size(member: Any) -> int:
    return _POINTER_BYTES if isinstance(member, Address) else memoryview(member).nbytes


def _round_up(value: int, multiple: int) -> int:
    return -(-value // multiple) * multiple
