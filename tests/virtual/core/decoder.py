"""The core's decoder, for tests: instructions as objects, and random instances of its encodings."""

from __future__ import annotations

import random
from collections.abc import Iterator
from dataclasses import dataclass
from functools import cache
from typing import Any

from .inner_library import inner_library

GROUPS = (("narrow_groups", 2), ("data_groups", 4), ("access_groups", 4), ("float_groups", 4))  # bytes of each
WIDE = 0xE800  # halfwords from here on are the first of two
IT_ALWAYS = 0xE8  # ITSTATE of a block of one instruction with condition "always"
SP = 13
REGISTER_FIELDS = (0, 8, 12, 16)  # lowest bits of the fields where registers stand
STACK_POINTERS = 0.25  # of the instances: two of those fields are the SP, which has rules of its own


@dataclass(frozen=True)
class Encoding:
    """One row of the decoder's tables."""

    name: str
    mask: int
    value: int
    size: int

    def instance(self, source: random.Random) -> tuple[int, int]:
        """Return the two halfwords of a random instruction of this encoding."""
        free = source.getrandbits(32)
        if source.random() < STACK_POINTERS:
            for low in source.sample(REGISTER_FIELDS, k=2):
                free = free & ~(0xF << low) | SP << low
        bits = self.value | free & ~self.mask
        return (bits & 0xFFFF, source.getrandbits(16)) if self.size == 2 else (bits >> 16, bits & 0xFFFF)


def _encodings(groups: str, size: int) -> Iterator[Encoding]:
    ffi, library = inner_library()
    group = ffi.addressof(library, groups)
    while group.count:
        for row in ffi.unpack(group.rows, group.count):
            yield Encoding(ffi.string(row.name).decode(), row.mask, row.value, size)
        group += 1


@cache
def encodings() -> list[Encoding]:
    return [encoding for groups, size in GROUPS for encoding in _encodings(groups, size)]


def decode(address: int, first: int, second: int = 0, it_state: int = 0, *, baseline: bool = False) -> Any:
    """Return the `struct instruction` of an instruction."""
    ffi, library = inner_library()
    decoded = ffi.new("struct instruction *")
    library.decode_instruction(address, first, second, it_state, baseline, decoded)
    return decoded


def operation_name(decoded: Any) -> str:
    ffi, _ = inner_library()
    name: str = ffi.typeof("enum operation").elements[decoded.operation]
    return name.removeprefix("OP_")


def fields(decoded: Any) -> dict[str, int]:
    """Return all fields of a `struct instruction`."""
    ffi, _ = inner_library()
    return {name: getattr(decoded, name) for name, _ in ffi.typeof(decoded).item.fields}


@cache
def _rows() -> list[str]:
    _, library = inner_library()
    names = [name for name in dir(library) if name.startswith("ROW_")]
    numbered = {getattr(library, name): name.removeprefix("ROW_") for name in names}
    return [numbered[number] for number in range(library.INSTRUCTION_ROWS)]


def row_name(decoded: Any) -> str:
    return _rows()[decoded.row]


def random_instructions(count: int, seed: int) -> Iterator[tuple[int, int]]:
    """Yield random pairs of halfwords, four fifths of them instructions of four bytes."""
    source = random.Random(seed)
    for _ in range(count):
        first = source.getrandbits(16) | (WIDE if source.random() < 0.8 else 0)
        yield first, source.getrandbits(16)


def instances(count: int, seed: int) -> Iterator[tuple[int, int]]:
    """Yield `count` random instances of each encoding."""
    source = random.Random(seed)
    for encoding in encodings():
        for _ in range(count):
            yield encoding.instance(source)
