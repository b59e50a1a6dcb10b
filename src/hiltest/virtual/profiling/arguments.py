"""Arguments of a function on a command line.

=========================  =======================================================
``42``, ``-7``, ``0x2a``   an integer
``2.5``, ``1e-3``          a float
``int16:1,-2,3``           numbers of a type, passed by address
``float32:@data.csv``      the numbers in a text file, row by row
``zeros:64``               that many zero bytes, for the function to fill
``zeros:float32:12``       that many zeros of a type
``text:hello``             characters, with a zero after them
``@data.bin``              the bytes of a file
``A+B``                    buffers as the members of a C struct
``ptr:A``                  as a member of a struct: the address of buffer A
=========================  =======================================================
"""

from __future__ import annotations

import math
import re
from contextlib import suppress
from pathlib import Path
from typing import Any

import numpy as np

from hiltest.budgets import ARGUMENT
from hiltest.errors import ConfigError
from hiltest.virtual.calls.buffers import Address, Structure
from hiltest.virtual.calls.procedure_call import Argument

_TYPES = {
    name: np.dtype(name).newbyteorder("<")
    for name in ("int8", "uint8", "int16", "uint16", "int32", "uint32", "int64", "uint64", "float32", "float64")
}
# A "+" separates members if a member follows it; otherwise it belongs to a number or a name.
_SEPARATOR = re.compile(rf"\+(?=(?:ptr:)*(?:@|(?:{'|'.join(_TYPES)}|zeros|text):))")
_FORMS = "an integer, a float, int16:1,2,3, int16:@file.csv, zeros:N, zeros:int16:N, text:..., @file or members with +"


def parse_argument(text: str) -> Argument:
    """Read one argument.

    Raises
    ------
    ConfigError
        If the text is not an argument, or a named file cannot be read.
    """
    number = _number(text)
    if isinstance(number, int) and not -(1 << 63) <= number < 1 << 64:
        raise ConfigError(f"{text} does not fit into 64 bits, the largest integer argument")
    if number is not None:
        return number
    if text.count("ptr:") > ARGUMENT.nesting:
        raise ConfigError(f"more than {ARGUMENT.nesting} pointers, the budget of an argument; write a shorter one")
    members = [_member(part) for part in _SEPARATOR.split(text)]
    if len(members) == 1 and not isinstance(members[0], Address):
        return members[0]
    return Structure(*members)


def _number(text: str) -> int | float | None:
    for base in (0, 10):  # 10 for leading zeros, as in tables
        with suppress(ValueError):
            return int(text, base)
    with suppress(ValueError):
        return float(text)
    return None


def _member(text: str) -> Any:
    if text.startswith("@"):
        return _content(text[1:], most=ARGUMENT.items)
    kind, colon, rest = text.partition(":")
    if kind == "ptr" and colon:
        return Address(_member(rest))
    if kind == "text" and colon:
        return rest.encode() + b"\0"
    if kind == "zeros" and colon:
        return _zeros(text, rest)
    if kind in _TYPES and colon:
        return _array(text, kind, rest)
    raise ConfigError(f"{text!r} is not an argument; write {_FORMS}")


def _zeros(text: str, rest: str) -> Any:
    kind, colon, count = rest.rpartition(":")
    if (
        not count.isdecimal()
        or len(count) > 9
        or not 1 <= int(count) <= ARGUMENT.items
        or (colon and kind not in _TYPES)
    ):
        raise ConfigError(f"{text!r}: write zeros:64 for bytes or zeros:float32:12, within the size of the RAM")
    return np.zeros(int(count), _TYPES[kind]) if colon else bytearray(int(count))


def _array(text: str, kind: str, rest: str) -> Any:
    source = _content(rest[1:], most=ARGUMENT.bytes).decode(errors="replace") if rest.startswith("@") else rest
    where = f"{rest[1:]}, line " if rest.startswith("@") else ""
    values: list[int | float] = []
    for line, row in enumerate(source.splitlines(), start=1):
        for word in re.split(r"[,;\s]+", row.strip(" \t,;")):
            if word:
                values.append(_typed_number(word, kind, f"{where}{line}" if where else text))
    if not values:
        raise ConfigError(f"{text!r} contains no numbers")
    return np.array(values, _TYPES[kind])


def _typed_number(word: str, kind: str, where: str) -> int | float:
    number = _number(word)
    if number is None:
        raise ConfigError(f"{where}: {word!r} is not a number")
    if kind.startswith("float"):
        if number not in (math.inf, -math.inf) and abs(number) > float(
            np.finfo(kind).max
        ):  # also of an int of any size
            raise ConfigError(f"{where}: {word} is beyond the largest {kind}")
        return float(number)
    limits = np.iinfo(kind)
    if not isinstance(number, int) or not limits.min <= number <= limits.max:
        raise ConfigError(f"{where}: {word} is not of type {kind} ({limits.min} to {limits.max})")
    return number


def _content(name: str, *, most: int) -> bytes:
    try:
        with Path(name).open("rb") as file:
            content = file.read(most + 1)
    except (OSError, ValueError) as error:
        reason = getattr(error, "strerror", None) or error
        raise ConfigError(f"cannot read {name!r} for an argument: {reason}") from error
    if len(content) > most:
        raise ConfigError(f"{name!r} is larger than the board's RAM; use a part of it")
    if not content:
        raise ConfigError(f"{name!r} is empty")
    return content
