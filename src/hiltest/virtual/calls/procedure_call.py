"""Registers and stack words of arguments and results (AAPCS), for hard float and soft float."""

from __future__ import annotations

import struct
from collections.abc import Callable, Sequence
from typing import Any

import numpy as np

from hiltest.errors import ConfigError
from hiltest.virtual.program.signatures import Element, Pointed, Signature

#: Value of a C type: a number, or a buffer that is passed by address.
Argument = int | float | bytes | bytearray | Any

_FLOAT_REGISTERS = 16
_WIDE = ("signed64", "unsigned64", "double")
_UNSUPPORTED = "a struct or another type that cannot be passed by value here"
_FLOATS = frozenset("efdg")  # format codes of struct and numpy
_CODES = _FLOATS | frozenset("?bBhHiIlLqQ")
_BUFFERS = "bytes, a bytearray, a contiguous numpy array or a Structure"


class ArgumentRegisters:
    """Allocator of core words (r0 to r3, then the stack) and float registers (s0 to s15) to arguments.

    Parameters
    ----------
    hard_float
        True if floats are passed in float registers; otherwise they are passed like integers.

    Attributes
    ----------
    core : list of int
        Words of the registers, then of the stack in ascending order.
    floating : list of int
        Words of all float registers.
    """

    def __init__(self, *, hard_float: bool) -> None:
        self.core: list[int] = []
        self.floating = [0] * _FLOAT_REGISTERS
        self._hard_float = hard_float
        self._free = list(range(_FLOAT_REGISTERS))

    def put(self, kind: str, bits: int) -> bool:
        """Allocate one value by its type; return False if no float register is free for it."""
        words = [bits & 0xFFFFFFFF, bits >> 32] if kind in _WIDE else [bits]
        if not self._hard_float or kind not in ("float", "double"):
            if kind in _WIDE and len(self.core) % 2:
                self.core.append(0)  # eight bytes begin at an even register, or on the stack at a multiple of eight
            self.core += words
            return True
        # The lowest free register: a float may fill the gap before a double.
        place = next((register for register in self._free if self._fits(register, len(words))), None)
        if place is None:
            return False
        for offset, word in enumerate(words):
            self.floating[place + offset] = word
            self._free.remove(place + offset)
        return True

    def _fits(self, place: int, words: int) -> bool:
        return words == 1 or (place % 2 == 0 and place + 1 in self._free)


def assign(
    symbol: str,
    signature: Signature | None,
    arguments: Sequence[Argument],
    place: Callable[[Any], int],
    *,
    hard_float: bool,
) -> tuple[list[int], list[int]]:
    """Distribute arguments over core words (registers, then stack) and float registers.

    Parameters
    ----------
    symbol
        Name of the function, for messages.
    signature
        None without debug information; only integers and buffers can then be passed.
    place
        Copies a buffer to the board's RAM and returns its address.

    Raises
    ------
    ConfigError
        If the arguments do not fit the function.
    """
    kinds = signature.parameters if signature else ("unsigned",) * len(arguments)
    if signature and len(kinds) != len(arguments):
        raise ConfigError(f"{symbol} takes {len(kinds)} arguments, not {len(arguments)}")
    if signature and signature.returns == "unsupported":
        raise ConfigError(f"{symbol} returns {_UNSUPPORTED}; write a wrapper that returns another type")
    registers = ArgumentRegisters(hard_float=hard_float)
    pointed = signature.pointed if signature and signature.pointed else (None,) * len(kinds)
    for position, (kind, argument) in enumerate(zip(kinds, arguments, strict=True), start=1):
        where = f"argument {position} of {symbol}"
        if kind == "unsupported":
            raise ConfigError(f"{where} is {_UNSUPPORTED}; write a wrapper with other types")
        _check_buffer(where, pointed[position - 1], argument)
        bits = _bits(where, kind, argument, place, typed=signature is not None)
        if not registers.put(kind, bits):
            raise ConfigError(
                f"{symbol} takes more floats than fit into registers; write a wrapper that takes a buffer"
            )
    return registers.core, registers.floating


def _check_buffer(where: str, pointed: Pointed | None, argument: Argument) -> None:
    """Reject a buffer with a number type that the function does not expect; bytes may hold any type."""
    if pointed is None or not pointed.elements or isinstance(argument, int | float | bytes | bytearray | np.generic):
        return
    try:
        view = memoryview(argument)
    except (TypeError, ValueError):  # a Structure; or not a buffer, which `place` rejects
        return
    code = view.format.lstrip("@=<>!Z")  # Z: complex, a pair of the next code
    if code not in _CODES:
        return
    element = Element(code in _FLOATS, view.itemsize // (2 if "Z" in view.format else 1))
    if element not in pointed.elements:
        kind = "float" if element.is_float else "uint" if code.isupper() else "int"
        expected = " or ".join(sorted(map(str, pointed.elements)))
        name = f"{kind}{8 * element.size}"
        raise ConfigError(f"{where} is {pointed.text}, not an array of {name}: pass {expected}, or bytes")


def _bits(where: str, kind: str, argument: Argument, place: Callable[[Any], int], *, typed: bool) -> int:
    """Return an argument as the bits of its type."""
    if isinstance(argument, np.generic):
        argument = argument.item()  # otherwise it would be passed by address, because it is a buffer too
    if kind in ("float", "double"):
        return _float_bits(where, kind, argument)
    if isinstance(argument, int):
        return _integer_bits(where, kind, argument)
    if isinstance(argument, float):
        reason = "" if typed else " (without debug information only integers can be passed)"
        raise ConfigError(f"{where} is {kind}, not float{reason}")
    if kind in _WIDE:
        raise ConfigError(f"{where} is {kind}, not a buffer")
    try:
        return place(argument)
    except TypeError as error:
        argument_type = type(argument).__name__
        raise ConfigError(f"{where} cannot be {argument_type}: pass a number, {_BUFFERS} ({error})") from error


def _integer_bits(where: str, kind: str, value: int) -> int:
    size = 64 if kind in _WIDE else 32
    if not -(1 << (size - 1)) <= value < 1 << size:
        raise ConfigError(f"{where}: {value} does not fit its {size} bits")
    return value & ((1 << size) - 1)


def _float_bits(where: str, kind: str, argument: Argument) -> int:
    if not isinstance(argument, int | float):
        raise ConfigError(f"{where} is {kind}, not {type(argument).__name__}: pass a number")
    try:
        return int.from_bytes(struct.pack("<d" if kind == "double" else "<f", float(argument)), "little")
    except OverflowError as error:
        raise ConfigError(f"{where}: {argument} is beyond the largest {kind}") from error


def result(kind: str, core: Sequence[int], floating: Sequence[int], *, hard_float: bool) -> int | float | None:
    """Return the value that a function returned.

    Parameters
    ----------
    kind
        Type of the value, as in `Signature.returns`.
    core, floating
        r0 and r1, s0 and s1, after the return.
    """
    if kind == "void":
        return None
    if kind in ("float", "double"):
        low, high = (floating if hard_float else core)[:2]
        value: float = struct.unpack(
            *(("<f", struct.pack("<I", low)) if kind == "float" else ("<d", struct.pack("<II", low, high)))
        )[0]
        return value
    bits = 64 if kind in _WIDE else 32
    word = (core[0] | core[1] << 32) if kind in _WIDE else core[0]
    return word - (1 << bits) if kind.startswith("signed") and word >> (bits - 1) else word
