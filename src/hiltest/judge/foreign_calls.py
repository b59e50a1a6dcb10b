"""Calls of functions with a foreign signature, as a `SignatureTable` maps it, by the types in the debug information."""

from __future__ import annotations

import re
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from typing import Any, Protocol

import numpy as np
from scipy.spatial.transform import Rotation

from hiltest.calibration.fit import Array
from hiltest.errors import ConfigError
from hiltest.interfaces.c_types import (
    ArrayType,
    CType,
    NumberKind,
    NumberType,
    OtherType,
    PointerType,
    decoded,
    size_of,
)
from hiltest.interfaces.places import NullPointer, Place
from hiltest.interfaces.variable_index import nearest_names
from hiltest.interfaces.variable_path import IndexStep, read_path
from hiltest.interfaces.variables import DebuggedFile, Variables
from hiltest.judge.signature_table import Call, SignatureTable, TableValue, TableVector, Variable
from hiltest.rig.rig_file import TomlSource
from hiltest.virtual.program.debug_entries import children, next_type, written_type

_CALLER, _ROOM = 0xF000_0000, 1 << 20  # addresses of the caller's variables, where no file has any
_GUARD = b"\xa5\x5a" * 32  # bytes behind each of them that the functions must not change
_BYTE = NumberType("byte", NumberKind.UNSIGNED, 1, {})
_CODES = {NumberKind.FLOAT: "f", NumberKind.SIGNED: "i", NumberKind.UNSIGNED: "u", NumberKind.BOOLEAN: "u"}
_NAME = re.compile(r"\s*(?:[^\[\]*]*:)?[\w$]+")
_JUDGED = ("add", "calibrate", "update")
_INPUTS = {"magnetometer": 3, "accelerometer": 3, "gyroscope": 3, "count": 1, "dt": 1, "rate": 1}
_OUTPUTS = {"hard_iron": 3, "heading": 1, "quaternion": 4}
_SOFT_IRON = {"matrix": 9, "symmetric": 6, "gains": 3}
_SYMMETRIC = [0, 1, 2, 1, 3, 4, 2, 4, 5]


@dataclass(slots=True, eq=False)
class _CallerVariable:
    """A variable of the caller. A `number` is passed by value, others by address; an array has any number of elements,
    and `size` bytes as far as known."""

    name: str
    address: int
    kind: CType
    number: NumberType | None
    size: int
    content: bytearray


@dataclass(frozen=True, slots=True)
class BoundCall:
    """A call whose types are known."""

    function: str
    arguments: tuple[_CallerVariable | int | float, ...]
    kinds: tuple[CType, ...]
    returns: CType


class Machine(Protocol):
    """A machine that executes the functions."""

    follows_pointers: bool

    def reset(self) -> None:
        """Give the variables of the file their initial values, if that is possible."""

    def call(self, call: BoundCall, arguments: Sequence[Any], *, counted: bool) -> int | float | None:
        """Call a function with numbers, and bytearrays that are passed by address; count its time if it is judged."""

    def read(self, address: int, size: int) -> bytes:
        """Return bytes of the file's variables; ValueError if there is no memory."""

    def write(self, address: int, data: bytes) -> None:
        """Write bytes of the file's variables; ValueError if there is no memory."""


@dataclass(frozen=True, slots=True)
class _Input:
    """A number to write: its address in sample 0, its type, and the distance to the next sample [byte]."""

    address: int
    kind: NumberType
    stride: int


class ForeignCalls:
    """Functions of a file, called as a table says.

    Raises
    ------
    ConfigError
        If the file has no such function, member or variable; with file, line and key of the table.
    """

    def __init__(self, table: SignatureTable, source: TomlSource, file: DebuggedFile, machine: Machine) -> None:
        self._table, self._source, self._file, self._machine = table, source, file, machine
        self._variables = Variables(file)
        self._caller: list[_CallerVariable] = []
        self._calls: dict[str, BoundCall] = {}
        for key in ("start", "add", "calibrate", "update", "read"):
            if (call := table.call(key)) is not None:
                with self._naming(key):
                    self._calls[key] = self._bind(call)
        self._returning, returns = [(call, call.returns) for call in self._calls.values()][-1]
        self._return = None if isinstance(returns, OtherType) else self._new_variable("return", returns)
        self._success = table.success or ("zero" if self._return and table.calibrate else "always")
        if self._success != "always" and not isinstance(returns, NumberType):
            with self._naming("success"):
                raise ConfigError(f'{self._returning.function} returns {returns.text}, no number; write "always"')
        self._is_sampled = not table.is_filter and "add" not in self._calls
        self._bind_values()

    def calibrate(self, samples_ut: Array, accelerations_g: Array) -> tuple[bool, Array, Array]:
        """Calibrate from samples along the axes of the body.

        Parameters
        ----------
        samples_ut, accelerations_g
            Shape (n, 3).

        Returns
        -------
        tuple
            Whether the function refuses its calibration, hard iron (3,) [uT] and soft iron (3, 3).
        """
        self._restart(len(samples_ut), count=len(samples_ut))
        parts = [slice(None)] if self._is_sampled else [slice(place, place + 1) for place in range(len(samples_ut))]
        for part in parts:
            self._write("magnetometer", samples_ut[part])
            self._write("accelerometer", accelerations_g[part])
            self._invoke("add")
        self._invoke("calibrate")
        return self._is_refused(), *self._calibration()

    def start(self, rate_hz: float) -> None:
        """Start a filter anew."""
        self._restart(1, rate=rate_hz, dt=1.0 / rate_hz)

    def update(self, rate_rad_s: Array, gravity_g: Array, field_ut: Array) -> None:
        """Follow one reading, of three vectors of shape (3,) along the axes of the body."""
        self._write("gyroscope", np.degrees(rate_rad_s.astype(float)))
        self._write("accelerometer", gravity_g)
        self._write("magnetometer", field_ut)
        self._invoke("update")

    def read(self) -> Any:
        """Return a filter's heading [deg], or the quaternion x, y, z, w from body to NED, shape (4,)."""
        self._invoke("read")
        frame, quaternion = self._table.frame_of(), self._table.quaternion
        if quaternion is None:
            return frame.heading_deg(float(self._read("heading")[0]))
        numbers = np.roll(self._read("quaternion"), -1 if quaternion.order == "wxyz" else 0)
        if not np.isfinite(numbers).all() or not numbers.any():
            return np.full(4, np.nan)
        turn = Rotation.from_quat(numbers)
        earth, body = (Rotation.from_matrix(np.array(axes)) for axes in (self._table.earth_to_ned, frame.to_body))
        return (earth * (turn.inv() if quaternion.inverse else turn) * body.inv()).as_quat()

    # -- types and places -------------------------------------------------------------------------

    @contextmanager
    def _naming(self, *key: str) -> Iterator[None]:
        """Name line and key of the table in errors."""
        try:
            yield
        except Exception as error:  # the parser raises any type of error on damaged debug information
            reason = str(error) or type(error).__name__
            reason = reason if isinstance(error, ConfigError) else f"its debug information is damaged ({reason})"
            raise ConfigError(f"{self._source.where(key)}: {'.'.join(key)}: {reason}") from error

    def _bind(self, call: Call) -> BoundCall:
        names = [symbol.name for symbol in self._file.functions]
        if call.function not in names:
            raise ConfigError(
                f"no function {call.function} in {self._file.name}; {nearest_names(call.function, names)}"
            )
        entry = self._file.function_entry(call.function)
        if entry is None:
            raise ConfigError(f"there is no debug information about {call.function}; compile it with -g")
        types = [next_type(child) for child in children(entry) if child.tag == "DW_TAG_formal_parameter"]
        if len(types) != len(call.arguments):
            written = f"{call.function}({', '.join(map(written_type, types))})"
            raise ConfigError(f"{written} takes {len(types)} arguments, and the call has {len(call.arguments)}")
        kinds = [self._variables.read_type(kind) for kind in types]
        arguments = [self._argument(*pair) for pair in zip(call.arguments, kinds, strict=True)]
        pointed = [one.name for one in arguments if isinstance(one, _CallerVariable) and one.number is None]
        if len(set(pointed)) < len(pointed):
            raise ConfigError("a variable is passed twice by address; give each parameter a variable of its own")
        return BoundCall(call.function, tuple(arguments), tuple(kinds), self._variables.read_type(next_type(entry)))

    def _argument(self, written: Variable | int | float, kind: CType) -> _CallerVariable | int | float:
        if not isinstance(written, Variable):
            if not isinstance(kind, NumberType) and (written or not isinstance(kind, PointerType)):
                raise ConfigError(f"{written} is no {kind.text}; pass a variable: &name")
            return float(written) if isinstance(kind, NumberType) and kind.kind is NumberKind.FLOAT else int(written)
        name, number = written.name, kind if isinstance(kind, NumberType) else None
        if isinstance(kind, PointerType):
            target = self._variables.read_type(kind.target)
            if size_of(target) is None:
                if not written.length:
                    raise ConfigError(f"the size of {kind.text} is not known; write bytes, {name}[64], or NULL")
                target = _BYTE
            kind = target if written.by_address else ArrayType(f"{target.text}[]", target, None)
        elif number is None:
            raise ConfigError(f"{name} is {kind.text} by value; write a wrapper that takes its address")
        elif written.by_address or written.length:
            raise ConfigError(f"{name} is {kind.text}, not a pointer; write {name} alone")
        variable = self._named(name) or self._new_variable(name, kind, number)
        if (_bare_text(variable.kind), variable.number is None) != (_bare_text(kind), number is None):
            raise ConfigError(f"{name} is {variable.kind.text} in one call and {kind.text} in another")
        if isinstance(kind, ArrayType):
            variable.size = max(variable.size, written.length * (size_of(kind.element) or 1))
        if variable.size > _ROOM:
            raise ConfigError(f"{name} has {variable.size} bytes, more than any RAM here; write a smaller array")
        return variable

    def _new_variable(self, name: str, kind: CType, number: NumberType | None = None) -> _CallerVariable:
        address = _CALLER + len(self._caller) * _ROOM
        self._variables.declare(name, address, kind)
        self._caller.append(_CallerVariable(name, address, kind, number, size_of(kind) or 0, bytearray()))
        return self._caller[-1]

    def _bind_values(self) -> None:
        """Find the places of all inputs and outputs."""
        table = self._table
        self._inputs: dict[str, tuple[Array, list[_Input]]] = {}
        for key, size in _INPUTS.items():
            value: TableValue | None = getattr(table, key)
            if value is not None and (size > 1 or value.path or self._named(key)):
                with self._naming(key):
                    self._inputs[key] = self._matrix(key, value), self._bind_input(key, value, size)
        if self._is_sampled and "count" not in self._inputs:
            with self._naming("calibrate"):
                raise ConfigError('no argument is count, the number of samples; write it, or count = { path = "n" }')
        self._constants: list[tuple[_Input, float]] = []
        for path, number in table.constants.items():
            with self._naming("constants", path):
                self._constants.append((self._bind_input(path, TableValue(path), 1)[0], number))
        self._outputs: dict[str, tuple[float, list[Place]]] = {}
        for key in ("hard_iron", "soft_iron", "heading", "quaternion"):
            if (value := getattr(table, key)) is not None:
                with self._naming(key):
                    size = _OUTPUTS.get(key) or _SOFT_IRON[value.form]
                    self._outputs[key] = value.factor(key), self._places(key, value, size)
        inputs = [*(place for _, places in self._inputs.values() for place in places)]
        filled = [self._variable_at(place.address) for place in [*inputs, *(place for place, _ in self._constants)]]
        for key, call in self._calls.items():
            for variable in (argument for argument in call.arguments if isinstance(argument, _CallerVariable)):
                with self._naming(key):
                    if variable.number is not None and variable not in filled:
                        raise ConfigError(f"no path names {variable.name}; name it in one, or write a number instead")
                    if variable.size == 0:
                        raise ConfigError(f"no path names {variable.name}; write its length: {variable.name}[64]")

    def _matrix(self, key: str, value: TableValue) -> Array:
        """Return the matrix by which rows in hiltest's units and axes are multiplied."""
        if not isinstance(value, TableVector):
            return np.array([[1.0 / value.factor(key)]])
        frame = self._table.frame_of(value)
        sign = frame.gravity_sign if key == "accelerometer" else 1.0
        return sign * np.array(frame.to_body) / value.factor(key)

    def _bind_input(self, key: str, value: TableValue, size: int) -> list[_Input]:
        sampled = self._is_sampled and size > 1
        rows = [self._places(key, value, size, number, sampled=sampled) for number in range(1 + sampled)]
        inputs = []
        for place, following in zip(rows[0], rows[-1], strict=True):
            for scalar in place.scalars:
                if place.beyond or scalar.bits is not None:
                    raise ConfigError(f"{place.path} is behind a pointer or in a bit-field, which is not written")
                stride = following.address - place.address
                inputs.append(_Input(place.address + scalar.offset, scalar.kind, stride))
        return inputs

    def _places(self, key: str, value: TableValue, size: int, number: int = 0, *, sampled: bool = False) -> list[Place]:
        """Return the places of a quantity's numbers, of one sample; elements of a flat array are consecutive."""
        paths = [self._indexed(path, sampled=sampled) for path in value.paths(key)]
        places = [self._place(path.replace("[i]", f"[{number}]")) for path in paths]
        count = sum(len(place.scalars) for place in places)
        if len(paths) == 1 and "[i]" in paths[0] and count and size % count == 0:
            steps, count = size // count, size
            places = [self._place(paths[0].replace("[i]", f"[{steps * number + step}]")) for step in range(steps)]
        if count != size:
            types = ", ".join(f"{place.path} is {place.type_text}" for place in places)
            raise ConfigError(f"{key} is {size} numbers, and these are {count} ({types})")
        return places

    def _indexed(self, path: str, *, sampled: bool) -> str:
        """Return a path with the index ``[i]`` after the name, if it is an array whose index is written nowhere."""
        name = _NAME.match(path)
        if "[i]" in path or name is None:
            return path
        read = read_path(path)
        variable = self._named(read.name)
        is_array = variable is not None and isinstance(variable.kind, ArrayType)
        has_index = bool(read.steps) and isinstance(read.steps[0], IndexStep)
        return f"{path[: name.end()]}[i]{path[name.end() :]}" if sampled or (is_array and not has_index) else path

    def _place(self, path: str) -> Place:
        place = self._variables.place(path)
        if place.beyond and not self._machine.follows_pointers:
            raise ConfigError(f"{path} is behind a pointer, which only the emulated core follows; name an ELF for it")
        variable = self._named(read_path(path).name)
        if variable is not None and not place.beyond and place.address >= _CALLER:
            end = sum(place.extent) - variable.address
            variable.size = max(variable.size, end if isinstance(variable.kind, ArrayType) else 0)
            if end > min(variable.size, _ROOM):
                raise ConfigError(f"{path} is outside {variable.name}, which has {min(variable.size, _ROOM)} bytes")
        return place

    def _named(self, name: str) -> _CallerVariable | None:
        return next((variable for variable in self._caller if variable.name == name), None)

    def _variable_at(self, address: int) -> _CallerVariable | None:
        number = (address - _CALLER) // _ROOM
        return self._caller[number] if 0 <= number < len(self._caller) else None

    # -- calls ------------------------------------------------------------------------------------

    def _restart(self, samples: int, **numbers: float) -> None:
        """Zero the caller's variables, with room for the samples, write constants and numbers, and call `start`."""
        self._machine.reset()
        for key, (_, places) in self._inputs.items():
            if places[0].stride:
                with self._naming(key):
                    self._places(key, getattr(self._table, key), len(places), samples - 1, sampled=True)
        for variable in self._caller:
            variable.content = bytearray(variable.size) + _GUARD
        for place, number in self._constants:
            self._write_numbers(place, np.array([number]))
        for key, number in numbers.items():
            self._write(key, number)
        self._invoke("start")

    def _invoke(self, key: str) -> None:
        call = self._calls.get(key)
        if call is None:
            return
        arguments = [_passed(argument) for argument in call.arguments]
        value = self._machine.call(call, arguments, counted=key in _JUDGED)
        for argument in call.arguments:
            if isinstance(argument, _CallerVariable) and not argument.content.endswith(_GUARD):
                raise ConfigError(f"{call.function} writes outside {argument.name}")
        if call is self._returning and self._return is not None and value is not None:
            size = self._return.size
            bits = np.float32(value) if size == 4 else np.float64(value)
            content = bits.tobytes() if isinstance(value, float) else (value & (1 << 64) - 1).to_bytes(8, "little")
            self._return.content[:size] = content[:size]

    @np.errstate(all="ignore")
    def _write(self, key: str, rows: Any) -> None:
        """Write numbers in hiltest's unit and axes, of shape (samples, numbers)."""
        if key in self._inputs:
            matrix, places = self._inputs[key]
            with self._naming(key):
                for place, numbers in zip(places, (np.atleast_2d(rows) @ matrix).T, strict=True):
                    self._write_numbers(place, numbers)

    def _write_numbers(self, place: _Input, numbers: Array) -> None:
        if place.kind.kind is not NumberKind.FLOAT:
            numbers, is_signed = np.rint(numbers), place.kind.kind is NumberKind.SIGNED
            least, most = -is_signed << 8 * place.kind.size - 1, (1 << 8 * place.kind.size - is_signed) - 1
            if len(wrong := numbers[~((numbers >= least) & (numbers <= most))]):
                raise ConfigError(f"{wrong[0]:.0f} does not fit {place.kind.text}; check unit and scale")
        variable = self._variable_at(place.address)
        for index, number in enumerate(numbers.astype(f"<{_CODES[place.kind.kind]}{place.kind.size}")):
            address = place.address + index * place.stride
            if variable is None:
                self._machine.write(address, number.tobytes())
            else:
                begin = address - variable.address
                variable.content[begin : begin + place.kind.size] = number.tobytes()

    def _read(self, key: str) -> Array:
        """Return the numbers of an output in hiltest's unit; NaN behind a null pointer."""
        factor, places = self._outputs[key]
        numbers: list[float] = []
        for place in places:
            try:
                numbers += place.numbers(place.read(self._read_memory))
            except (NullPointer, ValueError):
                numbers += [np.nan] * len(place.scalars)
        return np.array(numbers) * factor

    def _read_memory(self, address: int, size: int) -> bytes:
        variable = self._variable_at(address)
        if variable is None:
            return self._machine.read(address, size)
        return bytes(variable.content[address - variable.address :][:size])

    def _is_refused(self) -> bool:
        if self._success == "always" or self._return is None or not isinstance(self._return.kind, NumberType):
            return False
        value = decoded(self._return.kind, bytes(self._return.content[: self._return.size]))
        return not {"zero": value == 0, "nonzero": value != 0, "not negative": value >= 0}[self._success]

    @np.errstate(all="ignore")
    def _calibration(self) -> tuple[Array, Array]:
        """Return hard iron and soft iron along the axes of the body."""
        hard, soft, matrix = self._table.hard_iron, self._table.soft_iron, np.eye(3)
        if soft is not None:
            numbers = self._read("soft_iron")
            square = numbers[_SYMMETRIC] if soft.form == "symmetric" else numbers
            matrix = np.diag(numbers) if soft.form == "gains" else square.reshape(3, 3)
            matrix = matrix.T if soft.order == "columns" else matrix
            matrix = _inverse(matrix) if soft.inverse else matrix
        offset = self._read("hard_iron")
        if hard is not None and hard.subtracted == "after":
            offset = _inverse(matrix) @ offset
        turn = np.array(self._table.frame_of(self._table.magnetometer).to_body)
        return turn @ offset, turn @ matrix @ turn.T


def _bare_text(kind: CType) -> str:
    return kind.text.replace("const ", "")


def _passed(argument: _CallerVariable | int | float) -> Any:
    """Return an argument as a number, or as a bytearray that is passed by address."""
    if isinstance(argument, _CallerVariable):
        number = argument.number
        return argument.content if number is None else decoded(number, bytes(argument.content[: number.size]))
    return argument


def _inverse(matrix: Array) -> Array:
    """Return the inverse; NaN if there is none."""
    try:
        return np.asarray(np.linalg.inv(matrix))
    except np.linalg.LinAlgError:
        return np.full((3, 3), np.nan)
