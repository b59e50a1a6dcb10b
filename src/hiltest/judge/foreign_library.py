"""Functions of a shared library of the host with a foreign signature, in the process of `hiltest.judge.host_worker`."""

from __future__ import annotations

import ctypes
import io
import time
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from elftools.elf.elffile import ELFFile

from hiltest.errors import ConfigError
from hiltest.interfaces.c_types import CType, NumberKind, NumberType, PointerType
from hiltest.judge.foreign_calls import BoundCall, ForeignCalls
from hiltest.judge.signature_table import read_signature_table
from hiltest.virtual.program.elf import Symbol
from hiltest.virtual.program.signatures import read_subprograms


class _LibraryFile:
    """Symbols and debug information of a shared library."""

    def __init__(self, file: Path) -> None:
        self.name = file.name
        self._elf = ELFFile(io.BytesIO(file.read_bytes()))
        table: Any = self._elf.get_section_by_name(".symtab") or self._elf.get_section_by_name(".dynsym")
        symbols = [
            Symbol(symbol.name, symbol.entry.st_value, symbol.entry.st_size, symbol.entry.st_info.type == "STT_FUNC")
            for symbol in (table.iter_symbols() if table else ())
            if symbol.entry.st_info.type in ("STT_FUNC", "STT_OBJECT") and symbol.entry.st_value
        ]
        self.functions = [symbol for symbol in symbols if symbol.is_function]
        self.objects = [symbol for symbol in symbols if not symbol.is_function]
        self._entries = read_subprograms(self.debug_information()) if self._elf.has_dwarf_info() else {}

    def debug_information(self) -> Any:
        """Return a reader of its debug information; None without any."""
        return self._elf.get_dwarf_info() if self._elf.has_dwarf_info() else None

    def function_entry(self, function: str) -> Any:
        """Return the entry of a function in the debug information; None without one."""
        return self._entries.get(function)


class _HostMachine:
    """This process, which has loaded the library."""

    follows_pointers = False

    def __init__(self, file: Path, functions: Sequence[Symbol]) -> None:
        self._library, self._functions, self.taken_s = ctypes.CDLL(str(file)), functions, 0.0

    def reset(self) -> None:
        self.taken_s = 0.0

    def call(self, call: BoundCall, arguments: Sequence[Any], *, counted: bool) -> int | float | None:
        function = self._function(call.function)
        function.argtypes = [_type_in_c(kind) for kind in call.kinds]
        function.restype = _type_in_c(call.returns)
        passed = [
            (ctypes.c_char * len(argument)).from_buffer(argument) if isinstance(argument, bytearray) else argument
            for argument in arguments
        ]
        began = time.perf_counter()
        value: int | float | None = function(*passed)
        self.taken_s += (time.perf_counter() - began) * counted
        return value

    def read(self, address: int, size: int) -> bytes:
        return ctypes.string_at(self._base + address, size)

    def write(self, address: int, content: bytes) -> None:
        ctypes.memmove(self._base + address, content, len(content))

    @property
    def _base(self) -> int:
        """Address of the library in memory."""
        exported = next(symbol for symbol in self._functions if hasattr(self._library, symbol.name))
        place = ctypes.cast(getattr(self._library, exported.name), ctypes.c_void_p).value or 0
        return place - exported.address

    def _function(self, name: str) -> Any:
        if not hasattr(self._library, name):
            raise ConfigError(f"{name} is not exported; leave out static and -fvisibility=hidden")
        return getattr(self._library, name)


def _type_in_c(kind: CType) -> Any:
    if isinstance(kind, NumberType):
        if kind.kind is NumberKind.FLOAT:
            return ctypes.c_float if kind.size == 4 else ctypes.c_double
        sign = "" if kind.kind is NumberKind.SIGNED else "u"
        return getattr(ctypes, f"c_{sign}int{8 * kind.size}")
    return ctypes.c_void_p if isinstance(kind, PointerType) else None


def open_library(file: Path, table: Path) -> tuple[ForeignCalls, _HostMachine]:
    """Load a library, and bind the calls of a table.

    Raises
    ------
    ConfigError
        If the table does not fit the library.
    """
    try:
        library = _LibraryFile(file)
    except Exception as error:  # the parser raises any type of error on a damaged file
        raise ConfigError(f"{file.name} is damaged ({str(error) or type(error).__name__}); build it again") from error
    machine = _HostMachine(file, library.functions)
    return ForeignCalls(*read_signature_table(table), library, machine), machine
