"""From instructions to source: which of them a line, a function and a branch of an image stand for.

The line table of the DWARF says where each statement begins; what it says of the instructions between is of no use
here, for the compiler moves them. The instructions themselves say where branches are.
"""

from __future__ import annotations

import os
from bisect import bisect_right
from collections.abc import Iterator
from dataclasses import dataclass, field
from pathlib import Path, PurePosixPath
from typing import Any

from hiltest.coverage.lcov import Coverage, FileCoverage
from hiltest.errors import ConfigError
from hiltest.virtual.core.decoder import decode
from hiltest.virtual.processor.executed_code import ExecutedCode
from hiltest.virtual.program.elf import LIBRARIES, FirmwareImage

_WITHOUT_LINES = (
    "no coverage without source lines: {name} has no line table, or it is damaged; give the .elf of a build with -g"
)
_END = -1  # line of no row: the code of a file ends there
# Parts of a function that the compiler cut off it: entered from within.
_CUT_OFF = (".part", ".cold")


@dataclass(frozen=True, slots=True)
class Row:
    """A row of the line table: from this address on code is of this line, up to the next row."""

    address: int
    file: str
    line: int
    begins_statement: bool


@dataclass(slots=True)
class Branch:
    """A conditional branch, or an IT block."""

    address: int
    guarded: int | None = None
    """First instruction that an IT block executes if its condition holds; None for a branch."""


@dataclass(slots=True)
class _Code:
    instructions: set[int] = field(default_factory=set)
    branches: list[Branch] = field(default_factory=list)


class SourceMap:
    """What an image says of the places of its code in the source; library code is left out.

    Raises
    ------
    ConfigError
        When it has no line table, or a damaged one.
    """

    def __init__(self, image: FirmwareImage) -> None:
        self._image = image
        try:
            sequences = list(_sequences(image.debug_information()))
        except Exception as error:  # the parser raises whatever a damaged file makes it meet
            raise ConfigError(_WITHOUT_LINES.format(name=image.name)) from error
        begins = [address for address, _ in image.code]
        ends = [address + len(content) for address, content in image.code]
        self._rows: list[Row] = []
        for rows, end in sequences:
            place = bisect_right(begins, rows[0].address) - 1
            # What the linker has dropped has lines too, at address 0.
            if place >= 0 and rows[0].address < ends[place] and rows[0].address < end:
                self._rows += rows
                self._rows.append(Row(end, "", _END, begins_statement=False))
        if not self._rows:
            raise ConfigError(_WITHOUT_LINES.format(name=image.name))
        # Of several at one address the last one counts, but where a stretch of code ends another may begin.
        self._rows.sort(key=lambda row: (row.address, row.line != _END))
        self._starts = [row.address for row in self._rows]

    def coverage(self, code: ExecutedCode) -> Coverage:
        """Return the counts of lines, functions and branches of all code that is no library's."""
        found = Coverage({row.file: FileCoverage() for row in self._rows if row.file})
        instructions = self._instructions()
        self._count_lines(found, code, instructions.instructions)
        self._count_functions(found, code)
        self._count_branches(found, code, instructions.branches)
        return found

    def _row_at(self, address: int) -> Row:
        """Return the row of an address; of one before all code the last, which is of no line."""
        return self._rows[bisect_right(self._starts, address) - 1]

    def _instructions(self) -> _Code:
        """Find instructions and branches in the code that has lines."""
        found = _Code()
        for address, content in self._image.code:
            for instruction in decode(address, content):
                at = instruction.address
                found.instructions.add(at)
                if instruction.begins_it_block:
                    found.branches.append(Branch(at, guarded=at + instruction.size))
                elif instruction.conditional:
                    found.branches.append(Branch(at))
        return found

    def _count_lines(self, found: Coverage, code: ExecutedCode, instructions: set[int]) -> None:
        """Count a line as often as the statement on it that began most often, in each function that has it."""
        most: dict[tuple[str, int, bool], dict[int, int]] = {}
        for row in self._rows:
            if row.line > 0 and row.address in instructions:
                function = self._image.function_at(row.address)
                at = function.address if function else -1
                counts = most.setdefault((row.file, row.line, row.begins_statement), {})
                counts[at] = max(counts.get(at, 0), code.executed[row.address])
        for (file, line, begins), counts in most.items():
            if begins or (file, line, True) not in most:
                found.files[file].lines[line] = sum(counts.values())

    def _count_functions(self, found: Coverage, code: ExecutedCode) -> None:
        whole: set[tuple[str, str]] = set()
        for address in sorted({function.address for function in self._image.functions}):
            row = self._first_row(address)
            symbol = self._image.function_at(address)
            if row is None or symbol is None:
                continue
            name, _, clone = symbol.name.partition(".")
            functions, count = found.files[row.file].functions, code.executed[address]
            if f".{clone}".startswith(_CUT_OFF):
                functions.setdefault(name, (row.line, count))
            elif (row.file, name) in whole:  # the compiler made several of it
                functions[name] = functions[name][0], functions[name][1] + count
            else:
                functions[name] = row.line, count
                whole.add((row.file, name))

    def _first_row(self, address: int) -> Row | None:
        """Return the row that begins a function, the first of several there."""
        place = bisect_right(self._starts, address - 1)
        row = self._rows[place] if place < len(self._rows) else None
        while row is not None and row.address == address and row.line <= 0:
            place += 1
            row = self._rows[place] if place < len(self._rows) else None
        return row if row is not None and row.address == address else None

    def _count_branches(self, found: Coverage, code: ExecutedCode, branches: list[Branch]) -> None:
        numbers: dict[tuple[str, int], int] = {}
        for each in sorted(branches, key=lambda branch: branch.address):
            row = self._row_at(each.address)
            if row.line <= 0:
                continue
            number = numbers[row.file, row.line] = numbers.get((row.file, row.line), -1) + 1
            away = code.jumped[each.address] if each.guarded is None else code.executed[each.guarded]
            on = code.executed[each.address] - away
            found.files[row.file].branches[row.line, number] = on, away


def _sequences(dwarf: Any) -> Iterator[tuple[list[Row], int]]:
    """Yield the rows of each stretch of code of the firmware's own, and where it ends."""
    for unit in dwarf.iter_CUs():
        top = unit.get_top_DIE()
        folder = _text(top, "DW_AT_comp_dir")
        if _is_library(PurePosixPath(folder, _text(top, "DW_AT_name"))):
            continue
        program = dwarf.line_program_for_CU(unit)
        if program is None:
            continue
        names = _file_names(program, folder)
        rows: list[Row] = []
        for entry in program.get_entries():
            state = entry.state
            if state is None:
                continue
            if state.end_sequence:
                if rows:
                    yield rows, state.address
                rows = []
                continue
            name = names[state.file]
            # Code of a library's header is no file's; it ends what stands before it all the same.
            rows.append(Row(state.address & ~1, name, state.line if name else 0, bool(state.is_stmt)))


def _text(die: Any, attribute: str) -> str:
    return str(die.attributes[attribute].value.decode(errors="replace")) if attribute in die.attributes else ""


def _file_names(program: Any, folder: str) -> dict[int, str]:
    """Return the names of a unit's files as they are shown; empty for those of libraries."""
    header = program.header
    is_new = header.version >= 5
    folders = [each.decode(errors="replace") for each in header.include_directory]
    found = {}
    for number, entry in enumerate(header.file_entry, 0 if is_new else 1):
        index = entry.dir_index if is_new else entry.dir_index - 1
        path = PurePosixPath(folders[index] if 0 <= index < len(folders) else "", entry.name.decode(errors="replace"))
        found[number] = "" if _is_library(PurePosixPath(folder, path)) else _shown(folder, path)
    return found


def _shown(folder: str, path: PurePosixPath) -> str:
    """Return a path as it is from here, if it is below; a relative one is as a build gave it that maps its paths."""
    if folder.startswith("/") or path.parts[:1] == ("..",):
        path = PurePosixPath(folder, path)
    name = os.path.normpath(path)
    here = f"{Path.cwd()}/"
    return name.removeprefix(here)


def _is_library(path: PurePosixPath) -> bool:
    """Whether a file is of the compiler's own libraries, or a header of theirs."""
    parts = set(path.parts)
    return bool(parts & LIBRARIES) or {"arm-none-eabi", "include"} <= parts
