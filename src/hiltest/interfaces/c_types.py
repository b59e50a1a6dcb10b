"""Types of C as values lie in memory: numbers, structs, arrays and pointers, from debug information or from a rig."""

from __future__ import annotations

import re
import struct
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from enum import Enum
from typing import Any, TypeAlias

from hiltest.budgets import DEBUG
from hiltest.errors import ConfigError
from hiltest.virtual.program.debug_entries import (
    POINTERS,
    STRUCTURES,
    children,
    name_of,
    next_type,
    strip_qualifiers,
    written_type,
)

POINTER_BYTES = 4
_FLOATS = {4: "<f", 8: "<d", 2: "<e"}
_INTEGERS = (1, 2, 4, 8)
_MOST_ELEMENTS = 1 << 24  # elements of a dimension; the chip's memory has fewer bytes
_PLUS_CONSTANT = 0x23  # DW_OP_plus_uconst, the member's offset in old debug information


class NumberKind(Enum):
    """Encoding of a number, with its values of DW_AT_encoding."""

    BOOLEAN = (0x02,)
    FLOAT = (0x04,)
    SIGNED = (0x05, 0x06)
    UNSIGNED = (0x07, 0x08, 0x10)


_KINDS = {encoding: kind for kind in NumberKind for encoding in kind.value}


@dataclass(frozen=True, slots=True)
class NumberType:
    """A number."""

    text: str
    kind: NumberKind
    size: int
    """Bytes."""
    labels: Mapping[int, str]
    """Enumerators by value; empty if it is not an enum."""


@dataclass(frozen=True, slots=True)
class PointerType:
    """A pointer; `target` is the entry of the type it points to, None for void."""

    text: str
    target: Any


@dataclass(frozen=True, slots=True)
class ArrayType:
    """An array; `count` is None if its length is not known."""

    text: str
    element: CType
    count: int | None


@dataclass(frozen=True, slots=True)
class BitField:
    """Place of a bit-field: bits from the beginning of its struct on, lowest first."""

    first: int
    bits: int


@dataclass(frozen=True, slots=True)
class Member:
    """A member of a struct or union; members of an unnamed one are accessed as if they were declared here."""

    name: str
    type_entry: Any
    """Entry of its type."""
    offset: int
    """Offset in the struct [byte]."""
    bits: BitField | None


@dataclass(frozen=True, slots=True)
class RecordType:
    """A struct, or a union; `size` is None if the file has no definition of it."""

    text: str
    size: int | None
    members: tuple[Member, ...]
    is_union: bool


@dataclass(frozen=True, slots=True)
class OtherType:
    """A type without a value, such as a function."""

    text: str


CType: TypeAlias = NumberType | PointerType | ArrayType | RecordType | OtherType


def read_type(entry: Any) -> CType:
    """Read the type of an entry of debug information, without typedefs and qualifiers."""
    text, bare = written_type(entry), strip_qualifiers(entry)
    if bare is None:
        return OtherType("void")
    if bare.tag == "DW_TAG_base_type":
        return _read_number(bare, text)
    if bare.tag == "DW_TAG_enumeration_type":
        return _read_enumeration(bare, text)
    if bare.tag in POINTERS:
        return PointerType(text, next_type(bare))
    if bare.tag == "DW_TAG_array_type":
        return _read_array(bare)
    if bare.tag in STRUCTURES or bare.tag == "DW_TAG_union_type":
        size = None if "DW_AT_declaration" in bare.attributes else _size_attribute(bare)
        return RecordType(text, size, tuple(_members(bare)), bare.tag == "DW_TAG_union_type")
    return OtherType(text)


def size_of(kind: CType) -> int | None:
    """Return the size of a type [byte]; None if unknown."""
    if isinstance(kind, ArrayType):
        element = size_of(kind.element)
        return None if element is None or kind.count is None else element * kind.count
    if isinstance(kind, NumberType | RecordType):
        return kind.size
    return POINTER_BYTES if isinstance(kind, PointerType) else None


def decoded(kind: NumberType, data: bytes, bits: BitField | None = None) -> float:
    """Decode a number from bytes; those of a bit-field start at the byte of its first bit."""
    if kind.kind is NumberKind.FLOAT and bits is None:
        (real,) = struct.unpack(_FLOATS[kind.size], data)
        return float(real)
    width = 8 * kind.size if bits is None else bits.bits
    value = int.from_bytes(data, "little") >> (bits.first % 8 if bits is not None else 0) & (1 << width) - 1
    return value - (1 << width) if kind.kind is NumberKind.SIGNED and value >> (width - 1) else value


def _size_attribute(entry: Any) -> int:
    size = entry.attributes["DW_AT_byte_size"].value
    if not isinstance(size, int) or not 0 <= size < 1 << 32:
        raise ValueError(f"a size of {size!r}")
    return size


def _read_number(entry: Any, text: str) -> CType:
    kind, size = _KINDS.get(entry.attributes["DW_AT_encoding"].value), _size_attribute(entry)
    sizes = _FLOATS if kind is NumberKind.FLOAT else _INTEGERS
    return OtherType(text) if kind is None or size not in sizes else NumberType(text, kind, size, {})


def _read_enumeration(entry: Any, text: str) -> CType:
    values = {
        child.attributes["DW_AT_const_value"].value: name_of(child)
        for child in children(entry)
        if child.tag == "DW_TAG_enumerator"
    }
    underlying = strip_qualifiers(next_type(entry))
    signed = min(values, default=0) < 0
    if underlying is not None and underlying.tag == "DW_TAG_base_type":
        signed = _KINDS.get(underlying.attributes["DW_AT_encoding"].value) is NumberKind.SIGNED
    size = _size_attribute(entry)
    kind = NumberKind.SIGNED if signed else NumberKind.UNSIGNED
    return NumberType(text, kind, size, values) if size in _INTEGERS else OtherType(text)


def _read_array(entry: Any) -> CType:
    """Read an array of any number of dimensions as arrays of arrays."""
    element = read_type(next_type(entry))
    dimensions = [_count(child) for child in children(entry) if child.tag == "DW_TAG_subrange_type"]
    return array_of(element, dimensions or [None])


def array_of(element: CType, dimensions: list[int | None]) -> CType:
    """Return an array, the outermost dimension first; the text of each dimension has those within it.

    Raises
    ------
    BudgetError
        If there are more dimensions than `DEBUG` has levels.
    """
    DEBUG.check(nesting=len(dimensions))
    base, written = element.text, ""
    for count in reversed(dimensions):
        written = f"[{'' if count is None else count}]{written}"
        element = ArrayType(base + written, element, count)
    return element


def _count(subrange: Any) -> int | None:
    count, last = (subrange.attributes.get(name) for name in ("DW_AT_count", "DW_AT_upper_bound"))
    number = count.value if count is not None else last.value + 1 if last is not None and _is_int(last) else None
    return number if isinstance(number, int) and 0 < number <= _MOST_ELEMENTS else None


def _is_int(attribute: Any) -> bool:
    return isinstance(attribute.value, int)


def _members(record: Any) -> Iterator[Member]:
    for child in children(record):
        if child.tag in ("DW_TAG_member", "DW_TAG_inheritance") and "DW_AT_external" not in child.attributes:
            name = name_of(child) if child.tag == "DW_TAG_member" else ""
            kind = next_type(child)
            yield Member(name, kind, _offset(child), _bit_field(child, kind))


def _offset(member: Any) -> int:
    place = member.attributes.get("DW_AT_data_member_location")
    if place is None:
        return 0
    if _is_int(place):
        return int(place.value)
    operation, *constant = place.value
    if operation != _PLUS_CONSTANT:
        raise ValueError("a member whose place is computed")
    return sum((byte & 0x7F) << 7 * number for number, byte in enumerate(constant))


def _bit_field(member: Any, kind: Any) -> BitField | None:
    """Read the place of a bit-field; debug information before version 4 counts from the storage unit's highest bit."""
    size = member.attributes.get("DW_AT_bit_size")
    if size is None:
        return None
    if not 0 < size.value <= 64:
        raise ValueError(f"a bit-field of {size.value} bits")
    first, from_top = (member.attributes.get(f"DW_AT_{name}") for name in ("data_bit_offset", "bit_offset"))
    if first is not None:
        return BitField(first.value, size.value)
    begin = 8 * _offset(member)
    if from_top is None:
        return BitField(begin, size.value)
    storage = member.attributes.get("DW_AT_byte_size") or strip_qualifiers(kind).attributes["DW_AT_byte_size"]
    return BitField(begin + 8 * storage.value - from_top.value - size.value, size.value)


_WRITTEN = re.compile(r"\s*(float|double|bool|u?int(?:8|16|32|64))(?:_t)?\s*((?:\[\s*\d{1,7}\s*\]\s*){0,64})")
_WRITTEN_SIZES = {"float": 4, "double": 8, "bool": 1}


def stated_type(text: str) -> CType:
    """Read a type that a rig states: ``float``, ``int16_t[3]``, ``double[3][3]``.

    Raises
    ------
    ConfigError
        If the text is not a type.
    """
    match = _WRITTEN.fullmatch(text)
    dimensions: list[int | None] = [int(digits) for digits in re.findall(r"\d+", match[2])] if match else []
    if match is None or not all(dimensions):
        raise ConfigError(
            f"type {text!r} is not known; write float, double, bool, int8 to int64 or uint8 to uint64, with its "
            'dimensions: "float[3]"'
        )
    name = match[1]
    kind = NumberKind.BOOLEAN if name == "bool" else NumberKind.UNSIGNED if name[0] == "u" else NumberKind.SIGNED
    if name in ("float", "double"):
        kind = NumberKind.FLOAT
    size = _WRITTEN_SIZES.get(name) or int(re.sub(r"\D", "", name)) // 8
    return array_of(NumberType(name, kind, size, {}), dimensions)
