"""Signatures of functions, read from DWARF."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any

from hiltest.virtual.program.debug_entries import (
    POINTERS,
    STRUCTURES,
    children,
    next_type,
    strip_qualifiers,
    written_type,
)

_ASSEMBLER = 0x8001  # DW_LANG_Mips_Assembler, which all assemblers use
_COMPLEX, _FLOAT = 0x03, 0x04  # DW_ATE_complex_float, DW_ATE_float
# By encoding and size. Encodings 0x02, 0x07, 0x08 and 0x10 are boolean, unsigned, unsigned_char and UTF, 0x05 and 0x06
# signed and signed_char; types below four bytes are passed as a word.
_BASE_TYPES = {
    (_FLOAT, 4): "float",
    (_FLOAT, 8): "double",
    **{(encoding, 4): "unsigned" for encoding in (0x02, 0x07, 0x08, 0x10)},
    (0x07, 8): "unsigned64",
    **{(encoding, 4): "signed" for encoding in (0x05, 0x06)},
    (0x05, 8): "signed64",
}


@dataclass(frozen=True, slots=True)
class Element:
    """Type of a number in memory; integers with and without sign are the same."""

    is_float: bool
    size: int

    def __str__(self) -> str:
        return f"float{8 * self.size}" if self.is_float else f"{8 * self.size}-bit integers"


@dataclass(frozen=True, slots=True)
class Pointed:
    """Target of a pointer parameter."""

    text: str
    """The parameter's type in C, ``const int16_t *``."""
    elements: frozenset[Element]
    """Number types of the target, for a struct those of all its members; empty if any type is possible."""


@dataclass(frozen=True, slots=True)
class Signature:
    """Types of a function's parameters and return value.

    A type is "float", "double", "signed" or "unsigned" (up to 32 bits), "signed64", "unsigned64", "pointer", "void" or
    "unsupported".
    """

    parameters: tuple[str, ...]
    returns: str
    pointed: tuple[Pointed | None, ...] = ()
    """Target of each parameter that is a pointer."""


def read_subprograms(dwarf: Any) -> dict[str, Any]:
    """Return the DWARF entries of all defined functions, by their linker names."""
    entries: dict[str, Any] = {}
    for unit in dwarf.iter_CUs():
        language = unit.get_top_DIE().attributes.get("DW_AT_language")
        if language is not None and language.value == _ASSEMBLER:
            continue  # assemblers describe functions without their parameters
        for die in _functions_of(unit.get_top_DIE()):
            if name := _symbol_name(die):
                entries.setdefault(name, die)
    return entries


def read_signature(die: Any) -> Signature:
    """Read the types of a function from its DWARF entry."""
    parameters = [child for child in children(die) if child.tag == "DW_TAG_formal_parameter"]
    kinds = tuple(_classify(_type_of(parameter)) for parameter in parameters)
    targets = tuple(_pointer_target(parameter) for parameter in parameters)
    return Signature(kinds, _classify(_type_of(_declaration(die))), targets)


def _pointer_target(parameter: Any) -> Pointed | None:
    pointer = _type_of(parameter)
    if pointer is None or pointer.tag not in POINTERS:
        return None
    elements = _elements(_type_of(pointer))
    return Pointed(written_type(next_type(parameter)), frozenset(elements or ()))


def _elements(die: Any) -> set[Element] | None:
    """Return the number types in a type; None if it may contain other types. Each type is read once."""
    numbers: set[Element] = set()
    waiting, begun = [die], {die.offset if die is not None else -1}
    while waiting:
        die = waiting.pop()
        if die is None:
            return None
        size = die.attributes["DW_AT_byte_size"].value if "DW_AT_byte_size" in die.attributes else 4
        if die.tag == "DW_TAG_base_type":
            encoding = die.attributes["DW_AT_encoding"].value
            parts = 2 if encoding == _COMPLEX else 1
            numbers.add(Element(encoding in (_FLOAT, _COMPLEX), size // parts))
        elif die.tag in POINTERS or die.tag == "DW_TAG_enumeration_type":
            numbers.add(Element(False, size))
        elif die.tag == "DW_TAG_array_type" or die.tag in STRUCTURES:
            members = [child for child in children(die) if child.tag in ("DW_TAG_member", "DW_TAG_inheritance")]
            for inner in map(_type_of, [die] if die.tag == "DW_TAG_array_type" else members):
                if inner is None or inner.offset not in begun:
                    begun.add(-1 if inner is None else inner.offset)
                    waiting.append(inner)
        else:
            return None
    return numbers


def _functions_of(scope: Any) -> Iterator[Any]:
    """Yield the functions that a unit defines, including those in namespaces; member functions are at the top level."""
    for die in children(scope):
        if die.tag == "DW_TAG_subprogram" and "DW_AT_declaration" not in die.attributes:
            yield die
        elif die.tag == "DW_TAG_namespace":
            yield from _functions_of(die)


def _declaration(die: Any) -> Any:
    """Return the entry with a function's names and type: its declaration if it is in a class or namespace."""
    return die.get_DIE_from_attribute("DW_AT_specification") if "DW_AT_specification" in die.attributes else die


def _symbol_name(die: Any) -> str:
    """Return the linker name of a function: its mangled name, if any; empty if it is unknown."""
    attributes = _declaration(die).attributes
    name = attributes.get("DW_AT_linkage_name") or attributes.get("DW_AT_name")
    return name.value.decode(errors="replace") if name is not None else ""


def _type_of(die: Any) -> Any:
    """Return the type without typedefs and qualifiers, which decides how a value is passed; None for void."""
    return strip_qualifiers(die.get_DIE_from_attribute("DW_AT_type")) if "DW_AT_type" in die.attributes else None


def _classify(die: Any) -> str:
    if die is None:
        return "void"
    if die.tag in POINTERS:
        return "pointer"
    size = die.attributes["DW_AT_byte_size"].value if "DW_AT_byte_size" in die.attributes else 4
    if die.tag == "DW_TAG_enumeration_type" and size <= 4:
        return "unsigned"
    if die.tag == "DW_TAG_base_type":
        encoding = die.attributes["DW_AT_encoding"].value
        return _BASE_TYPES.get((encoding, size if encoding == _FLOAT else max(size, 4)), "unsupported")
    return "unsupported"
