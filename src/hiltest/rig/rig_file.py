"""Reader of rig files, which reports every mistake with file, line and key.

pydantic checks the values against the dataclasses of `hiltest.rig`; this module turns its findings into sentences, and
finds the line, which TOML parsers do not provide.
"""

from __future__ import annotations

import json
import re
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, fields, is_dataclass
from hashlib import sha256
from pathlib import Path
from types import NoneType, UnionType
from typing import Any, Literal, get_args, get_origin, get_type_hints

from pydantic import ValidationError
from pydantic_core import ErrorDetails

from hiltest.budgets import RIG, Budget, BudgetError
from hiltest.errors import ConfigError, UnknownKeyError
from hiltest.json_files import adapter, parse_toml, read_bounded, shown
from hiltest.measurement import Limit, Section, Tolerance, identify, is_direction, nearest_name
from hiltest.rig.cycles import as_tables
from hiltest.rig.parts import sensor_names
from hiltest.rig.recorded_motion import as_table
from hiltest.rig.rig import Rig, refuse_unknown_sensors
from hiltest.rig.toml_tables import RigValueError, StrictTable

# Fields of a rig that a file must not set.
_MADE_HERE = frozenset({"path", "sha256", "units", "full_only", "lines"})
# Suffixes that pydantic adds to a key of a union type, which are not part of the key.
_ALTERNATIVE = re.compile(r"str|tuple\[.*\]")


@dataclass(frozen=True, slots=True)
class LimitEntry(StrictTable):
    """A limit in the file; `suite` is the smallest set of tests that measures it."""

    unit: str
    min: float | None = None
    max: float | None = None
    suite: Literal["gate", "full"] | None = None


@dataclass(frozen=True, slots=True)
class ToleranceEntry(StrictTable):
    """A tolerance in the file."""

    unit: str
    absolute: float
    relative: float = 0.0


def load_rig(path: Path | str) -> Rig:
    """Read and check a rig file.

    Raises
    ------
    UnknownKeyError
        If a key is unknown, with file, line and the nearest known key.
    ConfigError
        If the file cannot be read, a value is invalid, or a limit is tighter than the uncertainty of its reference.
    """
    path = Path(path)
    return parse_rig(path, read_bounded(path, RIG, otherwise="name a rig (TOML)"))


def read_toml(path: Path, content: bytes, budget: Budget = RIG) -> tuple[dict[str, Any], TomlSource]:
    """Return the data of a TOML file, and its text, which locates keys.

    Raises
    ------
    ConfigError
        If it is over its budget, or not TOML.
    """
    try:
        return parse_toml(content, budget), TomlSource(path, content.decode("utf-8"))
    except UnicodeDecodeError as error:
        raise ConfigError(f"{path}: not UTF-8 text at byte {error.start}; {budget.name} must be a TOML file") from error
    except BudgetError as error:
        raise ConfigError(f"{path}: {error}; write a shorter one") from error
    except ValueError as error:  # also for an integer of thousands of digits
        raise ConfigError(_not_toml(path, content.decode("utf-8"), str(error))) from error


def parse_rig(path: Path, content: bytes) -> Rig:
    """Check the contents of a rig file like `load_rig`; messages name the file that it was read from."""
    data, source = read_toml(path, content)
    for made_here in _MADE_HERE & data.keys():
        raise UnknownKeyError(made_here, where=source.where((made_here,)), known=_known_keys(Rig, ()))
    if "schema" not in data:
        raise ConfigError(f"{path}:1: schema is missing; write `schema = 1` above the first table")
    tables = {name: data.pop(name, {}) for name in ("limits", "information")}
    read = {name: _checked_limits(source, name, table) for name, table in tables.items()}
    if "cycles" in data:
        data["cycles"] = as_tables(data["cycles"])
    if "world" in data:
        data["world"] = as_table(data["world"])
    tolerances = _checked_tolerances(source, data.pop("tolerances", {}))
    bounds = {
        table: {name: {"min": entry.min, "max": entry.max} for name, entry in entries.items()}
        for table, entries in read.items()
    }
    derived = {
        "path": str(path),
        "sha256": sha256(content).hexdigest(),
        "units": _units(source, {**read, "tolerances": tolerances}),
        "tolerances": {
            name: {"absolute": entry.absolute, "relative": entry.relative} for name, entry in tolerances.items()
        },
        "lines": {".".join(key): line for key, line in source.lines.items()},
        "full_only": [name for name, entry in read["limits"].items() if entry.suite == "full"],
    }
    rig: Rig = source.validate({**data, **bounds, **derived}, Rig)
    _refuse_limits_within_uncertainty(rig, source)
    _refuse_tolerances_beyond_limits(rig, source)
    if rig.world is not None:
        refuse_unknown_sensors(rig, sensor_names(rig.parts))
    return rig


class TomlSource:
    """A TOML file's path and text, which locates the line of a key."""

    def __init__(self, path: Path, text: str) -> None:
        self.path = path
        self.lines = dict(reversed([*_keys_by_line(text)]))

    def where(self, key: tuple[str, ...]) -> str:
        """Return ``file:line`` of a key, of its table, or only the file."""
        for depth in range(len(key), 0, -1):
            if key[:depth] in self.lines:
                return f"{self.path}:{self.lines[key[:depth]]}"
        return str(self.path)

    def validate(self, data: object, model: Any, prefix: tuple[str, ...] = ()) -> Any:
        """Return the data validated by pydantic, or raise the first mistake as a sentence."""
        try:
            # As JSON, because strict mode accepts arrays for tuples and tables for dataclasses only there.
            return adapter(model).validate_json(json.dumps(data, default=str))
        except ValidationError as error:
            # Unknown keys first, because a misspelt key is also a missing one, and the spelling is more helpful.
            details = sorted(error.errors(), key=lambda error: error["type"] != "unexpected_keyword_argument")
            raise self._as_error(details[0], model, prefix) from error

    def _as_error(self, detail: ErrorDetails, model: Any, prefix: tuple[str, ...]) -> ConfigError:
        key: tuple[str, ...] = ()
        for part in map(str, detail["loc"]):
            is_index = part.isdecimal() and (*prefix, *key, part) not in self.lines  # of a number in an array
            if not is_index and not _ALTERNATIVE.fullmatch(part):
                key = (*key, part)
        kind = detail["type"]
        if kind in ("unexpected_keyword_argument", "extra_forbidden"):
            return UnknownKeyError(key[-1], where=self.where(prefix + key), known=_known_keys(model, key[:-1]))
        message = detail["msg"]
        cause = detail.get("ctx", {}).get("error")
        if isinstance(cause, RigValueError):
            key, message = (*key, *cause.key.split(".")), str(cause)
        place = ".".join(prefix + key)
        if kind in ("missing", "missing_argument"):
            return ConfigError(f"{self.where(prefix + key)}: {place} is missing")
        input_text = "" if isinstance(cause, RigValueError) else f", not {shown(detail['input'])}"
        return ConfigError(f"{self.where(prefix + key)}: {place}: {message[0].lower()}{message[1:]}{input_text}")


def _not_toml(path: Path, text: str, complaint: str) -> str:
    """Return the error in a file, with the line from the TOML parser's message."""
    place = re.search(r" \(at (?:line (\d+), column (\d+)|end of document)\)$", complaint)
    if place is None:
        return f"{path}: not TOML: {complaint}"
    line = int(place[1]) if place[1] else text.count("\n") + 1
    column = f" (column {place[2]})" if place[2] else " (end of the file)"
    return f"{path}:{line}: not TOML: {complaint[: place.start()]}{column}"


def _units(source: TomlSource, tables: Mapping[str, Mapping[str, LimitEntry | ToleranceEntry]]) -> dict[str, str]:
    """Return the unit of every name, which is the same in all tables."""
    units: dict[str, tuple[str, str]] = {}
    for table, entries in tables.items():
        for name, entry in entries.items():
            unit, first = units.setdefault(name, (entry.unit, table))
            if unit != entry.unit:
                raise ConfigError(
                    f"{source.where((table, name))}: {table}.{name}: its unit is {unit!r} under {first}, "
                    f"{entry.unit!r} here"
                )
    return {name: unit for name, (unit, _) in units.items()}


def _checked_limits(source: TomlSource, table: str, entries: object) -> dict[str, LimitEntry]:
    read: dict[str, LimitEntry] = source.validate(entries, dict[str, LimitEntry], (table,))
    for name, entry in read.items():
        _check_limit(source, (table, name), entry)
    return read


def _checked_tolerances(source: TomlSource, entries: object) -> dict[str, ToleranceEntry]:
    key = ("tolerances",)
    read: dict[str, ToleranceEntry] = source.validate(entries, dict[str, ToleranceEntry], key)
    for name, entry in read.items():
        _check_name(source, (*key, name), entry.unit)
        try:
            Tolerance(entry.absolute, entry.relative)
        except ValueError as error:
            raise ConfigError(f"{source.where((*key, name))}: tolerances.{name}: {error}") from error
    return read


def _check_name(source: TomlSource, key: tuple[str, str], unit: str) -> None:
    """Refuse a misspelling of a known name, and a unit that is not the kind's own.

    Any other name is the user's own; if nothing measures it, the end of the run reports that.
    """
    kind = identify(key[1]).kind
    if kind is None:
        if (nearest := nearest_name(key[1])) is not None:
            raise UnknownKeyError(key[1], where=source.where(key), known=[nearest])
    elif kind.unit is not None and unit != kind.unit:
        raise ConfigError(f"{source.where(key)}: {'.'.join(key)}: its unit is {kind.unit!r}, not {unit!r}")


def _check_limit(source: TomlSource, key: tuple[str, str], entry: LimitEntry) -> None:
    _check_name(source, key, entry.unit)
    named = identify(key[1])
    is_error = named.section is Section.HEADING and entry.unit == "deg" and not is_direction(key[1])
    try:
        Limit(min=entry.min, max=entry.max)
        if key[0] == "limits" and is_error and max(abs(entry.min or 0.0), abs(entry.max or 0.0)) >= 180.0:
            raise ValueError("no heading error exceeds 180 degrees: this limit has no effect")
        if entry.suite and key[0] != "limits":
            raise ValueError("suite selects the tests that must meet a limit; a measurement without verdict has none")
    except ValueError as error:
        raise ConfigError(f"{source.where(key)}: {'.'.join(key)}: {error}") from error


def _refuse_limits_within_uncertainty(rig: Rig, source: TomlSource) -> None:
    for name, limit in rig.limits.items():
        uncertainty_deg = rig.reference_uncertainty_deg(name)
        if uncertainty_deg is None:
            continue
        for bound in (limit.min, limit.max):
            if bound is not None and abs(bound) < uncertainty_deg:
                mounting = f"{rig.mounting.uncertainty_deg:g}" if rig.mounting else "not declared"
                raise ConfigError(
                    f"{source.where(('limits', name))}: limits.{name} of {bound:g} deg is tighter than the "
                    f"uncertainty of the reference, {uncertainty_deg:.3g} deg (turntable "
                    f"{rig.turntable.uncertainty_deg:g}, "
                    f"mounting {mounting}); widen the limit, or measure the reference better"
                )


def _refuse_tolerances_beyond_limits(rig: Rig, source: TomlSource) -> None:
    """Refuse a tolerance that lets a number cross its limit unnoticed."""
    for name, tolerance in rig.tolerances.items():
        limit = rig.limits.get(name)
        bounds = [bound for bound in (limit.min, limit.max) if bound is not None] if limit else []
        room = max(bounds) - min(bounds) if len(bounds) == 2 else max(map(abs, bounds), default=0.0)
        if room and (tolerance.absolute >= room or tolerance.relative >= 1.0):
            raise ConfigError(
                f"{source.where(('tolerances', name))}: tolerances.{name} is wider than its limit "
                f"({source.where(('limits', name))}: {limit}): such a change would not be detected"
            )


def _known_keys(model: Any, place: tuple[str, ...]) -> list[str]:
    """Return the allowed keys of a table of the file."""
    for name in place:
        if name.isdecimal():  # an index, whose array was entered with its key
            continue
        arguments = get_args(model)
        model = arguments[1] if arguments and not is_dataclass(model) else get_type_hints(model)[name]
        if isinstance(model, UnionType):
            model = next(argument for argument in get_args(model) if argument is not NoneType)
        if get_origin(model) is tuple:
            model = get_args(model)[0]
    return [field.name for field in fields(model) if field.name not in _MADE_HERE] if is_dataclass(model) else []


# Without a second place for blanks, which would take the square of their number.
_HEADER = re.compile(r"\s*\[([^\[\]]+)\]\s*(#.*)?$")
_ARRAY_HEADER = re.compile(r"\s*\[\[([^\[\]]+)\]\]\s*(#.*)?$")
_ONE_KEY = r"""(?:[A-Za-z0-9_-]+|"[^"]*"|'[^']*')"""
_KEY = re.compile(_ONE_KEY)
_ASSIGNMENT = re.compile(rf"\s*({_ONE_KEY}(?:\s*\.\s*{_ONE_KEY})*)\s*=")


def _keys_by_line(text: str) -> Iterator[tuple[tuple[str, ...], int]]:
    """Yield each key's path and line; sufficient for a file that is valid TOML."""
    table: tuple[str, ...] = ()
    arrays: dict[tuple[str, ...], int] = {}  # number of tables so far, by path
    for number, line in enumerate(text.splitlines(), start=1):
        if header := _ARRAY_HEADER.match(line):
            path = _split_key(header[1])
            arrays[path] = arrays.get(path, 0) + 1
            table = (*path, str(arrays[path] - 1))
            yield path, number
            yield table, number
        elif header := _HEADER.match(line):
            table = _split_key(header[1])
            array = next((table[:depth] for depth in range(1, len(table)) if table[:depth] in arrays), None)
            if array is not None:
                table = (*array, str(arrays[array] - 1), *table[len(array) :])
            yield table, number
        elif assignment := _ASSIGNMENT.match(line):
            key = _split_key(assignment[1])
            yield table + key, number
            for inline in re.finditer(r"[{,]\s*([A-Za-z0-9_-]+)\s*=", line):
                yield (*table, *key, inline[1]), number


def _split_key(written: str) -> tuple[str, ...]:
    return tuple(part.strip("\"'") for part in _KEY.findall(written))
