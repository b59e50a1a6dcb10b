"""Fields of a payload: a cursor that reads and validates them, and the forms of a dataclass's fields on the line."""

from __future__ import annotations

import dataclasses
import math
import struct
from collections.abc import Callable
from enum import IntEnum
from functools import cache
from types import NoneType
from typing import Annotated, Any, ClassVar, Self, TypeVar, cast, get_args, get_origin, get_type_hints

import numpy as np
from numpy.typing import NDArray

from hiltest.errors import ProtocolError

E = TypeVar("E", bound=IntEnum)
Reals = NDArray[np.float64]


class FieldReader:
    """A cursor over a payload; errors name the field, its position and the reason.

    Parameters
    ----------
    data
        The payload.
    message
        Name of the message, for errors.
    """

    def __init__(self, data: bytes, message: str) -> None:
        self._data = data
        self._message = message
        self._offset = 0

    def number(self, form: str, field: str) -> int:
        """Return the next integer; `form` is a `struct` letter (B, H, I, Q, b, h)."""
        (value,) = self._unpack("<" + form, field)
        return int(value)

    def choice(self, kind: type[E], field: str) -> E:
        """Return the next byte as a member of an enumeration."""
        at = self._offset
        value = self.number("B", field)
        try:
            return kind(value)
        except ValueError:
            raise self._error(field, at, f"{value} is not a {kind.__name__}") from None

    def flag(self, field: str) -> bool:
        """Return the next byte as a truth value; only 0 and 1 are valid."""
        at = self._offset
        value = self.number("B", field)
        if value > 1:
            raise self._error(field, at, f"{value} is neither 0 nor 1")
        return value == 1

    def text(self, field: str) -> str:
        """Return the next string: a length byte, then that many printable ASCII characters."""
        length = self.number("B", f"length of {field}")
        at = self._offset
        raw = self._take(length, field)
        if not all(0x20 <= value < 0x7F for value in raw):
            raise self._error(field, at, f"{raw!r} is not printable ASCII")
        return raw.decode("ascii")

    def real(self, field: str) -> float:
        """Return the next float32, widened without change."""
        return float(self.reals(1, field)[0])

    def real_if_any(self, field: str) -> float | None:
        """Return the next float32, or None for NaN."""
        values = self.reals_if_any(1, field)
        return None if values is None else float(values[0])

    def reals_if_any(self, count: int, field: str) -> NDArray[np.float64] | None:
        """Return the next `count` float32, or None if all are NaN, which means "no value"."""
        if all(math.isnan(value) for value in self._unpack(f"<{count}f", field)):
            return None
        self._offset -= 4 * count
        return self.reals(count, field)

    def reals(self, count: int, field: str) -> NDArray[np.float64]:
        """Return the next `count` float32, all finite, widened to a read-only float64 array."""
        at = self._offset
        values = self._unpack(f"<{count}f", field)
        for index, value in enumerate(values):
            if not math.isfinite(value):
                raise self._error(field, at + 4 * index, f"element {index} is {value}")
        return _read_only(np.array(values, dtype=np.float64))

    def counts(self, rows: int, field: str, *, columns: int = 3) -> NDArray[np.int16]:
        """Return the next `rows * columns` int16 as a read-only array."""
        raw = self._take(2 * rows * columns, field)
        return _read_only(np.frombuffer(raw, dtype="<i2").astype(np.int16).reshape(rows, columns))

    @property
    def left(self) -> int:
        """Number of bytes that are not read yet."""
        return len(self._data) - self._offset

    def end(self) -> None:
        """Check that no byte remains."""
        if self.left:
            raise self._error("end", self._offset, f"{self.left} bytes too many")

    def _unpack(self, form: str, field: str) -> tuple[float, ...]:
        return struct.unpack(form, self._take(struct.calcsize(form), field))

    def _take(self, count: int, field: str) -> bytes:
        if self.left < count:
            raise self._error(field, self._offset, f"needs {count} bytes, {self.left} are left")
        self._offset += count
        return self._data[self._offset - count : self._offset]

    def _error(self, field: str, at: int, problem: str) -> ProtocolError:
        return ProtocolError(f"{self._message}: {field} at byte {at} of {len(self._data)}: {problem}")


T = TypeVar("T", np.float64, np.int16)


def _read_only(array: NDArray[T]) -> NDArray[T]:
    array.flags.writeable = False
    return array


@dataclasses.dataclass(frozen=True, slots=True)
class Form:
    """Form of a field on the line; replies need no `pack`."""

    read: Callable[[FieldReader, str], Any]
    """Reads the field, whose name is for errors."""
    pack: Callable[[Any], bytes] = bytes


def number(form: str, lowest: int | None = None, highest: int = 0, unit: str = "") -> Form:
    """Return the form of an integer, a `struct` letter, which a request refuses outside of its range."""

    def pack(value: int) -> bytes:
        return struct.pack("<" + form, value if lowest is None else check_range(value, lowest, highest, unit))

    return Form(lambda fields, name: fields.number(form, name), pack)


def reals(*shape: int) -> Form:
    """Return the form of an array of float32."""
    return Form(
        lambda fields, name: fields.reals(math.prod(shape), name).reshape(shape),
        lambda values: np.asarray(values, dtype="<f4").reshape(shape).tobytes(),
    )


def check_range(value: int, lowest: int, highest: int, unit: str) -> int:
    """Return a value if it is in range; otherwise raise a `ValueError` with the range."""
    if not lowest <= value <= highest:
        raise ValueError(f"{value} {unit}; the protocol takes {lowest} to {highest}")
    return value


U8 = Annotated[int, number("B")]
U16 = Annotated[int, number("H")]
U32 = Annotated[int, number("I")]
U64 = Annotated[int, number("Q")]
I8 = Annotated[int, number("b")]
Vector = Annotated[Reals, reals(3)]
Matrix = Annotated[Reals, reals(3, 3)]
Axes = Annotated[NDArray[np.int16], Form(lambda fields, name: fields.counts(1, name)[0])]
_FORMS = {
    bool: Form(FieldReader.flag, lambda value: struct.pack("<B", value)),
    float: Form(FieldReader.real, lambda value: struct.pack("<f", value)),
    str: Form(FieldReader.text, lambda text: number("B", 1, 255, "characters").pack(len(text)) + text.encode("ascii")),
}


class Message:
    """A request or a part of a reply: a dataclass whose fields have forms on the line.

    The type of a field is its form: an enumeration, a truth value, a float32, a text, another message, or any other
    type that is annotated with its `Form`.
    """

    __slots__ = ()
    order: ClassVar[tuple[str, ...]] = ()
    """Names of the fields in the order of the line; empty if it is that of the class."""

    @classmethod
    def read(cls, fields: FieldReader) -> Self:
        """Return the message with the next fields."""
        forms = _forms(cast("type", cls))
        return cls(**{name: form.read(fields, name.replace("_", " ")) for name, form in forms})

    def payload(self) -> bytes:
        """Return the bytes of all fields."""
        return b"".join(form.pack(getattr(self, name)) for name, form in _forms(cast("type", type(self))))


@cache
def _forms(kind: Any) -> tuple[tuple[str, Form], ...]:
    hints = get_type_hints(kind, include_extras=True)
    names = kind.order or [field.name for field in dataclasses.fields(kind)]
    return tuple((name, _form_of(hints[name])) for name in names)


def _form_of(hint: Any) -> Form:
    if get_origin(hint) is Annotated:
        form: Form = hint.__metadata__[0]
        return form
    kind = next((part for part in get_args(hint) if part is not NoneType), hint)
    if kind in _FORMS:
        return _FORMS[kind]
    if issubclass(kind, IntEnum):
        return Form(lambda fields, name: fields.choice(kind, name), lambda value: struct.pack("<B", value))
    return Form(lambda fields, name: kind.read(fields))
