"""Candidates among the variables of firmware: by their names, those of the structs they stand in, and their sizes."""

from __future__ import annotations

import re
from collections.abc import Iterator

from hiltest.device.c_types import ArrayType, CType, NumberKind, NumberType, RecordType, read_type, size_of
from hiltest.device.candidates import Candidate, meaning_of
from hiltest.device.variable_index import VariableIndex
from hiltest.virtual.program.elf import FirmwareImage

_NAME = re.compile(r"(?:[A-Za-z_$][\w$]*)?", re.ASCII)  # of C; a member may have none
_RAM = range(0x1C00_0000, 0x4000_0000)
# What no firmware for this chip has: it ends the walk through a damaged file, or through megabytes of someone's types.
_MOST_DEBUG_BYTES = 8 << 20
_MOST_PLACES = 20_000
_DEEPEST = 6
_LONGEST_VALUE = 16  # numbers of one
# What a symbol without debug information may be, by its bytes.
_BY_SIZE = {4: ("float", 1), 12: ("float[3]", 3), 36: ("float[9]", 9)}


def variable_candidates(image: FirmwareImage) -> tuple[list[Candidate], str]:
    """Return the candidates among the variables of an image, and what hinders to look at all of them."""
    found: list[Candidate] = []
    try:
        remark = _look_through(image, found)
    except Exception as error:  # the parser raises whatever damaged debug information makes it meet
        remark = f"its debug information is damaged ({str(error) or type(error).__name__})"
    if not remark:
        return found, ""
    return [*found, *_of_symbols(image)], remark


def _look_through(image: FirmwareImage, found: list[Candidate]) -> str:
    """Add the candidates of the debug information; return what hinders."""
    dwarf = image.debug_information()
    section = dwarf.debug_info_sec if dwarf is not None else None
    if section is None:
        return "it has no debug information: compile with -g for the types of its variables"
    if section.size > _MOST_DEBUG_BYTES:
        return f"its debug information has {section.size >> 20} MiB: only the names of its symbols were looked at"
    places = [
        (path, read_type(each.type_entry), 0)
        for path, each in VariableIndex(dwarf, image.objects).listed() if each.address in _RAM
    ]  # fmt: skip
    seen = 0
    while places and seen < _MOST_PLACES:
        path, kind, depth = places.pop()
        seen += 1
        found += _of_value(path, kind)
        if isinstance(kind, RecordType) and kind.size is not None and depth < _DEEPEST:
            places += [
                (f"{path}.{member.name}" if member.name else path, read_type(member.type_entry), depth + 1)
                for member in kind.members if _NAME.fullmatch(member.name)
            ]  # fmt: skip
    return f"it has more than {_MOST_PLACES} variables and members: the others were not looked at" if places else ""


def _of_value(path: str, kind: CType) -> Iterator[Candidate]:
    numbers = _numbers(kind)
    if 0 < len(numbers) <= _LONGEST_VALUE:
        names = re.findall(r"[A-Za-z_$][\w$]*", path)
        is_whole = all(number.kind is not NumberKind.FLOAT for number in numbers)
        if (meaning := meaning_of(names, len(numbers), is_whole=is_whole)) is not None:
            yield Candidate(meaning, path, kind.text)


def _numbers(kind: CType) -> list[NumberType]:
    """Return the numbers that a value is; none where it is more than numbers of one type, or too many."""
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


def _of_symbols(image: FirmwareImage) -> Iterator[Candidate]:
    """Yield what symbols may be by their names and sizes, where no debug information says more."""
    for symbol in image.objects:
        stated, size = _BY_SIZE.get(symbol.size, ("", 0))
        is_in_c = stated and symbol.address in _RAM and symbol.name and _NAME.fullmatch(symbol.name)
        if is_in_c and (meaning := meaning_of([symbol.name], size)) is not None:
            yield Candidate(meaning, symbol.name, f"{symbol.size} bytes, {stated} perhaps", stated)
