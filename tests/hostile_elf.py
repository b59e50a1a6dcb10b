"""ELF files with debug information that is valid, small, and made to be expensive."""

from __future__ import annotations

import struct

ABBREVIATIONS = {  # code: tag, has children, (attribute, form)
    1: (0x11, True, ((0x10, 0x17),)),  # compile_unit: stmt_list sec_offset
    2: (0x13, True, ((0x03, 0x08), (0x0B, 0x0F))),  # structure_type: name string, byte_size udata
    3: (0x0D, False, ((0x03, 0x08), (0x49, 0x13), (0x38, 0x0F))),  # member: name, type ref4, location udata
    4: (0x24, False, ((0x0B, 0x0B), (0x3E, 0x0B))),  # base_type: byte_size, encoding
    5: (0x2E, True, ((0x03, 0x08), (0x49, 0x13))),  # subprogram: name, type
    6: (0x05, False, ((0x49, 0x13),)),  # formal_parameter: type
    7: (0x0F, False, ((0x49, 0x13),)),  # pointer_type: type
    8: (0x39, True, ()),  # namespace
    9: (0x39, True, ()),  # another, to be followed by small entries
    10: (0x01, True, ((0x49, 0x13),)),  # array_type: type
    11: (0x21, False, ((0x2F, 0x0B),)),  # subrange_type: upper_bound
    12: (0x34, False, ((0x03, 0x08), (0x49, 0x13), (0x02, 0x18))),  # variable: name, type, location exprloc
    13: (0x08, False, ()),  # imported_declaration, one byte
    14: (0x34, False, ((0x03, 0x08),)),  # variable without a location
}
HEADER_BYTES = 11  # of a unit of DWARF 4


def uleb(number: int) -> bytes:
    """Return a number as ULEB128."""
    groups = bytearray()
    while True:
        number, low = number >> 7, number & 0x7F
        groups.append(low | (0x80 if number else 0))
        if not number:
            return bytes(groups)


def unit(entries: bytes, *, line_program: int = 0) -> bytes:
    """Return a unit of DWARF 4 from the entries below its top."""
    content = struct.pack("<HIB", 4, 0, 4) + b"\1" + struct.pack("<I", line_program) + entries + b"\0"
    return struct.pack("<I", len(content)) + content


FIRST_ENTRY = HEADER_BYTES + 5
"""Offset in a unit of the first entry below its top."""


def elf_with(debug_info: bytes, debug_line: bytes = b"", **further: bytes) -> bytes:
    """Return an executable for Arm with one word of code and debug information."""
    abbreviations = b"".join(
        uleb(code)
        + uleb(tag)
        + bytes([children])
        + b"".join(uleb(name) + uleb(form) for name, form in attributes)
        + b"\0\0"
        for code, (tag, children, attributes) in ABBREVIATIONS.items()
    )
    sections = {".debug_info": debug_info, ".debug_abbrev": abbreviations + b"\0", ".debug_line": debug_line}
    sections |= {f".{name}": content for name, content in further.items()}
    names = b"\0" + b"".join(f"{name}\0".encode() for name in [*sections, ".shstrtab"])
    sections[".shstrtab"] = names
    at = 52 + 32 + 4
    headers, contents = [bytes(40)], b""
    for name, content in sections.items():
        kind = 3 if name == ".shstrtab" else 1
        name_at = names.index(f"\0{name}\0".encode()) + 1
        headers.append(struct.pack("<10I", name_at, kind, 0, 0, at, len(content), 0, 0, 1, 0))
        contents += content
        at += len(content)
    identity = b"\x7fELF\1\1\1" + bytes(9)
    header = struct.pack(
        "<HHIIIIIHHHHHH", 2, 40, 1, 0, 52, at, 0x05000000, 52, 32, 1, 40, len(headers), len(headers) - 1
    )
    segment = struct.pack("<8I", 1, 84, 0, 0, 4, 4, 5, 4)
    return identity + header + segment + bytes(4) + contents + b"".join(headers)


def line_program(operations: bytes, *, length: int | None = None) -> bytes:
    """Return a line program of version 4 that names one file."""
    header = bytes([1, 1, 1, 0xFB, 14, 13, 0, 1, 1, 1, 1, 0, 0, 0, 1, 0, 0, 1]) + b"\0" + b"a.c\0\0\0\0" + b"\0"
    rest = struct.pack("<HI", 4, len(header)) + header + operations
    return struct.pack("<I", len(rest) if length is None else length) + rest


def nested_structs(levels: int) -> bytes:
    """Return a unit with a function whose parameter points to a struct of two structs of two structs ..."""
    entries = b"\4\4\4"  # float of 4 bytes
    inner = FIRST_ENTRY
    for level in range(levels):
        at = FIRST_ENTRY + len(entries)
        members = b"".join(b"\3" + name + struct.pack("<I", inner) + b"\0" for name in (b"a\0", b"b\0"))
        entries += b"\2" + f"s{level}\0".encode() + b"\4" + members + b"\0"
        inner = at
    pointer = FIRST_ENTRY + len(entries)
    entries += b"\7" + struct.pack("<I", inner)
    entries += b"\5f\0" + struct.pack("<I", FIRST_ENTRY) + b"\6" + struct.pack("<I", pointer) + b"\0"
    return unit(entries)


def nested_namespaces(levels: int, entries: int) -> bytes:
    """Return a unit of namespaces in namespaces, with many small entries in the innermost."""
    return unit(b"\x08" * levels + b"\x0d" * entries + bytes(levels))


def array_of_dimensions(dimensions: int) -> bytes:
    """Return a unit with a variable that is an array of many dimensions."""
    entries = b"\4\4\4\x0a" + struct.pack("<I", FIRST_ENTRY) + b"\x0b\0" * dimensions + b"\0"
    return unit(entries + b"\x0cv\0" + struct.pack("<I", FIRST_ENTRY + 3) + b"\5\3" + struct.pack("<I", 0x2000_0000))


def static_variables(functions: int) -> bytes:
    """Return a unit of functions with a static variable each."""
    first = struct.pack("<I", FIRST_ENTRY)
    one = b"\x0cv\0" + first + b"\5\3"
    entries = b"\4\4\4" + b"".join(
        b"\5"
        + f"f{number}\0".encode()
        + struct.pack("<I", FIRST_ENTRY)
        + one
        + struct.pack("<I", 0x2000_0000 + 4 * number)
        + b"\0"
        for number in range(functions)
    )
    return unit(entries)


def same_variable_in_each_of(units: int) -> bytes:
    """Return units that each define a variable of one name."""
    one = b"\4\4\4\x0cv\0" + struct.pack("<I", FIRST_ENTRY) + b"\5\3"
    return b"".join(unit(one + struct.pack("<I", 0x2000_0000 + 4 * number)) for number in range(units))


def units_with_one_line_program(units: int, rows: int) -> tuple[bytes, bytes]:
    """Return units that share a line program of many rows."""
    return unit(b"") * units, line_program(b"\x4b" * rows)


def overlapping_line_programs(programs: int, rows: int) -> tuple[bytes, bytes]:
    """Return units with a line program each, of which each has all later ones as its operations."""
    size = len(line_program(b""))
    end = programs * size + rows
    texts = b"".join(line_program(b"", length=end - number * size - 4) for number in range(programs))
    return b"".join(unit(b"", line_program=number * size) for number in range(programs)), texts + b"\x4b" * rows


def files_without_size(count: int, *, form: int | None = None) -> tuple[bytes, bytes]:
    """Return a line program of version 5 that lists a directory, and many files of no bytes: of no form, or of one."""
    header = bytes([1, 1, 1, 0xFB, 14, 13, 0, 1, 1, 1, 1, 0, 0, 0, 1, 0, 0, 1]) + b"\1\1\x08\1/src\0"
    header += (b"\0" if form is None else bytes([1, 1, form])) + uleb(count)
    rest = struct.pack("<HBBI", 5, 4, 0, len(header)) + header
    return unit(b""), struct.pack("<I", len(rest)) + rest
