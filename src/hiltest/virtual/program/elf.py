"""Firmware images: segments to load, symbols, and source lines.

The ELF is untrusted input. Header, segments, symbols and processor are needed for loading: they are read and checked
at once, and a `ConfigError` names the problem. Debug information only adds names; if it is damaged, it is ignored.
"""

from __future__ import annotations

import bisect
import io
import re
import threading
from collections.abc import Iterator, Set
from contextlib import suppress
from dataclasses import dataclass
from functools import cached_property, lru_cache
from itertools import pairwise
from pathlib import Path, PurePosixPath
from typing import Any

from elftools.elf.elffile import ELFFile

from hiltest.budgets import DEBUG, ELF, SEGMENTS, BudgetError
from hiltest.errors import ConfigError
from hiltest.json_files import read_bounded
from hiltest.virtual.program.debug_entries import line_programs
from hiltest.virtual.program.image_formats import convert_to_elf
from hiltest.virtual.program.other_chips import machine_title, other_chip
from hiltest.virtual.program.signatures import Signature, read_signature, read_subprograms

# Build attributes, from the addenda to the Arm ABI: profile, architecture and floating-point unit.
_PROFILE_M = ord("M")
_NO_FPU, _FPV4_SP, _FPV5_SP = {0}, {0, 6}, {0, 6, 8}
_ARCHITECTURES = {
    10: "Armv7-M",
    11: "Armv6-M",
    12: "Armv6S-M",
    13: "Armv7E-M",
    16: "Armv8-M Baseline",
    17: "Armv8-M Mainline",
    21: "Armv8.1-M Mainline",
}


@dataclass(frozen=True, slots=True)
class Core:
    """A processor core, and the build attributes of the code that it runs."""

    title: str
    architectures: Set[int]
    """Among them 0, which files without the attribute have."""
    floating_point: Set[int]
    remedy: str
    """Options of GCC, for messages."""


CORES = {
    "cortex-m0": Core("Cortex-M0", {0, 11, 12}, _NO_FPU, "-mcpu=cortex-m0, or name another --part"),
    "cortex-m0plus": Core("Cortex-M0+", {0, 11, 12}, _NO_FPU, "-mcpu=cortex-m0plus, or name another --part"),
    "cortex-m3": Core("Cortex-M3", {0, 10, 11, 12}, _NO_FPU, "-mcpu=cortex-m3, or name another --part"),
    "cortex-m4": Core("Cortex-M4F", {0, 10, 11, 12, 13}, _FPV4_SP, "-mcpu=cortex-m4 -mfpu=fpv4-sp-d16"),
    "cortex-m33": Core(
        "Cortex-M33",
        {0, 10, 11, 12, 13, 16, 17},
        _FPV5_SP,
        "-mcpu=cortex-m33 -mfpu=fpv5-sp-d16, or name another --part",
    ),
}
_HARD_FLOAT = 0x400  # EF_ARM_ABI_FLOAT_HARD, which the linker sets for the whole file
_BUILD_ID = re.compile(rb"\x04\0{3}([\x04-\x20])\0{3}\x03\0{3}GNU\0(.{4,32})", re.DOTALL)  # the note with its header
_CACHED_IMAGES = 8  # parsed images, each a few megabytes with its debug information
_MARK = re.compile(r"\$[dt](\..*)?")  # a mapping symbol (AAELF32, 5.5.5): data or Thumb code begins
# Folders of the compiler's own libraries, as in the names of compilation units.
LIBRARIES = frozenset({"libgcc", "libstdc++-v3", "newlib", "picolibc"})


@dataclass(frozen=True, slots=True)
class LoadSegment:
    """A loadable part of the image."""

    address: int
    """Load address, where a programmer writes it."""
    run_address: int
    """Run address, to which start-up code copies it."""
    data: bytes
    run_size: int
    """Size at the run address, with zeroed data."""


@dataclass(frozen=True, slots=True)
class Symbol:
    """A function or object of the image; bit 0 of a function's address is cleared."""

    name: str
    address: int
    size: int
    is_function: bool


def load_image(source: Path | bytes, *, base: int | None = None, core: str = "cortex-m4") -> FirmwareImage:
    """Parse an ELF, Intel HEX or raw binary; the result is cached by name and content.

    Parameters
    ----------
    source
        File, or its content.
    base
        Address of a raw binary, and of its vector table; by default 0.
    core
        Name of the core that must be able to run it, of `CORES`.

    Raises
    ------
    ConfigError
        As for `FirmwareImage`.
    """
    name, content = ("firmware image", source) if isinstance(source, bytes) else _read_file(source)
    return _parse(name, content, base, core)


@lru_cache(maxsize=_CACHED_IMAGES)
def _parse(name: str, content: bytes, base: int | None, core: str) -> FirmwareImage:
    return FirmwareImage(convert_to_elf(name, content, base), name=name, vectors=base or 0, core=core)


def _read_file(path: Path) -> tuple[str, bytes]:
    return str(path), read_bounded(path, ELF, otherwise="name the firmware's ELF file")


class FirmwareImage:
    """A parsed ELF executable.

    Parameters
    ----------
    source
        File, or its content.
    name
        Name for messages.
    vectors
        Address of the vector table.
    core
        Name of the core that must be able to run it, of `CORES`.

    Raises
    ------
    ConfigError
        If it cannot be read, is not a complete ELF, or is for another processor.

    Attributes
    ----------
    symbols : dict of str to Symbol
        Functions and objects by name; empty for a stripped file.
    source_names : set of str
        Files of the symbols, as the compiler named them.
    hard_float : bool
        True if its functions pass floats in float registers.
    """

    def __init__(
        self, source: Path | bytes, *, name: str = "firmware image", vectors: int = 0, core: str = "cortex-m4"
    ) -> None:
        self.vectors = vectors
        self.name, content = (name, source) if isinstance(source, bytes) else _read_file(source)
        # Debug information is read at first use, by any of the boards that share this image.
        self._reading = threading.RLock()
        self._signatures: dict[str, Signature | None] = {}
        try:
            self._elf = ELFFile(io.BytesIO(content))
            self.hard_float = bool(self._elf.header.e_flags & _HARD_FLOAT)
            self._check_file(CORES[core])
            self.segments = self._read_segments()
            self._marks: list[tuple[int, bool]] = []  # address, and whether code begins at it
            self.source_names: set[str] = set()
            self._all_symbols = self._read_symbols()
            self.symbols = {symbol.name: symbol for symbol in self._all_symbols}
            self._check_processor(CORES[core])
        except ConfigError:
            raise
        except BudgetError as error:
            raise ConfigError(f"{self.name}: {error}; name the program of one chip") from error
        except Exception as error:  # the parser raises many types for a damaged file, from struct.error to KeyError
            raise ConfigError(
                f"{self.name}: not a complete ELF file ({str(error) or type(error).__name__}); "
                "give the .elf that the linker wrote, Intel HEX (.hex), or a raw binary (.bin)"
            ) from error

    def _check_file(self, core: Core) -> None:
        header = self._elf.header
        if header.e_machine != "EM_ARM" or self._elf.elfclass != 32 or not self._elf.little_endian:
            title = machine_title(header.e_machine)
            raise ConfigError(
                f"{self.name}: built for {f'{title}: ' if title else ''}{header.e_machine} ({self._elf.elfclass} bit), "
                f"the board has an Arm {core.title}; build with arm-none-eabi-gcc {core.remedy}"
            )
        if header.e_type != "ET_EXEC":
            raise ConfigError(f"{self.name}: {header.e_type} is not an executable; link it first")

    def _check_processor(self, core: Core) -> None:
        attributes = self._attributes()
        profile = attributes.get("TAG_CPU_ARCH_PROFILE", _PROFILE_M)
        architecture, floating = attributes.get("TAG_CPU_ARCH", 0), attributes.get("TAG_FP_ARCH", 0)
        unit = ""
        if profile != _PROFILE_M or architecture not in core.architectures:
            unit = _ARCHITECTURES.get(architecture, "") if profile == _PROFILE_M else ""
            unit = unit or "another core"
        elif floating not in core.floating_point or (self.hard_float and core.floating_point == _NO_FPU):
            unit = "another floating-point unit"
        if unit:
            chip = other_chip(self)
            raise ConfigError(
                f"{self.name}: {f'{chip}: ' if chip else ''}its attributes say that it is built for {unit}, "
                f"not for a {core.title}: build with {core.remedy}"
            )

    def _attributes(self) -> dict[str, Any]:
        """Return the compiler's attributes of the processor (section .ARM.attributes); empty without them."""
        section: Any = self._elf.get_section_by_name(".ARM.attributes")
        values: dict[str, Any] = {}
        for subsection in section.iter_subsections() if section is not None else ():
            for part in subsection.iter_subsubsections():
                values |= {attribute.tag: attribute.value for attribute in part.iter_attributes()}
        return values

    def section(self, name: str) -> bytes:
        """Return the content of a section, such as a table of names; empty if it is missing or damaged."""
        try:
            with self._reading:
                section: Any = self._elf.get_section_by_name(name)
                return b"" if section is None else bytes(section.data())
        except Exception:  # an unloaded section may be damaged
            return b""

    def _read_segments(self) -> tuple[LoadSegment, ...]:
        """Read the loadable segments in file order; a segment of zeroed data has no content."""
        headers = list(self._elf.iter_segments("PT_LOAD"))
        SEGMENTS.check(size=sum(segment.header.p_filesz for segment in headers), items=len(headers))
        segments = tuple(
            LoadSegment(segment.header.p_paddr, segment.header.p_vaddr, segment.data(), segment.header.p_memsz)
            for segment in headers
        )
        for segment, read in zip(headers, segments, strict=True):
            if len(read.data) != segment.header.p_filesz or segment.header.p_memsz < segment.header.p_filesz:
                raise ConfigError(f"{self.name}: the file ends within a segment; copy it again")
        if not any(segment.data for segment in segments):
            raise ConfigError(f"{self.name}: it has no data to load; link the program, or name another file")
        return segments

    def _read_symbols(self) -> list[Symbol]:
        """Return named functions and objects, with global ones last to take precedence; collect mapping symbols."""
        symbols: list[Symbol] = []
        ELF.check(size=sum(section.data_size for section in self._elf.iter_sections()))  # once decompressed
        table: Any = self._elf.get_section_by_name(".symtab")
        if table is None:
            return symbols
        ELF.check(items=table.num_symbols())
        for entry in sorted(table.iter_symbols(), key=lambda symbol: symbol.entry.st_info.bind == "STB_GLOBAL"):
            kind = entry.entry.st_info.type
            if kind in ("STT_FUNC", "STT_OBJECT") and entry.name:
                is_function = kind == "STT_FUNC"
                address = entry.entry.st_value & ~1 if is_function else entry.entry.st_value
                symbols.append(Symbol(entry.name, address, entry.entry.st_size, is_function))
            elif kind == "STT_FILE":
                self.source_names.add(entry.name)
            elif _MARK.fullmatch(entry.name):
                self._marks.append((entry.entry.st_value & ~1, entry.name[1] == "t"))
        self._marks.sort()
        return symbols

    def read(self, address: int, size: int) -> bytes:
        """Return bytes of the file by their run address, fewer than `size` at the end of a segment.

        Raises
        ------
        ValueError
            If the address is not in the file.
        """
        for segment in self.segments:
            offset = address - segment.run_address
            if 0 <= offset < len(segment.data):
                return segment.data[offset : offset + size]
        raise ValueError(f"{self.name}: no data at 0x{address:08x}")

    def code_from(self, address: int, size: int) -> bytes:
        """Return code as `read` does, up to data that mapping symbols mark."""
        if self.is_data_in_code(address):
            return b""
        following = bisect.bisect(self._data_begins, address)
        end = self._data_begins[following] if following < len(self._data_begins) else address + size
        return self.read(address, min(size, end - address))

    @cached_property
    def _data_begins(self) -> list[int]:
        return [address for address, is_code in self._marks if not is_code]

    def is_data_in_code(self, address: int) -> bool:
        """Return whether mapping symbols mark data at an address."""
        index = bisect.bisect_right(self._marks, address, key=lambda mark: mark[0]) - 1
        return index >= 0 and not self._marks[index][1]

    @cached_property
    def code(self) -> tuple[tuple[int, bytes], ...]:
        """Address and content of all instructions, without data between them; empty without symbols."""
        chunks = []
        for (begin, is_code), (end, _) in pairwise([*self._marks, (1 << 32, False)]):
            if is_code and begin < end:
                with suppress(ValueError):  # the code may not be loaded
                    chunks.append((begin, self.read(begin, end - begin)))
        return tuple(chunks)

    @cached_property
    def build_id(self) -> str:
        """GNU build-id note in hexadecimal; empty without one. The note is loaded, so other formats contain it, too."""
        if not self._elf.num_sections():
            matches = (_BUILD_ID.search(segment.data) for segment in self.segments)
            return next((match[2][: match[1][0]].hex() for match in matches if match), "")
        try:
            section: Any = self._elf.get_section_by_name(".note.gnu.build-id")
            notes = section.iter_notes() if section is not None else ()
            return next((str(note.n_desc) for note in notes if note.n_type == "NT_GNU_BUILD_ID"), "")
        except Exception:  # an unloaded section may be damaged
            return ""

    @cached_property
    def compiler_flags(self) -> str:
        """Flags of GCC for all units except the compiler's own libraries, sorted; empty without debug information."""
        try:
            with self._reading:
                words = self._read_flags()
        except Exception:  # debug information may be damaged
            words = set()
        return " ".join(sorted(words))

    def _read_flags(self) -> set[str]:
        flags: set[str] = set()
        for unit in self._dwarf().iter_CUs():
            attributes = unit.get_top_DIE().attributes
            name, producer = attributes.get("DW_AT_name"), attributes.get("DW_AT_producer")
            if producer is None or not producer.value.startswith(b"GNU "):
                continue
            folders = set(PurePosixPath(name.value.decode(errors="replace")).parts) if name is not None else set()
            if not folders & LIBRARIES:
                flags |= {word for word in producer.value.decode(errors="replace").split() if word.startswith("-")}
        return flags

    @cached_property
    def functions(self) -> tuple[Symbol, ...]:
        """All functions; static ones of several files may share a name."""
        return tuple(symbol for symbol in self._all_symbols if symbol.is_function)

    @cached_property
    def objects(self) -> tuple[Symbol, ...]:
        """All objects, as for `functions`."""
        return tuple(symbol for symbol in self._all_symbols if not symbol.is_function)

    def debug_information(self) -> Any:
        """Return a new reader of the DWARF information (pyelftools); None without any.

        Raises
        ------
        Exception
            From the parser, if it is damaged.
        """
        with self._reading:
            return self._dwarf() if self._elf.has_dwarf_info() else None

    def _dwarf(self) -> Any:
        """Return the reader; it unpacks sections ``.zdebug_...``, which no compiler has made since 2015, unbounded."""
        sections = [section for section in self._elf.iter_sections() if "debug_" in section.name]
        is_bounded = not any(section.name.startswith(".z") for section in sections)
        DEBUG.check(size=sum(section.data_size for section in sections) if is_bounded else DEBUG.bytes + 1)
        return self._elf.get_dwarf_info()

    @cached_property
    def _functions_by_address(self) -> tuple[list[int], list[Symbol]]:
        functions = sorted((s for s in self._all_symbols if s.is_function), key=lambda s: (s.address, s.size > 0))
        return [s.address for s in functions], functions

    def function_at(self, address: int) -> Symbol | None:
        """Return the function whose code contains an address."""
        starts, functions = self._functions_by_address
        index = bisect.bisect_right(starts, address & ~1) - 1
        if index < 0:
            return None
        candidate = functions[index]
        return candidate if address < candidate.address + max(candidate.size, 2) else None

    @cached_property
    def _lines(self) -> tuple[list[int], list[tuple[int, str]]]:
        try:
            with self._reading:
                rows = sorted(self._line_rows())
        except Exception:  # damaged debug information: faults are then reported without lines
            rows = []
        return [row[0] for row in rows], [(row[1], row[2]) for row in rows]

    def _line_rows(self) -> Iterator[tuple[int, int, str]]:
        """Yield (first address, end address, "file:line") of every line-table row."""
        for _, program in line_programs(self._dwarf()):
            files = program.header.file_entry
            first = 0 if program.header.version >= 5 else 1
            previous: Any = None
            for entry in program.get_entries():
                state = entry.state
                if state is None:
                    continue
                if previous is not None and previous.address < state.address:
                    index = previous.file - first
                    if 0 <= index < len(files):
                        name = PurePosixPath(files[index].name.decode(errors="replace")).name
                        yield previous.address, state.address, f"{name}:{previous.line}"
                previous = None if state.end_sequence else state

    def location_at(self, address: int) -> str:
        """Return the source line of an address as ``file:line``; empty without debug information."""
        starts, rows = self._lines
        index = bisect.bisect_right(starts, address & ~1) - 1
        if index >= 0 and address < rows[index][0]:
            return rows[index][1]
        return ""

    @cached_property
    def _subprograms(self) -> dict[str, Any]:
        try:
            with self._reading:
                return read_subprograms(self._dwarf())
        except Exception:  # damaged debug information is ignored
            return {}

    def function_entry(self, function: str) -> Any:
        """Return the entry of a function in the debug information; None without one."""
        return self._subprograms.get(function)

    def signature(self, function: str) -> Signature | None:
        """Return a function's parameter and return types from DWARF; None without them."""
        with self._reading:
            if function not in self._signatures:
                self._signatures[function] = self._read_signature(function)
            return self._signatures[function]

    def _read_signature(self, function: str) -> Signature | None:
        die = self._subprograms.get(function)
        try:
            return None if die is None else read_signature(die)
        except Exception:  # damaged debug information is ignored
            return None
