"""Decoder of instructions, which is that of the core."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

from hiltest.virtual.core.library import ffi, lib

_AT_ONCE = 32  # few instructions, because callers often stop at a jump


def decode(address: int, code: bytes) -> Iterator[Any]:
    """Yield the instructions of code that begins outside an IT block, see struct machine_instruction.

    Parameters
    ----------
    address : int
        Address of the first byte.
    code : bytes
        Code; an incomplete last instruction is omitted.
    """
    decoded, it_state = ffi.new("struct machine_instruction[]", _AT_ONCE), ffi.new("uint8_t *")
    begin, place = ffi.from_buffer(code), 0
    while count := lib.machine_decode(address + place, begin + place, len(code) - place, it_state, decoded, _AT_ONCE):
        for index in range(count):
            yield ffi.new("struct machine_instruction *", decoded[index])  # a copy, because `decoded` is reused
        place = decoded[count - 1].address + decoded[count - 1].size - address


def decode_first(address: int, code: bytes) -> Any:
    """Return the first instruction of some code; None if the code is shorter."""
    return next(decode(address, code), None)
