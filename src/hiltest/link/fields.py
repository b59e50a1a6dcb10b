"""Read the fields of a payload in order, and validate each."""

from __future__ import annotations

import math
import struct
from enum import IntEnum
from typing import TypeVar

import numpy as np
from numpy.typing import NDArray

from hiltest.errors import ProtocolError

E = TypeVar("E", bound=IntEnum)


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
