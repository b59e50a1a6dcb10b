"""Mapping from instructions to lines, functions and branches of the source.

The line table of the DWARF has the first instruction of each statement. Its rows of other instructions are not used,
because the compiler moves these instructions. Branches are found by decoding the instructions.
"""

from __future__ import annotations

import os
from bisect import bisect_right
from collections.abc import Iterator
from dataclasses import dataclass, field
from pathlib import Path, PurePosixPath
from typing import Any

from hiltest.errors import ConfigError
from hiltest.virtual.core.decoder import decode
from hiltest.virtual.coverage.lcov import Coverage, FileCoverage
from hiltest.virtual.processor.executed_code import ExecutedCode
from hiltest.virtual.program.debug_entries import line_programs
from hiltest.virtual.program.elf import LIBRARIES, FirmwareImage

_WITHOUT_LINES = (
    "no coverage without source lines: the line table of {name} is missing or damaged; use the .elf of a build with -g"
)
_END = -1  # line of a row that ends the code of a file
# Suffixes of parts that the compiler split off from a function, and that are entered from within the function.
_SPLIT_PARTS = (".part", ".cold")


@dataclass(frozen=True, slots=True)
class Row:
    """A row of the line table: code from this address up to the next row belongs to this line."""

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
    """Source lines of an image's code, without library code.

    Raises
    ------
    ConfigError
        If the line table is missing or damaged.
    """

    def __init__(self, image: FirmwareImage) -> None:
        self._image = image
        try:
            sequences = list(_sequences(image.debug_information()))
        except Exception as error:  # the parser raises any type of error on a damaged file
            raise ConfigError(_WITHOUT_LINES.format(name=image.name)) from error
        begins = [address for address, _ in image.code]
        ends = [address + len(content) for address, content in image.code]
        self._rows: list[Row] = []
        for rows, end in sequences:
            place = bisect_right(begins, rows[0].address) - 1
            # Code that the linker removed has rows at address 0.
            if place >= 0 and rows[0].address < ends[place] and rows[0].address < end:
                self._rows += rows
                self._rows.append(Row(end, "", _END, begins_statement=False))
        if not self._rows:
            raise ConfigError(_WITHOUT_LINES.format(name=image.name))
        # The last of several rows at one address applies, but rows that end a sequence come first.
        self._rows.sort(key=lambda row: (row.address, row.line != _END))
        self._starts = [row.address for row in self._rows]

    def coverage(self, code: ExecutedCode) -> Coverage:
        """Return the counts of lines, functions and branches of all code outside libraries."""
        coverage = Coverage({row.file: FileCoverage() for row in self._rows if row.file})
        instructions = self._instructions()
        self._count_lines(coverage, code, instructions.instructions)
        self._count_functions(coverage, code)
        self._count_branches(coverage, code, instructions.branches)
        return coverage

    def _row_at(self, address: int) -> Row:
        """Return the row of an address; for an address before all code, the last row, which has no line."""
        return self._rows[bisect_right(self._starts, address) - 1]

    def _instructions(self) -> _Code:
        """Return the instructions and branches of the code with lines."""
        code = _Code()
        for address, content in self._image.code:
            for instruction in decode(address, content):
                at = instruction.address
                code.instructions.add(at)
                if instruction.begins_it_block:
                    code.branches.append(Branch(at, guarded=at + instruction.size))
                elif instruction.conditional:
                    code.branches.append(Branch(at))
        return code

    def _count_lines(self, coverage: Coverage, code: ExecutedCode, instructions: set[int]) -> None:
        """Set the count of each line to that of its most frequent statement start, summed over functions."""
        most: dict[tuple[str, int, bool], dict[int, int]] = {}
        for row in self._rows:
            if row.line > 0 and row.address in instructions:
                function = self._image.function_at(row.address)
                at = function.address if function else -1
                counts = most.setdefault((row.file, row.line, row.begins_statement), {})
                counts[at] = max(counts.get(at, 0), code.executed[row.address])
        for (file, line, begins), counts in most.items():
            if begins or (file, line, True) not in most:
                coverage.files[file].lines[line] = sum(counts.values())

    def _count_functions(self, coverage: Coverage, code: ExecutedCode) -> None:
        whole: set[tuple[str, str]] = set()
        for address in sorted({function.address for function in self._image.functions}):
            row = self._first_row(address)
            symbol = self._image.function_at(address)
            if row is None or symbol is None:
                continue
            name, _, clone = symbol.name.partition(".")
            functions, count = coverage.files[row.file].functions, code.executed[address]
            if f".{clone}".startswith(_SPLIT_PARTS):
                functions.setdefault(name, (row.line, count))
            elif (row.file, name) in whole:  # the compiler made several copies of the function
                functions[name] = functions[name][0], functions[name][1] + count
            else:
                functions[name] = row.line, count
                whole.add((row.file, name))

    def _first_row(self, address: int) -> Row | None:
        """Return the first row at the start of a function."""
        place = bisect_right(self._starts, address - 1)
        row = self._rows[place] if place < len(self._rows) else None
        while row is not None and row.address == address and row.line <= 0:
            place += 1
            row = self._rows[place] if place < len(self._rows) else None
        return row if row is not None and row.address == address else None

    def _count_branches(self, coverage: Coverage, code: ExecutedCode, branches: list[Branch]) -> None:
        numbers: dict[tuple[str, int], int] = {}
        for branch in sorted(branches, key=lambda branch: branch.address):
            row = self._row_at(branch.address)
            if row.line <= 0:
                continue
            number = numbers[row.file, row.line] = numbers.get((row.file, row.line), -1) + 1
            away = code.jumped[branch.address] if branch.guarded is None else code.executed[branch.guarded]
            on = code.executed[branch.address] - away
            coverage.files[row.file].branches[row.line, number] = on, away


def _sequences(dwarf: Any) -> Iterator[tuple[list[Row], int]]:
    """Yield the rows and the end address of each sequence of the firmware's own code."""
    for unit, program in line_programs(dwarf):
        top = unit.get_top_DIE()
        folder = _text(top, "DW_AT_comp_dir")
        if _is_library(PurePosixPath(folder, _text(top, "DW_AT_name"))):
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
            # Code from a library's header is ignored, but its row ends the previous row.
            rows.append(Row(state.address & ~1, name, state.line if name else 0, bool(state.is_stmt)))


def _text(die: Any, attribute: str) -> str:
    return str(die.attributes[attribute].value.decode(errors="replace")) if attribute in die.attributes else ""


def _file_names(program: Any, folder: str) -> dict[int, str]:
    """Return the display names of a unit's files; empty for those of libraries."""
    header = program.header
    is_new = header.version >= 5
    folders = [folder_name.decode(errors="replace") for folder_name in header.include_directory]
    names = {}
    for number, entry in enumerate(header.file_entry, 0 if is_new else 1):
        index = entry.dir_index if is_new else entry.dir_index - 1
        path = PurePosixPath(folders[index] if 0 <= index < len(folders) else "", entry.name.decode(errors="replace"))
        names[number] = "" if _is_library(PurePosixPath(folder, path)) else _display_path(folder, path)
    return names


def _display_path(folder: str, path: PurePosixPath) -> str:
    """Return a path relative to the current folder if it is below it; paths that a build has mapped stay relative."""
    if folder.startswith("/") or path.parts[:1] == ("..",):
        path = PurePosixPath(folder, path)
    name = os.path.normpath(path)
    present_folder = f"{Path.cwd()}/"
    return name.removeprefix(present_folder)


def _is_library(path: PurePosixPath) -> bool:
    """Return whether a file belongs to the compiler's libraries or their headers."""
    parts = set(path.parts)
    return bool(parts & LIBRARIES) or {"arm-none-eabi", "include"} <= parts
