"""Table in TOML that maps a foreign signature to the contracts of ``hiltest_judge.h``."""

from __future__ import annotations

import re
from contextlib import suppress
from dataclasses import dataclass, field, fields, replace
from pathlib import Path
from typing import Any, ClassVar, Literal, TypeAlias

from hiltest.budgets import SIGNATURE
from hiltest.interfaces.frames import FRAMES, Frame
from hiltest.json_files import read_bounded
from hiltest.measurement.units import conversion, unit_words
from hiltest.rig.rig_file import TomlSource, read_toml
from hiltest.rig.toml_tables import STRICT, Axes, RigValueError, axes_matrix, check_axes, require

_CALL = re.compile(r"\s*([\w$.:]+)\s*\(([^()]*)\)\s*;?\s*", re.ASCII)
_ARGUMENT = re.compile(r"(&\s*)?([A-Za-z_]\w*)\s*(?:\[\s*(\d{1,7})\s*\])?", re.ASCII)
# x forward, y left, z up; the earth is north, west, up.
_NWU = Frame(((1.0, 0.0, 0.0), (0.0, -1.0, 0.0), (0.0, 0.0, -1.0)), -1.0, clockwise=False)
_FRAMES = {**FRAMES, "nwu": _NWU}
_UNITS = {
    "magnetometer": "uT",
    "accelerometer": "g",
    "gyroscope": "dps",
    "hard_iron": "uT",
    "heading": "deg",
    "dt": "s",
    "rate": "Hz",
}
_DEFAULT_UNITS = ("s", "Hz")
_CALIBRATOR = ("calibrate", "add", "success", "hard_iron", "soft_iron")
_FILTER = ("update", "read", "gyroscope", "heading", "quaternion")


@dataclass(frozen=True, slots=True)
class Variable:
    """A variable of the caller as an argument, ``name``, ``&name`` or ``name[length]``."""

    name: str
    by_address: bool
    length: int


Argument: TypeAlias = Variable | int | float


@dataclass(frozen=True, slots=True)
class Call:
    """A call in C, ``function(arguments)``."""

    function: str
    arguments: tuple[Argument, ...]


@dataclass(frozen=True, slots=True)
class TableValue:
    """Place and unit of a quantity."""

    __pydantic_config__: ClassVar[dict[str, Any]] = STRICT
    path: str | tuple[str, ...] = ()
    """One path to all numbers, or one path for each: from a variable of the caller, from ``return``, or from a variable
    of the file. ``[i]`` counts samples. By default the name of the quantity."""
    unit: str | None = None
    """Unit of the function."""
    scale: float = 1.0
    """Factor from the variables to that unit."""

    def __post_init__(self) -> None:
        require(self.scale != 0.0, "scale", "must not be zero")

    def paths(self, key: str) -> tuple[str, ...]:
        """Return the paths of the quantity `key`."""
        return ((self.path,) if isinstance(self.path, str) else self.path) or (key,)

    def factor(self, key: str) -> float:
        """Return the factor from the variables to hiltest's unit of the quantity `key`."""
        unit = _UNITS.get(key, "")
        converted = conversion(self.unit or (unit if unit in _DEFAULT_UNITS else ""), unit)
        if converted is None:
            fault = "is missing" if self.unit is None else f"{self.unit!r} does not fit"
            raise RigValueError(f"{key}.unit", f"{fault}; write one of {', '.join(unit_words(unit)) or 1}")
        return self.scale * converted.factor


@dataclass(frozen=True, slots=True)
class TableVector(TableValue):
    """A vector of a sensor."""

    axes: Axes | None = None
    """Axes of the function's vector along x, y and z of the body (forward, right, down); by default those of the
    table."""

    def __post_init__(self) -> None:
        TableValue.__post_init__(self)
        check_axes(self.axes)


@dataclass(frozen=True, slots=True)
class TableHardIron(TableValue):
    """A hard iron."""

    subtracted: Literal["before", "after"] = "before"
    """Its place: subtracted before the soft iron is applied, or after."""


@dataclass(frozen=True, slots=True)
class TableSoftIron(TableValue):
    """A soft iron."""

    form: Literal["matrix", "symmetric", "gains"] = "matrix"
    """Nine numbers, or the six xx, xy, xz, yy, yz, zz, or the three of the diagonal."""
    order: Literal["rows", "columns"] = "rows"
    inverse: bool = False
    """True if it is the distortion, whose inverse must be applied: for gains, the radii."""


@dataclass(frozen=True, slots=True)
class TableQuaternion(TableValue):
    """An attitude."""

    order: Literal["wxyz", "xyzw"] = "wxyz"
    inverse: bool = False
    """True if it turns vectors of the earth into the body."""


@dataclass(frozen=True, slots=True)
class SignatureTable:
    """Calls of a calibrator or of a filter, and the places of their inputs and outputs."""

    __pydantic_config__: ClassVar[dict[str, Any]] = STRICT
    start: str | None = None
    """Call that starts anew, before all others."""
    calibrate: str | None = None
    """Call of a calibrator."""
    add: str | None = None
    """Call with each sample, before `calibrate` or instead of it."""
    update: str | None = None
    """Call of a filter with each reading."""
    read: str | None = None
    """Call after which a filter's answer is read."""
    success: Literal["zero", "nonzero", "not negative", "always"] | None = None
    """Return values of a calibration that may be used; by default zero, without a return value always."""
    frame: Literal["ned", "enu", "android", "windows", "nwu"] = "ned"
    axes: Axes | None = None
    """As those of a vector, for all vectors and the attitude; by default those of the frame."""
    constants: dict[str, float] = field(default_factory=dict)
    """Values by path, which are written before the first call."""
    magnetometer: TableVector | None = None
    accelerometer: TableVector | None = None
    gyroscope: TableVector | None = None
    count: TableValue = field(default_factory=TableValue)
    dt: TableValue = field(default_factory=TableValue)
    rate: TableValue = field(default_factory=TableValue)
    hard_iron: TableHardIron | None = None
    soft_iron: TableSoftIron | None = None
    heading: TableValue | None = None
    quaternion: TableQuaternion | None = None

    def __post_init__(self) -> None:
        check_axes(self.axes)
        for item in fields(self):
            value = getattr(self, item.name)
            if isinstance(value, TableValue):
                value.factor(item.name)
        for key in ("start", "calibrate", "add", "update", "read"):
            text = getattr(self, key)
            require(
                text is None or _parse_call(text) is not None,
                key,
                f"{text!r} is not a call; write one as in C: fit(samples, count, &result, 0.5)",
            )
        has_calibrator = self.calibrate is not None or self.add is not None
        require(self.is_filter != has_calibrator, "update", "or calibrate must be there, and not both")
        kind, strangers = ("filter", _CALIBRATOR) if self.is_filter else ("calibrator", _FILTER)
        for key in strangers:
            require(getattr(self, key) is None, key, f"does not belong to a {kind}")
        for key in () if self.is_filter else ("magnetometer", "hard_iron"):
            require(getattr(self, key) is not None, key, "is missing")
        has_answer = (self.heading is None) != (self.quaternion is None)
        require(has_answer or not self.is_filter, "heading", "or quaternion must be there, and not both")

    @property
    def is_filter(self) -> bool:
        return self.update is not None

    def call(self, key: str) -> Call | None:
        """Return one of the calls; None if the table has none."""
        text = getattr(self, key)
        return None if text is None else _parse_call(text)

    @property
    def functions(self) -> list[str]:
        """Names of all functions, the one that is judged first."""
        calls = map(self.call, ("calibrate", "update", "add", "start", "read"))
        return list(dict.fromkeys(call.function for call in calls if call is not None))

    def frame_of(self, vector: TableVector | None = None) -> Frame:
        """Return the convention of a vector, or of the attitude."""
        frame = _FRAMES[self.frame]
        axes = (vector.axes if vector else None) or self.axes
        return replace(frame, to_body=axes_matrix(axes)) if axes else frame

    @property
    def earth_to_ned(self) -> Any:
        """Matrix from the earth frame to NED: axes of earth and body pair up, as east and right."""
        return _FRAMES[self.frame].to_body


ReadTable: TypeAlias = tuple[SignatureTable, TomlSource]
"""A table, and the file that it was read from."""


def _parse_call(text: str) -> Call | None:
    """Return a call; None if the text is none."""
    match = _CALL.fullmatch(text)
    words = [word.strip() for word in match[2].split(",")] if match and match[2].strip() else []
    arguments = tuple(argument for word in words if (argument := _parse_argument(word)) is not None)
    return Call(match[1], arguments) if match and len(arguments) == len(words) else None


def _parse_argument(word: str) -> Argument | None:
    if word == "NULL":
        return 0
    if match := _ARGUMENT.fullmatch(word):
        return Variable(match[2], match[1] is not None, int(match[3] or 0))
    with suppress(ValueError):
        return int(word.rstrip("uUlL"), 0)
    with suppress(ValueError):
        return float(word.rstrip("fFlL"))
    return None


def read_signature_table(file: Path) -> ReadTable:
    """Read a table.

    Raises
    ------
    ConfigError
        If it cannot be read, or has a mistake; with line, key and the next step.
    """
    content = read_bounded(file, SIGNATURE, otherwise="name a table (TOML) as docs/judge.md has it")
    data, source = read_toml(file, content, SIGNATURE)
    table: SignatureTable = source.validate(data, SignatureTable)
    return table, source
