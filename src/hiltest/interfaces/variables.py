"""Variables of firmware by their paths: each step of a path leads to a place, or is refused with a reason."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from pathlib import PurePosixPath
from typing import Any, Protocol

from hiltest.errors import ConfigError
from hiltest.interfaces.c_types import (
    ArrayType,
    BitField,
    CType,
    Member,
    NumberType,
    PointerType,
    RecordType,
    read_type,
    size_of,
    stated_type,
)
from hiltest.interfaces.places import Place, Scalar, scalar
from hiltest.interfaces.variable_index import VariableIndex, nearest_names
from hiltest.interfaces.variable_path import DereferenceStep, IndexStep, MemberStep, Step, VariablePath, read_path
from hiltest.virtual.program.debug_entries import strip_qualifiers
from hiltest.virtual.program.elf import FirmwareImage, Symbol

_MOST_NUMBERS = 1024  # numbers of one path; the largest useful one is a matrix of 9
_DEEPEST = 16  # nesting of anonymous members


@dataclass(frozen=True, slots=True)
class _Location:
    """Position on a path; an offset counts from the last pointer's target."""

    kind: CType
    written: str
    address: int
    beyond: tuple[int, ...] = ()
    bits: BitField | None = None

    def moved(self, by: int, kind: CType, written: str, bits: BitField | None = None) -> _Location:
        """Return a place `by` bytes further on."""
        moved = replace(self, kind=kind, written=self.written + written, bits=bits)
        if self.beyond:
            return replace(moved, beyond=(*self.beyond[:-1], self.beyond[-1] + by))
        return replace(moved, address=self.address + by)

    def followed(self, by: int, kind: CType, written: str) -> _Location:
        """Return the target of the pointer at this place, `by` bytes further on."""
        return replace(self, kind=kind, written=self.written + written, beyond=(*self.beyond, by), bits=None)


class DebuggedFile(Protocol):
    """A file with debug information, such as a `FirmwareImage`."""

    name: str

    @property
    def objects(self) -> Sequence[Symbol]:
        """Variables of its symbol table."""

    @property
    def functions(self) -> Sequence[Symbol]:
        """Functions of its symbol table."""

    def debug_information(self) -> Any:
        """Return a reader of its debug information; None without any."""

    def function_entry(self, function: str) -> Any:
        """Return the entry of a function in the debug information; None without one."""


class Variables:
    """Variables of a firmware image, or of another file with debug information."""

    def __init__(self, image: DebuggedFile) -> None:
        self._image = image
        self._declared: dict[str, _Location] = {}

    def declare(self, name: str, address: int, kind: CType) -> None:
        """Add a variable that the file does not have."""
        self._declared[name] = _Location(kind, name, address)

    def place(self, path: str, *, type_: str | None = None) -> Place:
        """Return the place of a path.

        Parameters
        ----------
        type_
            Type of the variable, such as ``float[3]``, if only the symbol table has it.

        Raises
        ------
        ConfigError
            If the path leads nowhere, with the most similar names, or if the debug information is damaged.
        """
        try:
            read = read_path(path)
            at = self._variable(read, type_)
            for step in read.steps:
                at = self._follow(at, step)
            if isinstance(at.kind, NumberType) and at.bits is not None:
                scalars = [scalar(at.kind, 0, at.bits)]
            else:
                scalars = list(self._numbers(at.kind, 0, at.written))
        except ConfigError as error:
            raise ConfigError(f"{self._image.name}: {error}") from error
        except Exception as error:  # the parser raises any type of error on damaged debug information
            raise ConfigError(
                f"{self._image.name}: {path}: the debug information is damaged ({str(error) or type(error).__name__}); "
                'link again with -g, or name a symbol and state its type: type = "float[3]"'
            ) from error
        return Place(path, at.kind.text, at.address & 0xFFFFFFFF, at.beyond, tuple(scalars))

    @cached_property
    def _index(self) -> VariableIndex | None:
        dwarf = self._image.debug_information()
        return None if dwarf is None else VariableIndex(dwarf, self._image.objects)

    def _variable(self, path: VariablePath, type_: str | None) -> _Location:
        if path.name in self._declared and not (path.file or path.scope):
            return self._declared[path.name]
        if type_ is not None:
            return self._locate_by_stated_type(path, stated_type(type_))
        index = self._index
        variable = index.find(path) if index is not None else None
        if variable is not None:
            return _Location(self.read_type(variable.type_entry), path.name, variable.address)
        symbols = self._objects(path.name)
        if symbols:
            raise ConfigError(
                f"{path.text}: there is no debug information about {path.name}, of {symbols[0].size} bytes; compile "
                'with -g, or state its type: type = "float[3]"'
            )
        within = index.functions_with(path.name) if index is not None else []
        if within:
            raise ConfigError(f"{path.text}: {path.name} is within a function; write {within[0]}::{path.name}")
        names = index.names if index is not None else [variable.name for variable in self._image.objects]
        hint = nearest_names(path.name, [*self._declared, *names])
        raise ConfigError(f"{path.text}: no variable {path.name}; {hint}")

    def _objects(self, name: str) -> list[Symbol]:
        return [variable for variable in self._image.objects if variable.name == name]

    def _locate_by_stated_type(self, path: VariablePath, kind: CType) -> _Location:
        symbols, size = self._objects(path.name), size_of(kind)
        if not symbols:
            names = [variable.name for variable in self._image.objects]
            raise ConfigError(f"{path.text}: no symbol {path.name}; {nearest_names(path.name, names)}")
        if len(symbols) > 1:
            places = ", ".join(f"0x{symbol.address:08x}" for symbol in symbols)
            raise ConfigError(
                f"{path.text}: {len(symbols)} symbols are called {path.name} ({places}), and their debug information "
                "is not there to choose; compile with -g"
            )
        if symbols[0].size != size:
            raise ConfigError(
                f"{path.text}: {kind.text} has {size} bytes, and the symbol {path.name} has {symbols[0].size}; state "
                "the type of the whole symbol"
            )
        return _Location(kind, path.name, symbols[0].address)

    def read_type(self, entry: object) -> CType:
        """Read a type; a struct that its unit only declares is read from its definition."""
        kind = read_type(entry)
        if isinstance(kind, RecordType) and kind.size is None and self._index is not None:
            return read_type(self._index.definition(strip_qualifiers(entry)))
        return kind

    # -- steps --------------------------------------------------------------------------------

    def _follow(self, at: _Location, step: Step) -> _Location:
        if isinstance(step, DereferenceStep):
            return self._dereference(at)
        if isinstance(step, IndexStep):
            return self._element(at, step)
        return self._member(at, step)

    def _dereference(self, at: _Location) -> _Location:
        if isinstance(at.kind, ArrayType):
            return at.moved(0, at.kind.element, "[0]")
        if not isinstance(at.kind, PointerType):
            raise ConfigError(f"{at.written} is {at.kind.text}, not a pointer; leave out the *")
        return replace(at.followed(0, self._target(at), ""), written=f"*{at.written}")

    def _target(self, at: _Location) -> CType:
        assert isinstance(at.kind, PointerType)
        if at.kind.target is None:
            raise ConfigError(f"{at.written} is {at.kind.text}: its target type is unknown, so it has no value")
        return self.read_type(at.kind.target)

    def _element(self, at: _Location, step: IndexStep) -> _Location:
        if not isinstance(at.kind, ArrayType | PointerType):
            raise ConfigError(f"{at.written} is {at.kind.text}, not an array; leave out [{step.index}]")
        index = step.index if isinstance(step.index, int) else self._enumerator(step.index)
        element = at.kind.element if isinstance(at.kind, ArrayType) else self._target(at)
        size = size_of(element)
        if size is None:
            raise ConfigError(f"{at.written}: the size of {element.text} is not known; it cannot be indexed")
        if isinstance(at.kind, PointerType):
            return at.followed(index * size, element, f"[{step.index}]")
        if index < 0 or (at.kind.count is not None and index >= at.kind.count):
            most = "" if at.kind.count is None else f" to {at.kind.count - 1}"
            raise ConfigError(f"{at.written}[{step.index}]: {at.kind.text} has the elements 0{most}")
        return at.moved(index * size, element, f"[{step.index}]")

    def _enumerator(self, name: str) -> int:
        if self._index is None:
            raise ConfigError(f"[{name}]: without debug information no enum is known; write a number")
        return self._index.enumerator(name)

    def _member(self, at: _Location, step: MemberStep) -> _Location:
        sign = "->" if step.by_pointer else "."
        if isinstance(at.kind, ArrayType):
            raise ConfigError(f"{at.written} is {at.kind.text}; name an element, {at.written}[0]{sign}{step.name}")
        if isinstance(at.kind, PointerType) and not step.by_pointer:
            raise ConfigError(f"{at.written} is {at.kind.text}, a pointer; write {at.written}->{step.name}")
        if step.by_pointer:
            if not isinstance(at.kind, PointerType):
                raise ConfigError(f"{at.written} is {at.kind.text}, not a pointer; write {at.written}.{step.name}")
            at = at.followed(0, self._target(at), "")
        record = at.kind
        if not isinstance(record, RecordType):
            raise ConfigError(f"{at.written} is {record.text}, not a struct: it has no {step.name}")
        if record.size is None:
            raise ConfigError(f"{at.written}: this firmware has no definition of {record.text}, only its name")
        members = dict(self._members_by_name(record, 0))
        if step.name not in members:
            raise ConfigError(
                f"{at.written}: {record.text} has no member {step.name}; {nearest_names(step.name, list(members))}"
            )
        offset, member = members[step.name]
        bits = member.bits and BitField(member.bits.first % 8, member.bits.bits)
        by = offset + (member.bits.first // 8 if member.bits else member.offset)
        return at.moved(by, self.read_type(member.type_entry), sign + step.name, bits)

    def _members_by_name(self, record: RecordType, depth: int) -> Iterator[tuple[str, tuple[int, Member]]]:
        """Yield the members by name, each with the offset of its struct; anonymous ones yield their own members."""
        if depth > _DEEPEST:
            raise ValueError("structs within themselves")
        for member in record.members:
            inner = read_type(member.type_entry) if not member.name else None
            if isinstance(inner, RecordType):
                for name, (offset, inner_member) in self._members_by_name(inner, depth + 1):
                    yield name, (member.offset + offset, inner_member)
            elif member.name:
                yield member.name, (0, member)

    # -- numbers ------------------------------------------------------------------------------

    def _numbers(self, kind: CType, offset: int, written: str) -> Iterator[Scalar]:
        """Yield the numbers of a value, in their order in memory.

        Raises
        ------
        ConfigError
            If the value does not consist of numbers only, or has too many.
        """
        if isinstance(kind, NumberType):
            yield scalar(kind, offset)
        elif isinstance(kind, ArrayType):
            yield from self._numbers_of_array(kind, offset, written)
        elif isinstance(kind, RecordType) and not kind.is_union and kind.size is not None:
            for member in kind.members:
                inner, name = self.read_type(member.type_entry), f"{written}.{member.name}" if member.name else written
                if member.bits is not None and isinstance(inner, NumberType):
                    yield scalar(inner, offset, member.bits)
                else:
                    yield from self._numbers(inner, offset + member.offset, name)
        else:
            raise ConfigError(f"{written} is {_refusal(kind, written)}")

    def _numbers_of_array(self, kind: ArrayType, offset: int, written: str) -> Iterator[Scalar]:
        size = size_of(kind.element)
        if kind.count is None or size is None:
            raise ConfigError(f"{written} is {kind.text}: its length is not known; name its elements")
        first = list(self._numbers(kind.element, 0, f"{written}[0]"))
        if kind.count * len(first) > _MOST_NUMBERS:
            raise ConfigError(f"{written} is {kind.count * len(first)} numbers; name the intended elements")
        for number in range(kind.count):
            for part in first:
                yield replace(part, offset=offset + number * size + part.offset)


def function_address(image: FirmwareImage, written: str) -> int:
    """Return the address of a function: ``name``, or ``file.c:name`` for one of several.

    Raises
    ------
    ConfigError
        If there is none of this name, or several.
    """
    file, _, name = written.rpartition(":")
    files = {
        function.address: image.location_at(function.address).partition(":")[0]
        for function in image.functions
        if function.name == name
    }
    chosen = [address for address, place in files.items() if not file or place == PurePosixPath(file).name]
    if len(chosen) == 1:
        return chosen[0]
    if files:
        places = ", ".join(f"{place or 'unknown file'} (0x{address:08x})" for address, place in files.items())
        example = next((place for place in files.values() if place), "file.c")
        raise ConfigError(f"{image.name}: {written}: {name} is in {places}; select one: {example}:{name}")
    names = [function.name for function in image.functions]
    raise ConfigError(
        f"{image.name}: no function {written}; {nearest_names(name, names)}. One that the compiler has inlined has "
        "no return: declare it noinline"
    )


def _refusal(kind: CType, written: str) -> str:
    if isinstance(kind, PointerType):
        target = read_type(kind.target)
        inner = [member.name for member in target.members if member.name] if isinstance(target, RecordType) else []
        example = f"{written}->{inner[0]}" if inner else f"*{written} or {written}[0]"
        return f"{kind.text}, a pointer: name its target, {example}"
    if isinstance(kind, RecordType):
        reason = "a union" if kind.is_union else "of unknown size"
        names = ", ".join(member.name for member in kind.members[:6] if member.name)
        return f"{kind.text}, {reason}: name a member of it" + (f" ({names})" if names else "")
    return f"{kind.text}, which has no value to read"
