"""Variables of firmware by name, from its debug information: the address of each, or the reason why it has none."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from difflib import get_close_matches
from functools import cached_property
from pathlib import PurePosixPath
from typing import Any

from hiltest.errors import ConfigError
from hiltest.interfaces.c_types import read_type, size_of
from hiltest.interfaces.variable_path import VariablePath, read_path
from hiltest.virtual.program.debug_entries import STRUCTURES, children, name_of, next_type, origin_of
from hiltest.virtual.program.elf import Symbol

# DWARF operations at the beginning or end of a location.
_ADDRESS, _PLUS_CONSTANT, _REGISTER, _REGISTER_X = 0x03, 0x23, range(0x50, 0x70), 0x90
_THREAD_LOCAL = {0x9B, 0xE0}
_REMOVED = {0, 0xFFFFFFFF}  # addresses that linkers write for removed variables
# Forms of a location that varies over the code.
_LISTS = {"DW_FORM_sec_offset", "DW_FORM_loclistx", "DW_FORM_data4", "DW_FORM_data8"}
_VOLATILE = "declare it volatile to have it in memory"
_MOST_NAMED = 8
_MOST_FILES = 64  # with static variables of one name, which are told apart by their files
_CPP = {0x04, 0x1A, 0x21, 0x2B}  # DW_LANG_C_plus_plus, and those of 11, 14 and 20


@dataclass(frozen=True, slots=True)
class FoundVariable:
    """A variable at an address."""

    address: int
    type_entry: Any
    """Entry of its type."""
    file: str
    """Source file."""


class _NoPlaceError(Exception):
    """Error for a variable without an address; the text has the reason."""


class VariableIndex:
    """All variables of a file's debug information.

    Parameters
    ----------
    dwarf
        Debug information of pyelftools.
    objects
        Variables of the symbol table. The linker has removed a variable at address 0 that the table does not have. The
        table also has the address of variables whose debug information lacks it, as after link-time optimisation or
        from an assembler source.
    """

    def __init__(self, dwarf: Any, objects: Sequence[Symbol]) -> None:
        self._addresses = {symbol.address for symbol in objects}
        self._symbols: dict[str, list[Symbol]] = {}
        for symbol in objects:
            self._symbols.setdefault(symbol.name, []).append(symbol)
        self._units = [unit.get_top_DIE() for unit in dwarf.iter_CUs()]
        self._types = [unit.get_top_DIE() for unit in dwarf.iter_TUs()]  # of -fdebug-types-section

    @cached_property
    def _entries_by_name(self) -> dict[str, list[tuple[Any, str]]]:
        """Entries with the file of each, by name with namespaces and class."""
        scoped = [(scope, entry) for top in self._units for scope, entry in _scoped_entries(top)]
        # In C++ a definition is outside its namespace or class, which contains only the declaration.
        declared = {entry.offset: scope for scope, entry in scoped if scope}
        by_name: dict[str, list[tuple[Any, str]]] = {}
        for scope, entry in scoped:
            if entry.tag == "DW_TAG_variable":
                name = declared.get(origin_of(entry).offset, scope) + name_of(entry)
                by_name.setdefault(name, []).append((entry, _source_file(entry)))
        return by_name

    def find(self, path: VariablePath) -> FoundVariable | None:
        """Return the variable at the start of a path; None if the debug information has none of its name.

        Raises
        ------
        ConfigError
            If there are several, or it has no address.
        """
        entries = self._entries(path)
        if path.file and entries:
            files = sorted({file for _, file in entries})
            entries = [(entry, file) for entry, file in entries if _same_file(path.file, file)]
            if not entries:
                raise ConfigError(f"{path.text}: {path.name} is not in {path.file}, but in {', '.join(files)}")
        variables: dict[int, FoundVariable] = {}
        reasons: list[str] = []
        for entry, file in entries:
            try:
                address = self._address(entry)
                variables.setdefault(address, FoundVariable(address, next_type(entry), file))
            except _NoPlaceError as reason:
                reasons.append(str(reason))
        if len(variables) > 1:
            places = sorted(f"{variable.file} (0x{variable.address:08x})" for variable in variables.values())
            example = PurePosixPath(min(variable.file for variable in variables.values())).name
            raise ConfigError(
                f"{path.text}: {len(variables)} variables are called {path.name}: {', '.join(places)}; select one: "
                f"{example}:{path.name}"
            )
        if not variables and reasons:
            by_symbol = self._find_by_symbol(path.name, *entries[0])
            if by_symbol is None:
                raise ConfigError(f"{path.text}: {path.name} {reasons[0]}")
            return by_symbol
        return next(iter(variables.values()), None)

    def _find_by_symbol(self, name: str, entry: Any, file: str) -> FoundVariable | None:
        """Return a variable at the only symbol of its name and size."""
        symbols = self._symbols.get(name, [])
        kind = next_type(entry)
        if len(symbols) != 1 or symbols[0].size != size_of(read_type(kind)):
            return None
        return FoundVariable(symbols[0].address, kind, file)

    def _entries(self, path: VariablePath) -> list[tuple[Any, str]]:
        full = f"{path.scope}::{path.name}" if path.scope else path.name
        entries = self._entries_by_name.get(full, [])
        if path.scope and not entries:
            return self._statics.get((path.scope, path.name), [])
        return entries

    @cached_property
    def _statics(self) -> dict[tuple[str, str], list[tuple[Any, str]]]:
        """Static variables within functions, with the file of each, by the names of function and variable."""
        statics: dict[tuple[str, str], list[tuple[Any, str]]] = {}
        for name, entry in (
            (name_of(function), entry)
            for top in self._units
            for _, function in _scoped_entries(top)
            if function.tag == "DW_TAG_subprogram"
            for entry in _nested_entries(function)
            if entry.tag == "DW_TAG_variable"
            and "DW_AT_location" in entry.attributes
            and _operations(entry)[:1] in ([_ADDRESS], [])
        ):
            statics.setdefault((name, name_of(entry)), []).append((entry, _source_file(entry)))
        return statics

    def listed(self) -> Iterator[tuple[str, FoundVariable]]:
        """Yield every variable in memory, with its path."""
        within = {"::".join(names): entries for names, entries in self._statics.items() if names[0]}
        for name, entries in [*self._entries_by_name.items(), *within.items()]:
            files = sorted({file for _, file in entries})[:_MOST_FILES]
            for path in (name, *(f"{PurePosixPath(file).name}:{name}" for file in files)):
                try:
                    variable = self.find(read_path(path))
                except ConfigError:
                    continue  # without a name or an address, or ambiguous: then by its file
                if variable is not None:
                    yield path, variable
                    break

    def functions_with(self, name: str) -> list[str]:
        """Return the functions that have a static variable of a name."""
        return sorted({function for function, variable in self._statics if variable == name and function})

    @property
    def names(self) -> list[str]:
        """Names with namespaces and class."""
        return [full_name for full_name in self._entries_by_name if full_name]

    def enumerator(self, name: str) -> int:
        """Return the value of an enumerator.

        Raises
        ------
        ConfigError
            If there is none, or several of different values.
        """
        values = self._enumerators.get(name, set())
        if len(values) == 1:
            return next(iter(values))
        if values:
            listed = ", ".join(map(str, sorted(values)))
            raise ConfigError(f"{name} is an enumerator of several enums, with the values {listed}; write a number")
        raise ConfigError(
            f"[{name}]: no enum has {name}; macros and unused enums are not in the debug information: write the number"
        )

    @cached_property
    def _enumerators(self) -> dict[str, set[int]]:
        values: dict[str, set[int]] = {}
        for top in [*self._units, *self._types]:
            for _, entry in _scoped_entries(top):
                for child in children(entry) if entry.tag == "DW_TAG_enumeration_type" else ():
                    if child.tag == "DW_TAG_enumerator":
                        values.setdefault(name_of(child), set()).add(child.attributes["DW_AT_const_value"].value)
        return values

    def definition(self, record: Any) -> Any:
        """Return the definition of a struct that a unit only declares; the entry itself if there is none."""
        name = name_of(record)
        for top in self._units if name else ():
            for _, entry in _scoped_entries(top):
                if entry.tag == record.tag and "DW_AT_declaration" not in entry.attributes and name_of(entry) == name:
                    return entry
        return record

    def _address(self, entry: Any) -> int:
        """Read the address of a variable.

        Raises
        ------
        _NoPlaceError
            If it has no address.
        """
        attributes = entry.attributes
        if "DW_AT_location" not in attributes:
            if "DW_AT_const_value" in attributes:
                raise _NoPlaceError("is not in memory: the compiler uses its constant value in the code")
            if "DW_AT_declaration" in attributes:
                raise _NoPlaceError("is declared, but not defined in this firmware")
            raise _NoPlaceError(f"is not in memory: the compiler has optimised it away; {_VOLATILE}")
        if attributes["DW_AT_location"].form in _LISTS:
            raise _NoPlaceError(f"moves between registers and memory; {_VOLATILE}")
        operations = _operations(entry)
        first = operations[0] if operations else -1
        if first == -1:
            raise _NoPlaceError(f"is not in memory: the compiler has optimised it away; {_VOLATILE}")
        if _THREAD_LOCAL & {first, operations[-1]}:
            raise _NoPlaceError("is thread-local: each thread has its own; copy the value into a plain static variable")
        if first in _REGISTER or first == _REGISTER_X:
            raise _NoPlaceError(f"is in a register only; {_VOLATILE}")
        address = _plain_address(operations, entry.cu["address_size"])
        if address is None:
            raise _NoPlaceError(f"is split or computed, without an address; {_VOLATILE}")
        if address in _REMOVED and address not in self._addresses:
            raise _NoPlaceError("is not in this firmware: the linker removed it as unused")
        return address


def _operations(entry: Any) -> list[int]:
    place = entry.attributes["DW_AT_location"]
    return [] if place.form in _LISTS else list(place.value)


def _plain_address(operations: list[int], size: int) -> int | None:
    """Return the address of a location that is constant, with or without an added offset."""
    if operations[0] != _ADDRESS or len(operations) <= size:
        return None
    address, rest = int.from_bytes(bytes(operations[1 : 1 + size]), "little"), operations[1 + size :]
    if rest and rest[0] != _PLUS_CONSTANT:
        return None
    return address + sum((byte & 0x7F) << 7 * number for number, byte in enumerate(rest[1:])) & 0xFFFFFFFF


def _scoped_entries(scope: Any, prefix: str = "") -> Iterator[tuple[str, Any]]:
    """Yield the entries of a unit, its namespaces and its C++ classes, with qualified names."""
    in_cpp = scope.cu.get_top_DIE().attributes.get("DW_AT_language")
    classes = STRUCTURES if in_cpp is not None and in_cpp.value in _CPP else frozenset()
    for entry in children(scope):
        if entry.tag == "DW_TAG_namespace" or (entry.tag in classes and name_of(entry)):
            name = name_of(entry)
            yield from _scoped_entries(entry, f"{prefix}{name}::" if name else prefix)
        yield prefix, entry


def _nested_entries(entry: Any) -> Iterator[Any]:
    """Yield all descendants of an entry."""
    for child in children(entry):
        yield child
        yield from _nested_entries(child)


def _source_file(entry: Any) -> str:
    """Return the source file of an entry's unit; after link-time optimisation, the original one."""
    return name_of(origin_of(entry).cu.get_top_DIE()) or "a file without a name"


def _same_file(written: str, file: str) -> bool:
    parts = PurePosixPath(written).parts
    return PurePosixPath(file).parts[-len(parts) :] == parts


def nearest_names(name: str, names: list[str]) -> str:
    """Return the most similar names, or some if none is similar, as the end of a sentence."""
    lower = {full_name.lower(): full_name for full_name in names}
    scoped = [full_name for full_name in names if full_name.endswith(f"::{name}")]
    close = scoped[:3] or [lower[match] for match in get_close_matches(name.lower(), lower, n=3)]
    if close:
        return f"nearest: {', '.join(close)}"
    if not names:
        return "the file has no names; use the ELF of the linker, with -g"
    listed = ", ".join(sorted(names)[:_MOST_NAMED])
    return f"there are: {listed}" + (f" and {len(names) - _MOST_NAMED} more" if len(names) > _MOST_NAMED else "")
