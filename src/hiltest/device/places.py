"""Where a value lies in memory, and what the bytes there mean."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import TypeAlias

from hiltest.device.c_types import POINTER_BYTES, BitField, NumberType, decoded

ReadMemory: TypeAlias = Callable[[int, int], bytes]


class NullPointer(Exception):
    """A pointer on the way to a value is 0 now."""


@dataclass(frozen=True, slots=True)
class Scalar:
    """A number within what a path leads to."""

    offset: int
    """Bytes from its beginning, to the first byte that has bits of it."""
    size: int
    """Bytes to read."""
    kind: NumberType
    bits: BitField | None = None


@dataclass(frozen=True, slots=True)
class Place:
    """Where a path leads: an address, through pointers that are read when the value is, and the numbers there."""

    path: str
    type_text: str
    """Type of the value as C has it."""
    address: int
    """Of the value, or of the first pointer."""
    beyond: tuple[int, ...]
    """For every pointer, the bytes to add to what it holds."""
    scalars: tuple[Scalar, ...]

    def read(self, memory: ReadMemory) -> bytes:
        """Return the bytes of the value, from the first number to the last.

        Raises
        ------
        NullPointer
            When a pointer on the way is 0.
        """
        address = self.address
        for offset in self.beyond:
            pointer = int.from_bytes(memory(address, POINTER_BYTES), "little")
            if pointer == 0:
                raise NullPointer(f"{self.path}: the pointer at 0x{address:08x} is 0 now")
            address = pointer + offset & 0xFFFFFFFF
        return memory(address + self._first & 0xFFFFFFFF, self._size)

    @property
    def extent(self) -> tuple[int, int]:
        """Address and size of what is read first: the value, or the first pointer on the way to it."""
        return (self.address, POINTER_BYTES) if self.beyond else (self.address + self._first, self._size)

    def numbers(self, data: bytes) -> tuple[float, ...]:
        """Return the numbers in the bytes that `read` gave; integers stay integers."""
        return tuple(
            decoded(each.kind, data[each.offset - self._first :][: each.size], each.bits) for each in self.scalars
        )

    def shown(self, data: bytes) -> str:
        """Write the numbers, an enum's with their names."""
        written = [
            f"{each.kind.labels[int(number)]} ({number})" if number in each.kind.labels else f"{number:g}"
            for each, number in zip(self.scalars, self.numbers(data), strict=True)
        ]
        return ", ".join(written)

    @property
    def _first(self) -> int:
        return min(each.offset for each in self.scalars)

    @property
    def _size(self) -> int:
        return max(each.offset + each.size for each in self.scalars) - self._first


def scalar(kind: NumberType, offset: int, bits: BitField | None = None) -> Scalar:
    """Return a number that lies so many bytes from a beginning, or in bits from there on."""
    if bits is None:
        return Scalar(offset, kind.size, kind)
    return Scalar(offset + bits.first // 8, (bits.first % 8 + bits.bits + 7) // 8, kind, bits)
