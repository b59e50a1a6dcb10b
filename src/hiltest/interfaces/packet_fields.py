"""Fields of a packet: their form in bytes, and their units."""

from __future__ import annotations

import struct
from collections.abc import Callable, Sequence
from dataclasses import dataclass, fields
from itertools import islice
from typing import Annotated, Any, ClassVar, Self, TypeVar, get_type_hints, overload

from hiltest.errors import FrameError

T = TypeVar("T")


@dataclass(frozen=True, slots=True)
class Sent:
    """Form of a field on the line, little-endian."""

    letter: str
    """Format character of `struct`: b, B, h, H, i or I."""
    count: int = 0
    """Number of elements; 0 for a field that is a number and not a tuple."""

    @property
    def form(self) -> str:
        """Format string of `struct`."""
        return f"{self.count or ''}{self.letter}"


Int8 = Annotated[int, Sent("b")]
UInt8 = Annotated[int, Sent("B")]
Int16 = Annotated[int, Sent("h")]
UInt16 = Annotated[int, Sent("H")]
Int32 = Annotated[int, Sent("i")]
UInt32 = Annotated[int, Sent("I")]
Vector = Annotated[tuple[int, int, int], Sent("h", 3)]
Quadruple = Annotated[tuple[int, int, int, int], Sent("h", 4)]
Sextuple = Annotated[tuple[int, int, int, int, int, int], Sent("h", 6)]


class _Scaled:
    """A field in its unit: the transmitted integer divided by the integer of one unit."""

    def __init__(self, field: str, per_unit: float, *columns: str) -> None:
        self.field = field
        self.per_unit = per_unit
        self.columns = columns


class ScaledNumber(_Scaled):
    """A number in its unit."""

    @overload
    def __get__(self, packet: None, owner: type) -> Self: ...
    @overload
    def __get__(self, packet: object, owner: type) -> float: ...
    def __get__(self, packet: object | None, owner: type) -> float | Self:
        """Return the number in its unit."""
        return self if packet is None else float(getattr(packet, self.field)) / self.per_unit


class ScaledVector(_Scaled):
    """Several numbers in their unit."""

    @overload
    def __get__(self, packet: None, owner: type) -> Self: ...
    @overload
    def __get__(self, packet: object, owner: type) -> tuple[float, ...]: ...
    def __get__(self, packet: object | None, owner: type) -> tuple[float, ...] | Self:
        """Return the numbers in their unit."""
        return self if packet is None else tuple(number / self.per_unit for number in getattr(packet, self.field))


def axes(quantity: str, unit: str = "", names: Sequence[str] = "xyz") -> list[str]:
    """Return the columns of a vector.

    Examples
    --------
    >>> axes("gyroscope", "dps")
    ['gyroscope_x_dps', 'gyroscope_y_dps', 'gyroscope_z_dps']
    """
    return [f"{quantity}_{name}_{unit}".rstrip("_") for name in names]


@dataclass(frozen=True, slots=True)
class Packet:
    """Base of all packets.

    The attributes are the transmitted integers. Those whose name ends in a unit are divided by their scale.
    """

    type: ClassVar[int]
    title: ClassVar[str]
    """Class constants: the type on the line, and the name of the content."""
    number: UInt8
    """Sequence number over packets of all types, modulo 256."""

    @classmethod
    def columns(cls) -> tuple[str, ...]:
        """Return the names of `values`."""
        return tuple(name for _, names in _readings(cls) for name in names)

    def values(self) -> dict[str, float]:
        """Return the packet's values with units in the names, without its number and time."""
        values: dict[str, float] = {}
        for attribute, names in _readings(type(self)):
            value = getattr(self, attribute)
            values.update(zip(names, value if isinstance(value, tuple) else (value,), strict=True))
        return values


@dataclass(frozen=True, slots=True)
class TimedPacket(Packet):
    """A packet with a time stamp."""

    time_us: UInt32
    """The board's clock [us], modulo 2**32."""


def per_kind(function: Callable[[type[Packet]], T]) -> Callable[[type[Packet]], T]:
    """Cache a function of a kind of packet."""
    results: dict[type[Packet], T] = {}

    def remembered(kind: type[Packet]) -> T:
        if kind not in results:
            results[kind] = function(kind)
        return results[kind]

    return remembered


@per_kind
def sent_fields(kind: type[Packet]) -> tuple[tuple[str, Sent], ...]:
    """Return the fields of a kind of packet in the order of the line, each with its form."""
    hints = get_type_hints(kind, include_extras=True)
    return tuple((field.name, hints[field.name].__metadata__[0]) for field in fields(kind))


@per_kind
def layout(kind: type[Packet]) -> struct.Struct:
    """Return the `struct` of a kind's body, with the type before the fields."""
    return struct.Struct("<B" + "".join(sent.form for _, sent in sent_fields(kind)))


@per_kind
def scaled(kind: type[Packet]) -> dict[str, _Scaled]:
    """Return the attributes in units of a kind of packet."""
    return {
        name: value
        for base in reversed(kind.__mro__)
        for name, value in vars(base).items()
        if isinstance(value, _Scaled)
    }


@per_kind
def _readings(kind: type[Packet]) -> tuple[tuple[str, tuple[str, ...]], ...]:
    """Return each attribute with its columns: the one in a unit, or the number without one."""
    in_unit = {attribute.field: (name, attribute.columns) for name, attribute in scaled(kind).items()}
    return tuple(
        in_unit.get(name, (name, (name,)))
        for name, sent in sent_fields(kind)
        if name in in_unit or not (sent.count or name in ("number", "time_us"))
    )


def pack(packet: Packet) -> bytes:
    """Return the body of a packet: its type and its fields.

    Raises
    ------
    ValueError
        When a field exceeds the range of its form.
    """
    numbers: list[int] = []
    for name, _ in sent_fields(type(packet)):
        value = getattr(packet, name)
        numbers += value if isinstance(value, tuple) else (value,)
    try:
        return layout(type(packet)).pack(packet.type, *numbers)
    except struct.error as error:
        raise ValueError(f"{packet} cannot be sent: {error}") from error


def unpack(kind: type[Packet], body: bytes) -> Packet:
    """Return the packet of a kind in a body.

    Raises
    ------
    FrameError
        When the body has another length or type.
    """
    form = layout(kind)
    if len(body) != form.size or body[0] != kind.type:
        raise FrameError(f"{len(body)} bytes are no {kind.__name__}, which has type {kind.type} and {form.size} bytes")
    numbers = iter(form.unpack(body)[1:])
    values: list[Any] = [
        tuple(islice(numbers, sent.count)) if sent.count else next(numbers) for _, sent in sent_fields(kind)
    ]
    return kind(*values)
