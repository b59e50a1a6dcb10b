"""Candidates among the variables of firmware, by their names, the names of enclosing structs, and their sizes."""

from __future__ import annotations

import re
from collections.abc import Iterator

from hiltest.interfaces.c_types import ArrayType, CType, NumberKind, NumberType, RecordType, read_type, size_of
from hiltest.interfaces.candidates import Candidate, meaning_of
from hiltest.interfaces.variable_index import VariableIndex
from hiltest.virtual.program.elf import FirmwareImage

_NAME = re.compile(r"(?:[A-Za-z_$][\w$]*)?", re.ASCII)  # name in C; a member may have none
_RAM = range(0x1C00_0000, 0x4000_0000)
# Limits that no firmware for this chip reaches: they end the walk through damaged or huge debug information.
_MOST_DEBUG_BYTES = 8 << 20
_MOST_PLACES = 20_000
_DEEPEST = 6
_LONGEST_VALUE = 16  # numbers of one value
# Types that a symbol without debug information may have, by its size.
_BY_SIZE = {4: ("float", 1), 12: ("float[3]", 3), 36: ("float[9]", 9)}


def variable_candidates(image: FirmwareImage) -> tuple[list[Candidate], str]:
    """Return the candidates among the variables of an image, and the obstacle if not all could be read."""
    candidates: list[Candidate] = []
    try:
        remark = _collect_candidates(image, candidates)
    except Exception as error:  # the parser raises any type of error on damaged debug information
        remark = f"its debug information is damaged ({str(error) or type(error).__name__})"
    if not remark:
        return candidates, ""
    return [*candidates, *_symbol_candidates(image)], remark


def _collect_candidates(image: FirmwareImage, candidates: list[Candidate]) -> str:
    """Add the candidates of the debug information; return the obstacle, if any."""
    dwarf = image.debug_information()
    section = dwarf.debug_info_sec if dwarf is not None else None
    if section is None:
        return "it has no debug information: compile with -g for the types of its variables"
    if section.size > _MOST_DEBUG_BYTES:
        return f"its debug information has {section.size >> 20} MiB: only the names of its symbols were searched"
    places = [
        (path, read_type(variable.type_entry), 0)
        for path, variable in VariableIndex(dwarf, image.objects).listed()
        if variable.address in _RAM
    ]
    count = 0
    while places and count < _MOST_PLACES:
        path, kind, depth = places.pop()
        count += 1
        candidates += _value_candidates(path, kind)
        if isinstance(kind, RecordType) and kind.size is not None and depth < _DEEPEST:
            places += [
                (f"{path}.{member.name}" if member.name else path, read_type(member.type_entry), depth + 1)
                for member in kind.members
                if _NAME.fullmatch(member.name)
            ]
    return f"it has more than {_MOST_PLACES} variables and members: the others were not searched" if places else ""


def _value_candidates(path: str, kind: CType) -> Iterator[Candidate]:
    numbers = _numbers(kind)
    if 0 < len(numbers) <= _LONGEST_VALUE:
        names = re.findall(r"[A-Za-z_$][\w$]*", path)
        is_whole = all(number.kind is not NumberKind.FLOAT for number in numbers)
        if (meaning := meaning_of(names, len(numbers), is_whole=is_whole)) is not None:
            yield Candidate(meaning, path, kind.text, path)


def _numbers(kind: CType) -> list[NumberType]:
    """Return the numbers of a value; none if they are of several types, or too many."""
    if isinstance(kind, NumberType):
        return [kind]
    if isinstance(kind, ArrayType):
        inner = _numbers(kind.element)
        return inner * kind.count if kind.count and kind.count * len(inner) <= _LONGEST_VALUE else []
    if isinstance(kind, RecordType) and not kind.is_union and len(kind.members) == 3:  # x, y, z
        members = [read_type(member.type_entry) for member in kind.members if member.bits is None]
        numbers = [member for member in members if isinstance(member, NumberType) and not member.labels]
        are_alike = len({(number.kind, number.size) for number in numbers}) == 1
        return numbers if are_alike and size_of(kind) == sum(number.size for number in numbers) else []
    return []


def _symbol_candidates(image: FirmwareImage) -> Iterator[Candidate]:
    """Yield the candidates among symbols without debug information, by their names and sizes."""
    for symbol in image.objects:
        stated, size = _BY_SIZE.get(symbol.size, ("", 0))
        is_in_c = stated and symbol.address in _RAM and symbol.name and _NAME.fullmatch(symbol.name)
        if is_in_c and (meaning := meaning_of([symbol.name], size)) is not None:
            yield Candidate(meaning, symbol.name, f"{symbol.size} bytes, {stated} perhaps", symbol.name, stated)
