"""Entries of debug information: children, names and types, read in bounded time even from damaged files."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

from elftools.common.utils import struct_parse
from elftools.dwarf.enums import ENUM_DW_FORM

from hiltest.budgets import DEBUG

QUALIFIERS = frozenset(
    f"DW_TAG_{name}" for name in ("typedef", "const_type", "volatile_type", "restrict_type", "atomic_type")
)
POINTERS = frozenset({"DW_TAG_pointer_type", "DW_TAG_reference_type", "DW_TAG_rvalue_reference_type"})
STRUCTURES = frozenset({"DW_TAG_structure_type", "DW_TAG_class_type"})
# Attributes by which an entry refers to another entry with its name and type.
_REFERENCES = ("DW_AT_specification", "DW_AT_abstract_origin")
_SIGNATURE = "DW_AT_signature"  # of a type in a unit of its own
_FORMS = {number: name for name, number in ENUM_DW_FORM.items() if isinstance(number, int)}
_FORMS_WITHOUT_BYTES = frozenset({"DW_FORM_flag_present", "DW_FORM_implicit_const"})
_LONGEST_CHAIN = 64  # of typedefs and qualifiers; real programs have only a few


def children(entry: Any) -> Iterator[Any]:
    """Yield the children of an entry; the parser's own iteration never ends if a sibling precedes its entry.

    Raises
    ------
    Exception
        From the parser, if the file is damaged.
    """
    if not entry.has_children:
        return
    offset = entry.offset + entry.size
    while not (child := entry.cu.get_DIE_from_refaddr(offset)).is_null():
        yield child
        offset = _next_offset(child)
    entry._terminator = child  # the parser's own place for it: whoever passes over the entry need not look for its end


def _next_offset(entry: Any) -> int:
    """Return the offset of the next entry at the same level, which must be larger."""
    offset: int = entry.offset + entry.size
    sibling = entry.attributes.get("DW_AT_sibling")
    if not entry.has_children:
        return offset
    if sibling is not None and sibling.form != "DW_FORM_ref_addr":
        named: int = sibling.raw_value + entry.cu.cu_offset
        if named > offset:
            return named
    if entry._terminator is not None:
        return int(entry._terminator.offset + entry._terminator.size)
    depth = 1
    while depth:
        inner = entry.cu.get_DIE_from_refaddr(offset)
        offset += inner.size
        depth += -1 if inner.is_null() else 1 if inner.has_children else 0
    return offset


def line_programs(dwarf: Any) -> Iterator[tuple[Any, Any]]:
    """Yield each line program once, with the first unit that has it.

    Raises
    ------
    BudgetError
        If the rows may be more than those of the budget: each byte may be one.
    ValueError
        If programs overlap, or one lists entries of no bytes.
    Exception
        From the parser, if the file is damaged.
    """
    offsets: set[int] = set()
    size, section = 0, dwarf.debug_line_sec
    DEBUG.check(items=section.size if section is not None else 0)
    for unit in dwarf.iter_CUs():
        place = unit.get_top_DIE().attributes.get("DW_AT_stmt_list")
        if place is not None and place.value not in offsets:
            offsets.add(place.value)
            _refuse_entries_without_bytes(section.stream, unit.structs, place.value)
            program = dwarf.line_program_for_CU(unit)
            size += max(program.program_start_offset, program.program_end_offset) - place.value
            if size > section.size:
                raise ValueError("line programs overlap")
            yield unit, program


def _refuse_entries_without_bytes(stream: Any, structs: Any, offset: int) -> None:
    """Refuse the header of a line program if its directories or files have no bytes: their number has no bound then.

    The layout is that of DWARF 5, section 6.2.4.

    Raises
    ------
    ValueError
        If it has such a list.
    Exception
        From the parser, if the header ends early or has an unknown form.
    """

    def read(name: str) -> Any:
        return struct_parse(getattr(structs, f"Dwarf_{name}")(""), stream)

    stream.seek(offset)
    read("initial_length")
    if read("uint16") < 5:
        return
    for name in ("uint8", "uint8", "offset", *["uint8"] * 5):
        read(name)
    stream.seek(read("uint8") - 1, 1)  # the lengths of the standard opcodes
    for kind in ("directories", "files"):
        forms = [_FORMS[(read("uleb128"), read("uleb128"))[1]] for _ in range(read("uint8"))]
        count = read("uleb128")
        if count and _FORMS_WITHOUT_BYTES.issuperset(forms):
            raise ValueError(f"a line program lists {count} {kind} of no bytes")
        if kind == "directories":
            for form in count * forms:
                struct_parse(structs.Dwarf_dw_form[form], stream)


def _reference_chain(entry: Any) -> Iterator[Any]:
    """Yield an entry, the entry that it refers to, and so on."""
    for _ in range(_LONGEST_CHAIN):
        yield entry
        further = next((attribute for attribute in _REFERENCES if attribute in entry.attributes), None)
        if further is None:
            return
        entry = entry.get_DIE_from_attribute(further)
    raise ValueError("entries refer to each other in a circle")


def origin_of(entry: Any) -> Any:
    """Return the last entry of an entry's chain of references, such as a definition's declaration, or the entry."""
    *_, last = _reference_chain(entry)
    return last


def name_of(entry: Any) -> str:
    """Return the name of an entry, or of an entry that it refers to; empty without one."""
    names = (link.attributes["DW_AT_name"] for link in _reference_chain(entry) if "DW_AT_name" in link.attributes)
    return next((name.value.decode(errors="replace") for name in names), "")


def next_type(entry: Any) -> Any:
    """Return the type of an entry, or of an entry that it refers to, with qualifiers; None for void."""
    typed = (link for link in _reference_chain(entry) if "DW_AT_type" in link.attributes)
    return next((link.get_DIE_from_attribute("DW_AT_type") for link in typed), None)


def strip_qualifiers(entry: Any) -> Any:
    """Return the type without typedefs and qualifiers, which decides the layout of a value; None for void."""
    for _ in range(_LONGEST_CHAIN):
        if entry is not None and _SIGNATURE in entry.attributes:
            entry = entry.get_DIE_from_attribute(_SIGNATURE)
        elif entry is None or entry.tag not in QUALIFIERS:
            return entry
        else:
            entry = next_type(entry)
    raise ValueError("typedefs refer to each other in a circle")


def written_type(entry: Any) -> str:
    """Return a type in C syntax, without the parts that follow a declared name."""
    if entry is None:
        return "void"
    if entry.tag in POINTERS:
        return f"{written_type(next_type(entry))} {'*' if entry.tag == 'DW_TAG_pointer_type' else '&'}"
    if entry.tag in QUALIFIERS and entry.tag != "DW_TAG_typedef":
        inner, word = next_type(entry), entry.tag.removeprefix("DW_TAG_").removesuffix("_type")
        is_pointer = inner is not None and inner.tag in POINTERS
        return f"{written_type(inner)} {word}" if is_pointer else f"{word} {written_type(inner)}"
    if entry.tag == "DW_TAG_array_type":
        return f"{written_type(next_type(entry))}[]"
    kind = {"DW_TAG_structure_type": "struct ", "DW_TAG_union_type": "union ", "DW_TAG_enumeration_type": "enum "}
    return f"{kind.get(entry.tag, '' if name_of(entry) else 'type ')}{name_of(entry) or 'without a name'}"
