"""Entries of debug information: children, names and types, in bounded time whatever a damaged file says."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

QUALIFIERS = frozenset(f"DW_TAG_{name}" for name in (
    "typedef", "const_type", "volatile_type", "restrict_type", "atomic_type",
))  # fmt: skip
POINTERS = frozenset({"DW_TAG_pointer_type", "DW_TAG_reference_type", "DW_TAG_rvalue_reference_type"})
STRUCTURES = frozenset({"DW_TAG_structure_type", "DW_TAG_class_type"})
# Where an entry that repeats another one says which.
_REPEATED = ("DW_AT_specification", "DW_AT_abstract_origin")
_ELSEWHERE = "DW_AT_signature"  # of a type that has a unit of its own
_LONGEST_CHAIN = 64  # of typedefs and qualifiers; a person writes a handful


def children(entry: Any) -> Iterator[Any]:
    """Yield the children of an entry; the parser's own walk goes round for ever where a sibling lies behind.

    Raises
    ------
    Exception
        Of the parser, when the file is damaged.
    """
    if not entry.has_children:
        return
    offset = entry.offset + entry.size
    while not (child := entry.cu.get_DIE_from_refaddr(offset)).is_null():
        yield child
        offset = _behind(child)


def _behind(entry: Any) -> int:
    """Return where the next entry of the same level begins: always further on."""
    offset: int = entry.offset + entry.size
    sibling = entry.attributes.get("DW_AT_sibling")
    if not entry.has_children:
        return offset
    if sibling is not None and sibling.form != "DW_FORM_ref_addr":
        named: int = sibling.raw_value + entry.cu.cu_offset
        if named > offset:
            return named
    depth = 1
    while depth:
        inner = entry.cu.get_DIE_from_refaddr(offset)
        offset += inner.size
        depth += -1 if inner.is_null() else 1 if inner.has_children else 0
    return offset


def _with_repeated(entry: Any) -> Iterator[Any]:
    """Yield an entry, what it repeats, and so on."""
    for _ in range(_LONGEST_CHAIN):
        yield entry
        further = next((each for each in _REPEATED if each in entry.attributes), None)
        if further is None:
            return
        entry = entry.get_DIE_from_attribute(further)
    raise ValueError("entries that repeat each other")


def origin_of(entry: Any) -> Any:
    """Return the entry that an entry repeats in the end, as a definition its declaration; itself where it is one."""
    *_, last = _with_repeated(entry)
    return last


def name_of(entry: Any) -> str:
    """Return the name of an entry, or of what it repeats; empty without one."""
    names = (each.attributes["DW_AT_name"] for each in _with_repeated(entry) if "DW_AT_name" in each.attributes)
    return next((name.value.decode(errors="replace") for name in names), "")


def next_type(entry: Any) -> Any:
    """Return the type that an entry names, or what it repeats does, qualifiers and all; None for void."""
    typed = (each for each in _with_repeated(entry) if "DW_AT_type" in each.attributes)
    return next((each.get_DIE_from_attribute("DW_AT_type") for each in typed), None)


def without_qualifiers(entry: Any) -> Any:
    """Follow typedefs and qualifiers to the type that decides how a value lies; None for void."""
    for _ in range(_LONGEST_CHAIN):
        if entry is not None and _ELSEWHERE in entry.attributes:
            entry = entry.get_DIE_from_attribute(_ELSEWHERE)
        elif entry is None or entry.tag not in QUALIFIERS:
            return entry
        else:
            entry = next_type(entry)
    raise ValueError("typedefs in a circle")


def written_type(entry: Any) -> str:
    """Write a type as C does, but for what stands behind a name there."""
    if entry is None:
        return "void"
    if entry.tag in POINTERS:
        return f"{written_type(next_type(entry))} {'*' if entry.tag == 'DW_TAG_pointer_type' else '&'}"
    if entry.tag in QUALIFIERS and entry.tag != "DW_TAG_typedef":
        inner, word = next_type(entry), entry.tag.removeprefix("DW_TAG_").removesuffix("_type")
        behind = inner is not None and inner.tag in POINTERS
        return f"{written_type(inner)} {word}" if behind else f"{word} {written_type(inner)}"
    if entry.tag == "DW_TAG_array_type":
        return f"{written_type(next_type(entry))}[]"
    kind = {"DW_TAG_structure_type": "struct ", "DW_TAG_union_type": "union ", "DW_TAG_enumeration_type": "enum "}
    return f"{kind.get(entry.tag, '' if name_of(entry) else 'type ')}{name_of(entry) or 'without a name'}"
