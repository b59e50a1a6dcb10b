"""Places of values in memory, and the decoding of their bytes."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import TypeAlias

from hiltest.interfaces.c_types import POINTER_BYTES, BitField, NumberType, decoded

ReadMemory: TypeAlias = Callable[[int, int], bytes]


class NullPointer(Exception):
    """Null pointer on the way to a value."""


@dataclass(frozen=True, slots=True)
class Scalar:
    """A number within a value."""

    offset: int
    """Offset of its first byte in the value [byte]."""
    size: int
    """Number of bytes to read."""
    kind: NumberType
    bits: BitField | None = None


@dataclass(frozen=True, slots=True)
class Place:
    """Place of a value: an address, pointers that are followed at each reading, and the numbers there."""

    path: str
    type_text: str
    """C type of the value."""
    address: int
    """Address of the value, or of the first pointer."""
    beyond: tuple[int, ...]
    """Offset to add to the value of each pointer [byte]."""
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
        """Address and size of the first read: the value, or the first pointer on the way to it."""
        return (self.address, POINTER_BYTES) if self.beyond else (self.address + self._first, self._size)

    def numbers(self, data: bytes) -> tuple[float, ...]:
        """Decode the numbers in the bytes from `read`; integers stay integers."""
        return tuple(
            decoded(number_at.kind, data[number_at.offset - self._first :][: number_at.size], number_at.bits)
            for number_at in self.scalars
        )

    def shown(self, data: bytes) -> str:
        """Format the numbers, with the names of enumerators."""
        written = [
            f"{number_at.kind.labels[int(number)]} ({number})" if number in number_at.kind.labels else f"{number:g}"
            for number_at, number in zip(self.scalars, self.numbers(data), strict=True)
        ]
        return ", ".join(written)

    @property
    def _first(self) -> int:
        return min(number_at.offset for number_at in self.scalars)

    @property
    def _size(self) -> int:
        return max(number_at.offset + number_at.size for number_at in self.scalars) - self._first


def scalar(kind: NumberType, offset: int, bits: BitField | None = None) -> Scalar:
    """Return a number at an offset, or in bits from there on."""
    if bits is None:
        return Scalar(offset, kind.size, kind)
    return Scalar(offset + bits.first // 8, (bits.first % 8 + bits.bits + 7) // 8, kind, bits)
